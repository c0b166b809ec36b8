# SPDX-License-Identifier: Apache-2.0
"""The curves of the group `scaling`: how their points are named in the table, and drawn."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

GAP_LENGTH = "gap workflow, recording of {:g} s"
GAP_CATALOGUE = "gap workflow, 20 s recorded, catalogue of {:g} effects"
IDENTIFICATION = "identification, {:g} samples"
CURVES = {
    GAP_LENGTH: "recording, s",
    GAP_CATALOGUE: "effects in the catalogue",
    IDENTIFICATION: "samples",
}


def told(curve: str, size: float) -> str:
    """Return the name of a point in the table."""
    return curve.format(size)


def points(curve: str, rows: list[dict[str, Any]]) -> list[tuple[float, float]]:
    """Return size and time, s, of a curve's points in a results file."""
    before, after = (re.escape(part) for part in curve.split("{:g}"))
    pattern = re.compile(f"{before}(.+){after}")
    found = [(pattern.fullmatch(row["what"]), row["ours"]) for row in rows]
    return sorted((float(match[1]), seconds) for match, seconds in found if match)


def draw(results: Mapping[str, dict], file: Path) -> None:
    """Draw the curves of a results file, and beside each what grows in proportion, as a picture."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for axes, (curve, label) in zip(figure.subplots(1, len(CURVES)), CURVES.items(), strict=True):
        sizes, seconds = zip(*points(curve, results["scaling"]["rows"]), strict=True)
        axes.plot(sizes, seconds, "o-", label="measured")
        ends = (0.0, sizes[-1])
        axes.plot(
            ends, [seconds[-1] * end / sizes[-1] for end in ends], ":", color="0.5", label="in proportion"
        )
        axes.set(
            xlabel=label, ylabel="processor s", title=curve.split(",")[0], xlim=(0, None), ylim=(0, None)
        )
        axes.legend()
    figure.savefig(file, dpi=100)
