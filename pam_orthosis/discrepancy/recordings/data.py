# SPDX-License-Identifier: Apache-2.0
"""Recordings as uniform arrays: from arrays, CSV tables or bags."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import butter, sosfiltfilt

from pam_orthosis.bag.fields import check_field
from pam_orthosis.bag.read import KNOWN, aligned, read_bag
from pam_orthosis.bag.topics import Signal
from pam_orthosis.discrepancy.recordings.columns import as_written, places_of, signals_of
from pam_orthosis.discrepancy.recordings.even import even
from pam_orthosis.discrepancy.recordings.ranges import in_range
from pam_orthosis.discrepancy.systems.system import Source, System
from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.tables import is_table, read_numbers

HIGHEST_CUTOFF = 0.4  # of the sampling rate
LONGEST_PERIOD = 0.5  # s, of samples: above it the time is in another unit
RARELY = 1.1  # times the period in which inputs change: at it and above, samples are missing between
LONGEST_LOOP = 0.05  # s: inputs that are held for longer are steps of an experiment
TOO_OLD = "too old"  # in remarks: inputs whose values are from before the loop changed them


@dataclass(frozen=True)
class Recording:
    """Measured channels and inputs at uniform instants.

    Attributes:
        name: in reports.
        period: sampling period, s.
        signals: name -> (n,) array, SI. A missing input is absent.
        remarks: on what it cannot show.
        start: instant of the first sample, s, by the clock that effects of time go by.
        left_out: inputs that it has, too rarely.
        unread: columns of its table that are none of the signals, nor of this package.
    """

    name: str
    period: float
    signals: Mapping[str, np.ndarray]
    remarks: tuple[str, ...] = ()
    start: float = 0.0
    left_out: tuple[str, ...] = ()
    unread: tuple[str, ...] = ()

    @property
    def samples(self) -> int:
        """The number of samples."""
        return len(next(iter(self.signals.values())))

    @property
    def duration(self) -> float:
        """Duration, s."""
        return self.samples * self.period

    def part(self, start: int, stop: int, name: str) -> Recording:
        """Return the samples from start to stop as a recording of its own, by the same clock."""
        signals = {key: value[start:stop] for key, value in self.signals.items()}
        return replace(self, name=name, signals=signals, start=self.start + start * self.period)


def recording(path: Path, system: System, namespace: str = "") -> Recording:
    """Return the recording of a table or a bag: see `from_csv` and `from_bag`."""
    return from_csv(path, system) if is_table(path) else from_bag(path, system, namespace)


def from_arrays(name: str, system: System, arrays: Mapping[str, np.ndarray]) -> Recording:
    """Return a recording from arrays by signal name, with `time` in s; a row with a NaN is a missing one.

    Raises:
        OrthosisError: signals missing, infinite, or with too many rows missing.
    """
    wanted = [*(channel.name for channel in system.channels), *system.inputs]
    missing = [key for key in ("time", *(c.name for c in system.channels)) if key not in arrays]
    if missing:
        hint = f"the model is of the {system.name.removeprefix('a ')}"
        raise OrthosisError(f"{name}: no signal {', '.join(missing)}; there are: {', '.join(arrays)}; {hint}")
    time = np.asarray(arrays["time"], dtype=float)
    signals = {key: np.asarray(arrays[key], dtype=float) for key in wanted if key in arrays}
    for key, values in {"time": time, **signals}.items():
        if len(values) != len(time):
            raise OrthosisError(f"{name}: {key} has {len(values)} samples, time has {len(time)}")
        if np.isinf(values).any():
            raise OrthosisError(f"{name}: {key} is infinite at sample {int(np.argmax(np.isinf(values)))}")
    held = set(system.inputs) - set(system.gradual)
    found = even(name, time, signals, held)
    remarks = tuple(f"{name}: {remark}" for remark in found.remarks)
    return Recording(name, found.period, found.signals, remarks, found.start)


def from_bag(path: Path, system: System, namespace: str = "") -> Recording:
    """Return the recording of a bag; inputs that it does not have, or too rarely, are absent.

    Raises:
        OrthosisError: unreadable bag, missing channel, values not finite, not uniform in time, or that cannot
            be in the unit that is asked for.
    """
    channels = [channel.name for channel in system.channels]
    with naming(path):
        signals, optional = _signals(system, channels), _signals(system, system.inputs)
    bag = read_bag(path, signals, optional=optional, namespace=namespace)
    names = [name for name in (*channels, *system.inputs) if name in bag.series]
    stamps, values = aligned(*(bag[name] for name in names))
    if len(stamps) < 2:
        raise OrthosisError(f"{path}: {', '.join(names)} have no common stamps")
    scaled = [_scaled(system, name, one) for name, one in zip(names, values, strict=True)]
    arrays = {"time": (stamps - stamps[0]) * 1e-9, **dict(zip(names, scaled, strict=True))}
    recording = _in_range(str(path), system, arrays)
    return with_prompt_inputs(recording, system, bag.parameters.get(system.input_period, recording.period))


def _signals(system: System, names: Iterable[str]) -> list[str | Signal]:
    """Return where a bag has signals: in the places of the system's sources, or of the tables by name.

    Raises:
        OrthosisError: neither knows the place of one, or its topic cannot have it.
    """
    found: list[str | Signal] = []
    for name in names:
        one = system.sources.get(name, Source())
        if not one.topic and name not in KNOWN:
            raise OrthosisError(
                f"no .csv table, so read as a ROS bag; but {system.name} does not say under which topic"
                f" {name} is: give tables, or the topic in `sources`"
            )
        signal = Signal(name, one.topic, one.field, one.joint, "", one.type, one.spool)
        if one.topic:
            check_field(signal)
        found.append(signal if one.topic else name)
    return found


def _scaled(system: System, name: str, values: np.ndarray) -> np.ndarray:
    """Return a signal in its unit from what was recorded."""
    if name not in system.sources:
        return values
    return system.sources[name].factor * values + system.sources[name].offset


def with_prompt_inputs(
    one: Recording, system: System, changed: float, rows: int = 1, stated: bool = True
) -> Recording:
    """Return a recording without held inputs that changed more often (every so many s) than recorded.

    `rows`: every how many samples they were recorded; `stated`: how often they changed is not assumed.
    """
    late = _held(one, system)
    recorded = rows * one.period
    if not late or recorded < RARELY * changed:
        return one
    kept = {key: values for key, values in one.signals.items() if key not in late}
    source = f"{'' if stated else 'the default of '}{system.input_period}"
    remark = (
        f"{one.name}: {', '.join(late)} change every {1e3 * changed:.3g} ms by {source} and were"
        f" recorded every {1e3 * recorded:.3g} ms: left out, what they drive cannot be judged; record faster,"
        f" or correct {system.input_period} (of tables by --model)"
    )
    return replace(one, signals=kept, remarks=(*one.remarks, remark), left_out=late)


def with_loop_of_table(one: Recording, system: System, changed: float, stated: bool) -> Recording:
    """Return the recording of a table, which does not say how often the loop changed its inputs.

    The nominal model does (every so many s); unless the user stated it, inputs that are held do rather.
    """
    held = _held(one, system)
    rows = _held_rows([one.signals[name] for name in held])
    rows = rows if rows * one.period <= LONGEST_LOOP else 1
    prompt = with_prompt_inputs(one, system, changed, rows, stated) if stated or rows == 1 else one
    if stated or prompt.left_out or not held:
        return prompt
    names, apart = ", ".join(held), f"{1e3 * rows * one.period:.3g} ms"
    told = (
        f"{one.name}: {names} change every {rows} rows: the loop's period is taken to be {apart}"
        if rows > 1
        else f"{names}: the loop's period is assumed to be {1e3 * changed:.3g} ms"
    )
    remark = (
        f"{told}; if it is shorter than {apart}, they are {TOO_OLD} to drive the model: give"
        f" {system.input_period} by --model"
    )
    return replace(one, remarks=(*one.remarks, remark))


def _held(one: Recording, system: System) -> tuple[str, ...]:
    """Return the inputs of a recording that keep their value from sample to sample: commands of a loop."""
    return tuple(name for name in system.inputs if name in one.signals and name not in system.gradual)


def _held_rows(inputs: Sequence[np.ndarray]) -> int:
    """Return every how many samples inputs change; 1 if that varies."""
    changes = [np.diff(values) != 0 for values in inputs]
    apart = np.diff(np.flatnonzero(np.any(changes, axis=0))) if changes else np.array([])
    rows = int(apart.min()) if len(apart) else 1
    return rows if (apart % rows == 0).all() else 1


def from_csv(path: Path, system: System) -> Recording:
    """Return the recording of a CSV table whose first row names the columns (`time`, signal names; SI).

    `time` may be dates or times of the day.

    Raises:
        OrthosisError: as `tables.read_numbers`, signals missing, not uniform in time, or values that cannot
            be in the unit that is asked for.
    """
    name, unread = str(path), list[str]()

    def used(columns: Sequence[str]) -> set[str]:
        read = {place.column for place in places_of(name, system, columns).values()}
        known = {"", *read, *system.also_recorded}
        unread.extend(column for column in columns if column not in known)
        return read

    def dated(columns: Sequence[str]) -> set[str]:
        time = places_of(name, system, columns)["time"]
        scaled = time.unit is not None or system.sources.get("time", Source()).factor != 1.0
        return set() if scaled else {time.column}

    columns = read_numbers(path, used, lost=True, dated=dated)
    written = as_written(name, system, columns)
    one = _in_range(name, system, signals_of(name, system, columns, system.ambient), written)
    return replace(one, unread=tuple(unread))


def _in_range(
    name: str, system: System, arrays: Mapping[str, np.ndarray], written: Mapping[str, str] | None = None
) -> Recording:
    """Return the recording of arrays whose values can be in SI; `written`: as `ranges.in_range`."""
    inside, remarks = in_range(name, system, arrays, written or {})
    one = from_arrays(name, system, inside)
    if one.period > LONGEST_PERIOD:
        raise OrthosisError(
            f"{name}: its samples are {one.period:g} apart; time must be in s (is it in ms?), samples at"
            f" most {LONGEST_PERIOD:g} s apart"
        )
    return replace(one, remarks=(*remarks, *one.remarks))


def smoothed(values: np.ndarray, period: float, cutoff: float) -> np.ndarray:
    """Return a signal without what is above a cutoff, Hz, and without delay (zero phase)."""
    share = min(2 * cutoff * period, 2 * HIGHEST_CUTOFF)
    smooth: np.ndarray = sosfiltfilt(butter(2, share, output="sos"), values)
    return smooth
