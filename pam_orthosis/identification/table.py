# SPDX-License-Identifier: Apache-2.0
"""Measured tables: CSV files whose columns name their unit.

`p_Pa_gauge,L_m,F_N,slack` for example. Quantity, unit and (for a pressure) reference stand in the
name; other columns are refused, so that no unit is ever guessed.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import shown
from pam_orthosis.tables import read_numbers

# column -> quantity, factor to SI, whether it counts from vacuum
COLUMNS = {
    **{f"p_{u}_gauge": ("pressure", f, False) for u, f in (("Pa", 1.0), ("kPa", 1e3), ("bar", 1e5))},
    **{f"p_{u}_abs": ("pressure", f, True) for u, f in (("Pa", 1.0), ("kPa", 1e3), ("bar", 1e5))},
    **{f"L_{u}": ("length", f, False) for u, f in (("m", 1.0), ("mm", 1e-3))},
    **{f"dL_{u}": ("contraction", f, False) for u, f in (("m", 1.0), ("mm", 1e-3))},
    **{f"F_{u}": ("force", f, False) for u, f in (("N", 1.0), ("kN", 1e3))},
    **{f"sigma_F_{u}": ("sigma", f, False) for u, f in (("N", 1.0), ("kN", 1e3))},
    **{f"v_{u}": ("rate", f, False) for u, f in (("m_s", 1.0), ("mm_s", 1e-3))},
    **{f"t_{u}": ("time", f, False) for u, f in (("s", 1.0), ("ms", 1e-3))},
    **{f"V_{u}": ("volume", f, False) for u, f in (("m3", 1.0), ("l", 1e-3), ("cm3", 1e-6))},
    "m_kg": ("mass", 1.0, False),
    "direction": ("direction", 1.0, False),
    "repeat": ("repeat", 1.0, False),
    "slack": ("slack", 1.0, False),
}
# what a column in the right unit cannot exceed
PLAUSIBLE = {
    "pressure": (-1.0e3, 1.5e6, "Pa gauge"),
    "length": (0.03, 10.0, "m"),
    "contraction": (-0.5, 3.0, "m"),
    "force": (-100.0, 2.0e4, "N"),
    "rate": (-5.0, 5.0, "m/s"),
    "volume": (1.0e-9, 0.1, "m^3"),
    "mass": (1.0e-3, 1.0e4, "kg"),
    "direction": (-1.0, 1.0, "(1 shortening or filling, -1 stretching or venting)"),
}
# largest / smallest typical value beyond which a column must hold two units
MIXED = {"pressure": 100.0, "length": 3.0}


class Table(NamedTuple):
    """Rows of a taut muscle in SI, (n,) each; None where the file has no such column.

    `marked`: the file says where the muscle hangs slack.
    """

    pressure: np.ndarray
    length: np.ndarray | None
    contraction: np.ndarray | None
    force: np.ndarray | None
    sigma: np.ndarray | None
    rate: np.ndarray | None
    time: np.ndarray | None
    direction: np.ndarray | None
    repeat: np.ndarray | None
    mass: np.ndarray | None
    volume: np.ndarray | None
    marked: bool = False


def read_table(path: Path, ambient: float) -> Table:
    """Read a table; absolute pressures are reduced by the ambient one, Pa.

    Rows marked slack are left out, but a force-free end (F = 0) is kept.

    At the highest pressure that still hangs slack a muscle has its force-free length: that row
    carries information, those below do not.

    Raises:
        OrthosisError: unreadable, unknown or doubled column, not a number, implausible values.
    """
    columns = _columns(path, ambient)
    for needed in ("pressure",) if "volume" in columns else ("pressure", "force"):
        if needed not in columns:
            example = next(column for column, (name, *_) in COLUMNS.items() if name == needed)
            raise OrthosisError(f"{path}: no column for the {needed}; name it e.g. {example}")
    if ("length" in columns) == ("contraction" in columns):
        raise OrthosisError(f"{path}: give either the length (L_m) or the contraction (dL_m)")
    for name, values in columns.items():
        _check(path, name, values)
    marked = "slack" in columns
    slack = columns.pop("slack", np.zeros(len(columns["pressure"]))) != 0
    if slack.all():
        raise OrthosisError(f"{path}: the muscle hangs slack in every row; measure at more pressure")
    kept = ~slack | _force_free_end(slack, columns)
    names = (name for name in Table._fields if name != "marked")
    rows = {name: columns[name][kept] if name in columns else None for name in names}
    return Table(**rows, marked=marked)


def _force_free_end(slack: np.ndarray, columns) -> np.ndarray:
    """Mark the slack row of highest pressure where the longest-travelled length never carries."""
    place = columns["contraction"] if "contraction" in columns else -columns["length"]
    end = place == place.max()
    mark = np.zeros(len(slack), dtype=bool)
    if (slack | ~end).all():
        rows = np.flatnonzero(end)
        mark[rows[np.argmax(columns["pressure"][rows])]] = True
    return mark


def _columns(path: Path, ambient: float) -> dict[str, np.ndarray]:
    result: dict[str, np.ndarray] = {}
    for name, values in read_numbers(path, partial(_check_names, path)).items():
        quantity, factor, absolute = COLUMNS[name]
        result[quantity] = factor * values - (ambient if absolute else 0.0)
    return result


def _check_names(path: Path, names: Sequence[str]) -> None:
    quantities = set()
    for name in names:
        if name not in COLUMNS:
            raise OrthosisError(f"{path}: column {shown(name)} is unknown; there are {', '.join(COLUMNS)}")
        if COLUMNS[name][0] in quantities:
            raise OrthosisError(f"{path}: two columns give the {COLUMNS[name][0]}; leave one, in one unit")
        quantities.add(COLUMNS[name][0])


def _check(path: Path, name: str, values: np.ndarray) -> None:
    if name == "sigma" and (values <= 0).any():
        raise OrthosisError(f"{path}: standard deviations of the force must be positive")
    if name in PLAUSIBLE:
        low, high, unit = PLAUSIBLE[name]
        if values.min() < low or values.max() > high:
            raise OrthosisError(
                f"{path}: {name} from {values.min():g} to {values.max():g} {unit} is implausible;"
                " check the unit in the column's name"
            )
    positive = values[values > 0]
    if name in MIXED and len(positive) and positive.max() > MIXED[name] * positive.min():
        raise OrthosisError(
            f"{path}: {name} from {positive.min():g} to {positive.max():g} {PLAUSIBLE[name][2]}:"
            " rows in different units?"
        )
    if name == "pressure" and values.max() < 1.0e3:
        raise OrthosisError(f"{path}: the highest pressure is {values.max():g} Pa; is the unit bar?")
