# SPDX-License-Identifier: Apache-2.0
"""Columns of anybody's tables: which one holds which signal, and its unit, which stands in its name.

`knee [deg]`, `p1 (bar gauge)` and `time_ms` name their units. A mapping `SIGNAL=COLUMN` says which column a
signal is; `SIGNAL=-COLUMN` turns its sign round, `SIGNAL=COLUMN:UNIT` gives a unit that the name does not.
"""

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.systems.system import Source, System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.reading import meant

# unit -> unit in SI, factor
UNITS = {
    "s": ("s", 1.0),
    "ms": ("s", 1e-3),
    "us": ("s", 1e-6),
    "rad": ("rad", 1.0),
    "deg": ("rad", math.pi / 180),
    "°": ("rad", math.pi / 180),
    "rad/s": ("rad/s", 1.0),
    "deg/s": ("rad/s", math.pi / 180),
    "m": ("m", 1.0),
    "mm": ("m", 1e-3),
    "cm": ("m", 1e-2),
    "m/s": ("m/s", 1.0),
    "mm/s": ("m/s", 1e-3),
    "Pa": ("Pa", 1.0),
    "hPa": ("Pa", 1e2),
    "kPa": ("Pa", 1e3),
    "MPa": ("Pa", 1e6),
    "bar": ("Pa", 1e5),
    "mbar": ("Pa", 1e2),
    "psi": ("Pa", 6894.757),
    "N": ("N", 1.0),
    "mN": ("N", 1e-3),
    "kN": ("N", 1e3),
    "N m": ("N m", 1.0),
    "Nm": ("N m", 1.0),
    "mN m": ("N m", 1e-3),
    "mNm": ("N m", 1e-3),
    "kN m": ("N m", 1e3),
    "kNm": ("N m", 1e3),
    "V": ("V", 1.0),
    "mV": ("V", 1e-3),
    "A": ("A", 1.0),
    "mA": ("A", 1e-3),
}
BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\])]+)[\])]$")
GAUGE = re.compile(r"[ _]?(gauge|gage|g|rel)$")
ABSOLUTE = re.compile(r"[ _]?(absolute|abs|a)$")


class Unit(NamedTuple):
    """What leads to SI: value * factor, plus the ambient pressure if it is `gauge`; `text` calls it."""

    si: str
    factor: float
    gauge: bool = False
    text: str = ""


class Place(NamedTuple):
    """The column of a signal, +1 or -1 for its direction, and its unit if there is one."""

    column: str
    sign: float
    unit: Unit | None


def read_mapping(given: Mapping[str, str] | Iterable[str]) -> dict[str, str]:
    """Return signal -> column from such a mapping, or from texts SIGNAL=COLUMN.

    Raises:
        OrthosisError: another text, a signal without a column or twice.
    """
    pairs = given.items() if isinstance(given, Mapping) else ()
    found: dict[str, str] = {}
    for text in [f"{signal}={column}" for signal, column in pairs] or given:
        signal, equals, column = text.partition("=")
        if not equals or not column.lstrip("-"):
            raise OrthosisError(f"--columns {text}: give SIGNAL=COLUMN")
        if signal in found:
            raise OrthosisError(f"--columns gives {signal} twice; give it once")
        found[signal] = column
    return found


def holds(path: str, name: str, mapping: Mapping[str, str], columns: Collection[str]) -> bool:
    """Return whether a table with these columns has a signal, by its name or by such a mapping."""
    wanted = _specified(mapping.get(name, name), columns)[0]
    return wanted in columns or _of_name(path, wanted, columns) is not None


def with_columns(system: System, mapping: Mapping[str, str], optional: Sequence[str] = ()) -> System:
    """Return a system whose signals are in these columns; OrthosisError for a signal that it has not.

    `optional`: signals that it would have if a table did.
    """
    own = ("time", *(channel.name for channel in system.channels), *system.inputs)
    known = tuple(dict.fromkeys((*own, *optional)))
    for name in mapping:
        if name not in own:
            raise OrthosisError(
                f"--columns {name}: no such signal{meant(name, known)}; there are: {_listed(known)}"
            )
    sources = {name: replace(system.sources.get(name, Source()), column=c) for name, c in mapping.items()}
    return replace(system, sources={**system.sources, **sources})


