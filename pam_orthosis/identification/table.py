# SPDX-License-Identifier: Apache-2.0
"""Measured tables: CSV files whose columns name their unit.

`p_Pa_gauge,L_m,F_N,slack` for example, or `pressure [bar gauge]`. Quantity, unit and (for a pressure)
reference stand in the name, so that no unit is ever guessed; other columns are not read, and that is said.
"""

import re
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import shown
from pam_orthosis.tables import read_numbers

# quantity -> symbol and word in a column's name, unit -> factor to SI
PRESSURES = {"Pa": 1.0, "hPa": 1e2, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "in": 0.0254}
FORCES = {"N": 1.0, "kN": 1e3, "kgf": 9.80665, "lbf": 4.448222}
MEASURED = {
    "length": ("L", "length", LENGTHS),
    "contraction": ("dL", "contraction", LENGTHS),
    "force": ("F", "force", FORCES),
    "sigma": ("sigma_F", "sigma", FORCES),
    "rate": ("v", "rate", {"m_s": 1.0, "mm_s": 1e-3}),
    "time": ("t", "time", {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0}),
    "volume": ("V", "volume", {"m3": 1.0, "l": 1e-3, "ml": 1e-6, "cm3": 1e-6, "mm3": 1e-9}),
    "mass": ("m", "mass", {"kg": 1.0, "g": 1e-3, "lb": 0.45359237}),
}
GAUGE, ABSOLUTE = ("_gauge", "_gage", "_rel", "_g", "g"), ("_abs", "_absolute", "_a", "a")
UNCERTAIN = {f"{name}_{unit}" for name in ("p", "pressure", "Pressure") for unit in PRESSURES}
BRACKETS = re.compile(r"[ _]*[\[(]([^\])]+)[\])]$")


def _spellings() -> dict[str, tuple[str, float, bool]]:
    """Return column -> quantity, factor to SI, whether it counts from vacuum."""
    plain_names = ("direction", "repeat", "slack")
    found = {text: (name, 1.0, False) for name in plain_names for text in (name, name.capitalize())}
    for quantity, (symbol, word, units) in MEASURED.items():
        for name, unit in product((symbol, word, word.capitalize()), units):
            found[f"{name}_{unit}"] = (quantity, units[unit], False)
    for plain, ending in product(sorted(UNCERTAIN), (*GAUGE, *ABSOLUTE)):
        factor = PRESSURES[plain.rpartition("_")[2]]
        found[plain + ending] = ("pressure", factor, ending in ABSOLUTE)
    return found


COLUMNS = _spellings()
EXAMPLES = {"pressure": "p_Pa_gauge", "force": "F_N"}
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
OTHER_UNIT = 100.0  # times a pressure, and none between: the rows below are in another unit
LONGEST = 3.0  # times the shortest length, beyond which a column must hold two units


class Table(NamedTuple):
    """Rows of a taut muscle in SI, (n,) each; None where the file has no such column.

    `marked`: the file says where the muscle hangs slack. `unread`: names of columns that hold none of these.
    """

    pressure: np.ndarray
    length: np.ndarray | None = None
    contraction: np.ndarray | None = None
    force: np.ndarray | None = None
    sigma: np.ndarray | None = None
    rate: np.ndarray | None = None
    time: np.ndarray | None = None
    direction: np.ndarray | None = None
    repeat: np.ndarray | None = None
    mass: np.ndarray | None = None
    volume: np.ndarray | None = None
    marked: bool = False
    unread: tuple[str, ...] = ()


def read_table(path: Path, ambient: float) -> Table:
    """Read a table; absolute pressures are reduced by the ambient one, Pa.

    Rows marked slack are left out, but a force-free end (F = 0) is kept.

    At the highest pressure that still hangs slack a muscle has its force-free length: that row
    carries information, those below do not.

    Raises:
        OrthosisError: unreadable, ambiguous, missing or doubled column, not a number, implausible values.
    """
    columns, unread = _columns(path, ambient)
    forceless = "volume" in columns or "mass" in columns
    for needed in ("pressure",) if forceless else ("pressure", "force"):
        if needed not in columns:
            there = f"; not read: {', '.join(unread)}" if unread else ""
            raise OrthosisError(f"{path}: no column for the {needed}; name it e.g. {EXAMPLES[needed]}{there}")
    if ("length" in columns) == ("contraction" in columns):
        raise OrthosisError(f"{path}: give either the length (L_m) or the contraction (dL_m)")
    for name, values in columns.items():
        _check(path, name, values)
    _check_units(path, columns)
    marked = "slack" in columns
    slack = columns.pop("slack", np.zeros(len(columns["pressure"]))) != 0
    if slack.all():
        raise OrthosisError(f"{path}: the muscle hangs slack in every row; measure at more pressure")
    kept = ~slack | _force_free_end(slack, columns)
    rows = {name: values[kept] for name, values in columns.items()}
    return Table(**rows, marked=marked, unread=unread)


