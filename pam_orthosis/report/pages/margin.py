# SPDX-License-Identifier: Apache-2.0
"""The page of margins: how far each property of the hardware may change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from pam_orthosis.report.margin import HEAD, cells, notes
from pam_orthosis.report.page import NEUTRAL, Page, Part, listed
from pam_orthosis.report.plots import AFTER, BEFORE, Plot, dots, line


def page(found: Mapping[str, Any]) -> str:
    """Return the page of what `batch.margin.measure` found."""
    lost = [row for row in found["margins"] if row["lost"]["reached"] is not None]
    names = sorted({f"{row['direction']} {row['perturbation']}" for row in lost})
    tried = f"of {len(found['margins'])} changes"
    headline = (
        f"The {found['machine']} is lost by {len(names)} {tried}: {', '.join(names)}."
        if names
        else f"None {tried} loses the {found['machine']}."
    )
    head = [name.format(found["machine"]) for name in HEAD]
    rows = [cells(row) for row in found["margins"]]
    panels = [
        _panel(found, name, list(of))
        for name, of in groupby(found["margins"], lambda row: row["perturbation"])
    ]
    parts = [
        Part("Limits", table=listed(head, rows)),
        Part("Error against each change", ("The controllers stay as they are.",), plots=panels),
    ]
    return Page(
        "margin", "measured", NEUTRAL, headline, notes(found), parts, "margins of the closed loop"
    ).html()


def _panel(found: Mapping[str, Any], name: str, rows: Sequence[Mapping[str, Any]]) -> Plot:
    unit = found["error_unit"]
    doubled, beyond = found[f"doubled_{unit}"], found[f"lost_{unit}"]
    runs = {run["value"]: run[f"max_abs_error_{unit}"] for row in rows for run in row["runs"]}
    followed = sorted((value, error) for value, error in runs.items() if error is not None)
    gone = [value for value, error in runs.items() if error is None]
    values, sizes = zip(*followed, strict=True)
    data = [line(values, sizes, "maximum error", AFTER) | {"mode": "lines+markers"}]
    if gone:
        data.append(dots(gone, [beyond] * len(gone), f"{found['machine']} lost", BEFORE, 9.0, "x"))
    alt = f"maximum error from {min(sizes):.2f} to {max(sizes):.2f} {unit}; lost at {len(gone)} values"
    title = f"{name}: nominal {rows[0]['nominal']:.3g} {rows[0]['unit']}; dashed: error doubled, and lost"
    return Plot(
        title, alt, f"{name} / {rows[0]['unit']}", f"error / {unit}", data, (doubled, beyond), log=True
    )
