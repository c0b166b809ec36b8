# SPDX-License-Identifier: Apache-2.0
"""In how many intervals of `identify` lie the coefficients of another repeat of the measurement?

The emulated rig is that of the tests: hysteresis, creep, and sensors whose zeros differ between repeats.
Beside it, what intervals hold that are made of the runs to and fro, for want of a column `repeat`.

    python benchmarks/identify_repeats.py > benchmarks/results/identify_repeats.jsonl
"""

import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "test" / "identification"))

from muscle_rig import LENGTH, NAMES, repeat, write

from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.force import ForceFit, fit_force
from pam_orthosis.identification.identify import usable

SEED, SAMPLES = 20, 20  # samples one way at each pressure
REPEATS, RIGS, OTHERS = (3, 4, 6), 40, 200
DEGREES = (3, 4)


def fitted(random: np.random.Generator, count: int) -> dict[str, ForceFit]:
    """Return the fits to some repeats by what intervals are made of: repeats, runs."""
    rows = np.vstack([repeat(number, random, samples=SAMPLES) for number in range(count)])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rows.csv"
        tables = {"repeats": (rows, NAMES), "runs": (rows[:, :-1], NAMES.removesuffix(",repeat"))}
        return {
            kind: fit_force(usable(read_data([write(path, *one)], "dmsp_20", LENGTH), 0.0, DEGREES)[0])
            for kind, one in tables.items()
        }


def coefficients(fit: ForceFit) -> np.ndarray:
    """Return the coefficients of a fit in one row."""
    return np.concatenate([fit.model.a, fit.model.b])


def measured() -> Iterator[dict[str, Any]]:
    """Yield for each number of repeats what share of other repeats' coefficients lies inside.

    `low`: an interval in ten holds so few of them, or fewer.
    """
    random = np.random.default_rng(SEED)
    others = np.array([coefficients(fitted(random, 1)["runs"]) for _ in range(OTHERS)])
    for count in REPEATS:
        fits = [fitted(random, count) for _ in range(RIGS)]
        for kind in fits[0]:
            chosen = [one[kind] for one in fits]
            each = np.mean([np.abs(coefficients(f) - others) < f.half_width for f in chosen], axis=1)
            yield {
                "repeats": count, "rigs": RIGS, "others": OTHERS, "by": kind,
                "held": each.mean(axis=0).tolist(), "low": float(np.quantile(each, 0.1)),
            }  # fmt: skip


def table(results: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a Markdown table."""
    yield (
        "| repeats | intervals of repeats hold | worst coefficient | one interval in ten: at most"
        " | without the column `repeat` |"
    )
    yield "|---|---|---|---|---|"
    held = {(one["repeats"], one["by"]): np.array(one["held"]) for one in results}
    low = {one["repeats"]: one["low"] for one in results if one["by"] == "repeats"}
    for count in dict(held):
        if count[1] == "repeats":
            own, runs = held[count], held[count[0], "runs"]
            shares = own.mean(), own.min(), low[count[0]], runs.mean()
            yield " | ".join([f"| {count[0]}", *(f"{share:.0%}" for share in shares)]) + " |"


if __name__ == "__main__":
    for row in measured():
        print(json.dumps(row), flush=True)