def places_of(path: str, system: System, columns: Collection[str]) -> dict[str, Place]:
    """Return where a table with these columns has a system's signals.

    Args:
        path: of the table, for messages.
        system: its sources name columns; another signal is the column of its name, with or without unit.
        columns: their names.

    Raises:
        OrthosisError: no column for a signal that is needed, or not that column, one for two signals, an
            unknown unit, or one of something else.
    """
    found, signal_of = {}, dict[str, str]()
    for name in ("time", *(channel.name for channel in system.channels), *system.inputs):
        source = system.sources.get(name, Source())
        wanted, sign, given = _specified(source.column or name, columns)
        column = wanted if wanted in columns else None
        if column is None and not _scales(source):
            column = _of_name(path, wanted, columns)
        if column is None:
            if source.column:
                raise OrthosisError(f"{path}: no column {wanted} for {name}; there are: {_listed(columns)}")
            continue
        if (other := signal_of.setdefault(column, name)) != name:
            raise OrthosisError(
                f"{path}: column {column} would be {other} and {name}; say by --columns which one it is"
            )
        own = "" if column == name or _scales(source) else _split(column)[1]
        unit = _unit(path, system, name, given or own)
        if _contradict(_known(own), unit):
            raise OrthosisError(
                f"{path}: column {column} names the unit {own}, --columns {name} gives {given}; leave that"
                " out, or rename the column if its unit is wrong"
            )
        found[name] = Place(column, sign, unit)
    missing = [name for name in ("time", *(channel.name for channel in system.channels)) if name not in found]
    if missing:
        raise OrthosisError(
            f"{path}: no column {_listed(missing)}; there are: {_listed(columns)}; say which is which, as in"
            f" --columns {missing[0]}=COLUMN, or by --machine of what other machine the table is"
        )
    return found


def signals_of(
    path: str, system: System, columns: Mapping[str, np.ndarray], ambient: float
) -> dict[str, np.ndarray]:
    """Return a system's signals, in its units, from the columns of a table; `ambient`, Pa, is gauge 0.

    Raises:
        OrthosisError: as `places_of`.
    """
    found = {}
    for name, (column, sign, unit) in places_of(path, system, columns).items():
        source, values = system.sources.get(name, Source()), sign * columns[column]
        scaled = source.factor * values + source.offset
        found[name] = scaled if unit is None else _in_si(system, name, values, unit, ambient)
    return found


def as_written(path: str, system: System, columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """Return signal -> the range of its column in the unit that the table gives, for those with a unit."""
    return {
        name: f"{np.nanmin(columns[at]):g} to {np.nanmax(columns[at]):g} {unit.text} in column {at}"
        for name, (at, _, unit) in places_of(path, system, columns).items()
        if unit is not None and not np.isnan(columns[at]).all()
    }


def _scales(source: Source) -> bool:
    """Return whether a source says itself what leads from the column to the signal."""
    return (source.factor, source.offset) != (1.0, 0.0)


def _specified(text: str, columns: Collection[str]) -> tuple[str, float, str]:
    """Return column, sign and unit of what a mapping gives."""
    if text in columns:
        return text, 1.0, ""
    sign, text = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    if text in columns or ":" not in text:
        return text, sign, ""
    column, _, unit = text.rpartition(":")
    return column, sign, unit


def _of_name(path: str, name: str, columns: Iterable[str]) -> str | None:
    """Return the column that is of this name but for its unit, capitals and spaces."""
    found = [column for column in columns if _plain(_split(column)[0]) == _plain(name)]
    if len(found) > 1:
        raise OrthosisError(f"{path}: {' and '.join(found)} both give {name}; say which one by --columns")
    return found[0] if found else None


def _plain(name: str) -> str:
    return name.lower().replace(" ", "_")


def _split(column: str) -> tuple[str, str]:
    """Return name and unit of a column; an empty unit if it names none."""
    match = BRACKETS.match(column)
    if match:
        return match["name"].strip(), match["unit"].strip()
    name, _, unit = column.rpartition("_")
    if name and _known(unit):
        return name, unit
    name, _, unit = column.removesuffix("_gauge").removesuffix("_abs").rpartition("_")
    if name and _known(unit):
        return name, column[len(name) + 1 :]
    return column, ""


def _known(text: str) -> Unit | None:
    """Return a unit; None if there is no such unit."""
    if text in UNITS:
        return Unit(*UNITS[text], text=text)
    for ending, gauge in ((GAUGE, True), (ABSOLUTE, False)):
        plain = ending.sub("", text)
        if plain != text and plain in UNITS and UNITS[plain][0] == "Pa":
            return Unit(*UNITS[plain], gauge, text)
    return None


def _unit(path: str, system: System, name: str, text: str) -> Unit | None:
    """Return the unit in which a signal is given; None if no text names one."""
    if not text:
        return None
    unit = _known(text)
    if unit is None:
        raise OrthosisError(f"{path}: unknown unit {text}; there are: {', '.join(UNITS)}, and bar gauge")
    if unit.si != (expected := system.unit(name)):
        raise OrthosisError(f"{path}: {name} is given in {unit.si}, and needs {expected or 'no unit'}")
    return unit


def _contradict(own: Unit | None, given: Unit | None) -> bool:
    """Return whether a column's unit is not what is given: of plain `bar` one may say `bar gauge`."""
    if own is None or given is None:
        return False
    said = own.text not in UNITS and given.text not in UNITS
    return own.factor != given.factor or (said and own.gauge != given.gauge)


def _in_si(system: System, name: str, values: np.ndarray, unit: Unit, ambient: float) -> np.ndarray:
    """Return values in the system's unit; pressures are absolute, unless its limits begin below 0."""
    absolute = system.is_absolute(name)
    return unit.factor * values + (ambient if unit.gauge and absolute else 0.0)


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names)