def _force_free_end(slack: np.ndarray, columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Mark the slack row of highest pressure where the longest-travelled length never carries."""
    place = columns["contraction"] if "contraction" in columns else -columns["length"]
    end = place == place.max()
    mark = np.zeros(len(slack), dtype=bool)
    if (slack | ~end).all():
        rows = np.flatnonzero(end)
        mark[rows[np.argmax(columns["pressure"][rows])]] = True
    return mark


def _columns(path: Path, ambient: float) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return quantity -> values in SI, and the names of the columns that were not read."""
    result: dict[str, np.ndarray] = {}
    unread: list[str] = []

    def choose(names: Sequence[str]) -> list[str]:
        _check_names(path, names)
        unread.extend(name for name in names if name and _spelled(name) not in COLUMNS)
        return [name for name in names if _spelled(name) in COLUMNS]

    for name, values in read_numbers(path, choose).items():
        quantity, factor, absolute = COLUMNS[_spelled(name)]
        result[quantity] = factor * values - (ambient if absolute else 0.0)
    return result, tuple(unread)


def _spelled(name: str) -> str:
    """Return a column's name as `COLUMNS` has it: `pressure [bar gauge]` is `pressure_bar_gauge`."""
    return BRACKETS.sub(r"_\1", name).replace(" ", "_").replace("/", "_")


def _check_names(path: Path, names: Sequence[str]) -> None:
    quantities = set()
    for name in names:
        if _spelled(name) in UNCERTAIN:
            written = _spelled(name)
            raise OrthosisError(
                f"{path}: column {shown(name)} does not say from where the pressure counts: write"
                f" {written}_gauge or {written}_abs"
            )
        quantity = COLUMNS.get(_spelled(name), ("",))[0]
        if quantity in quantities:
            raise OrthosisError(f"{path}: two columns give the {quantity}; leave one, in one unit")
        quantities |= {quantity} if quantity else set()
    if not any(_spelled(name) in COLUMNS for name in names):
        known = ", ".join(dict.fromkeys((*PRESSURES, *LENGTHS, *FORCES)))
        raise OrthosisError(
            f"{path}: no column names a quantity and its unit, as p_Pa_gauge,L_m,F_N do; units are {known}"
        )


def _check(path: Path, name: str, values: np.ndarray) -> None:
    if name == "sigma" and (values <= 0).any():
        raise OrthosisError(f"{path}: standard deviations of the force must be positive")
    if name in PLAUSIBLE:
        low, high, unit = PLAUSIBLE[name]
        if values.min() < low or values.max() > high:
            cause = _cause(name, values)
            raise OrthosisError(
                f"{path}: {name} from {values.min():g} to {values.max():g} {unit} is implausible; {cause}"
            )
    if name == "direction" and set(values.tolist()) == {0.0, 1.0}:
        raise OrthosisError(
            f"{path}: direction is 1 or 0: write -1 where the muscle is stretched or vents, and leave rows at"
            " rest out"
        )
    if name == "pressure" and values.max() < 1.0e3:
        raise OrthosisError(f"{path}: the highest pressure is {values.max():g} Pa; is the unit bar?")


def _cause(name: str, values: np.ndarray) -> str:
    """Return what makes a column implausible, and what to do."""
    low, high, _ = PLAUSIBLE[name]
    if name == "force" and low <= -values.max() and -values.min() <= high:
        return "it has the other sign: a pull is positive"
    out = np.flatnonzero((values < low) | (values > high))
    few = 0.02  # of all rows: glitches rather than another unit
    if len(out) <= few * len(values):
        return (
            f"{len(out)} of {len(values)} rows, first row {out[0] + 1} ({values[out[0]]:g}): leave them out"
        )
    vacuum = -1.1e5  # Pa gauge
    if name == "pressure" and vacuum <= values.min() and values.max() <= high:
        return "it is below the ambient one: does a column named absolute hold gauge values?"
    return "check the unit in the column's name"


def _check_units(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Refuse rows in different units: bar among Pa, mm among m."""
    pressure, length = columns["pressure"], columns.get("length", np.ones(1))
    force = np.abs(columns.get("force", np.ones(len(pressure))))
    below = _in_other_unit(pressure)
    at_rest = 0.1  # of the largest force: a muscle that pulls less may well have no pressure
    if force[below].max(initial=0.0) > at_rest * force.max():
        _refuse_units(path, "pressure", pressure[pressure > 0])
    if length.max() > LONGEST * length.min():
        _refuse_units(path, "length", length)


def _in_other_unit(pressure: np.ndarray) -> np.ndarray:
    """Return which rows lie far below all others; a ramp has rows between, a sensor's noise is about zero."""
    noise = 5 * max(0.0, -float(pressure.min()))
    order = np.sort(pressure[pressure > noise])
    gaps = np.flatnonzero(order[1:] > OTHER_UNIT * order[:-1])
    highest = order[gaps[-1]] if len(gaps) else 0.0
    return (pressure > noise) & (pressure <= highest)


def _refuse_units(path: Path, name: str, values: np.ndarray) -> None:
    unit = PLAUSIBLE[name][2]
    raise OrthosisError(
        f"{path}: {name} from {values.min():g} to {values.max():g} {unit}: rows in different units?"
    )
