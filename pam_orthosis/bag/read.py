# SPDX-License-Identifier: Apache-2.0
"""Read bags, ours and those of `ros2 bag record`, into arrays keyed by header stamp."""

import json
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag import messages
from pam_orthosis.bag.bounded import damage_told, open_bag
from pam_orthosis.bag.cdr import Reader, serialised_stamp_ns
from pam_orthosis.bag.definitions import FIELDS
from pam_orthosis.bag.information import RUN_RECORD
from pam_orthosis.bag.leg_messages import LegMessages
from pam_orthosis.bag.rig_topics import RIG_SIGNALS
from pam_orthosis.bag.topics import MOTION, SECOND_NS, Signal, Topics
from pam_orthosis.bag.unpack import metadata_records
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import voltage_of
from pam_orthosis.model.device import MACHINE
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import machine_from, machine_named
from pam_orthosis.model.parameters import Section, load
from pam_orthosis.reading import from_json, shown

VOLTAGES = tuple(f"valve.{which}_voltage" for which in ("minimum", "closed", "maximum"))
KNOWN = {**RIG_SIGNALS, **Topics(machine_named()).signals}
# what a signal in the right unit cannot leave
PLAUSIBLE = {
    "rad": (-10.0, 10.0),
    "rad/s": (-1e3, 1e3),
    "rad/s^2": (-1e5, 1e5),
    "Pa": (-1e4, 1e7),
    "kg/s": (-10.0, 10.0),
    "V": (-100.0, 100.0),
    "N": (-1e6, 1e6),
    "N m": (-1e5, 1e5),
    "m": (-10.0, 10.0),
    "m/s": (-100.0, 100.0),
    "m/s^2": (-1e4, 1e4),
}


class Series(NamedTuple):
    """A signal: strictly rising stamps (n,) int64 in ns, values (n,) float64 in SI."""

    stamp_ns: np.ndarray
    value: np.ndarray


@dataclass(frozen=True)
class Bag:
    """What was read: series by signal name; run metadata, parameters (both empty if foreign); whose it is."""

    path: Path
    series: Mapping[str, Series]
    run: Mapping[str, str]
    parameters: Mapping[str, Any]
    machine: Machine

    def __getitem__(self, signal: str) -> Series:
        """Return a signal's series."""
        return self.series[signal]


def read_bag(
    path: Path, signals: Iterable[str | Signal], optional: Iterable[str | Signal] = (), namespace: str = ""
) -> Bag:
    """Read signals from a bag folder or file: those of its machine or of the rig by name, others as given.

    Args:
        path: folder with `metadata.yaml`, or an `.mcap` or `.db3` file.
        signals: those that must be there.
        optional: those that are left out where the bag has no such topic.
        namespace: of the leg, e.g. `/left`.

    Raises:
        OrthosisError: missing, unclosed, damaged or empty bag; topic missing or of another type;
            value not finite.
    """
    path = Path(path)
    with open_bag(path) as reader:
        run = run_record(path, namespace)
        machine = machine_of(path, run)
        wanted, more = _found(path, machine, signals), _found(path, machine, optional)
        source = LegMessages(reader, path, namespace, recorded_valve(path, run, namespace))
        series = _read(source, wanted, more)
    return Bag(path, series, run, recorded_parameters(path, run, namespace), machine)


def _found(path: Path, machine: Machine, signals: Iterable[str | Signal]) -> list[Signal]:
    known, signals = {**RIG_SIGNALS, **Topics(machine).signals}, list(signals)
    if strange := [one for one in signals if isinstance(one, str) and one not in known]:
        raise OrthosisError(f"{path} is of a {machine.name}, which has no {strange[0]}")
    return [known[one] if isinstance(one, str) else one for one in signals]


def raw_messages(
    path: Path, topics: Iterable[str], namespace: str = "", table: Topics | None = None
) -> dict[str, dict[int, bytes]]:
    """Return the serialised messages of topics by topic and stamp; absent ones are left out.

    They are those of a table, or of that of the machine that the bag names. OrthosisError as of `read_bag`.
    """
    path = Path(path)
    found: dict[str, dict[int, bytes]] = {}
    table = table or Topics(recorded_machine(path, namespace))
    with open_bag(path) as reader:
        valve = recorded_valve(path, run_record(path, namespace), namespace)
        source = LegMessages(reader, path, namespace, valve)
        there = [topic for topic in topics if source.has(topic)]
        for topic in there:
            source.check(topic, table.by_name[topic].type)
        for topic, data in source.raw(there):
            found.setdefault(topic, {}).setdefault(serialised_stamp_ns(data), data)
    return found


def run_record(path: Path, namespace: str = "") -> dict[str, str]:
    """Return the run metadata of a bag of ours, empty for another; OrthosisError if it is damaged.

    In the namespace of another machine they are those of this machine.
    """
    run = _run_record(path)
    own = legs_of(path, run).get(namespace.strip("/"), {}) if namespace else {}
    if MACHINE[0] not in own:
        return run
    machine = {key: own[key] for key in MACHINE}
    values = {key: value for key, value in own.items() if key not in MACHINE}
    return (
        {key: value for key, value in run.items() if key != "legs"}
        | machine
        | {"parameters": json.dumps(values)}
    )


def _run_record(path: Path) -> dict[str, str]:
    with damage_told(path):
        for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
            for record in metadata_records(file) if file.suffix == ".mcap" else ():
                if record.name == RUN_RECORD:
                    return dict(record.metadata)
    return {}


def machine_of(path: Path, run: Mapping[str, str]) -> Machine:
    """Return the machine that a bag's run metadata name: of the file in it, or the shipped one."""
    if not (text := run.get("machine")):
        return machine_named()
    return machine_from(text, run.get("machine_name", "machine"), f"{path}: the machine in its run metadata")


def recorded_machine(path: Path, namespace: str = "") -> Machine:
    """Return the machine of a bag, or of one of its namespaces.

    If it cannot be read, the shipped one: whoever reads its signals reports what is wrong with it.
    """
    try:
        run = run_record(path, namespace)
    except OrthosisError:
        return machine_named()
    return machine_of(path, run)


def recorded_parameters(path: Path, run: Mapping[str, str], namespace: str = "") -> dict[str, Any]:
    """Return the parameters of the run metadata, as they were for a leg; empty if there are none.

    OrthosisError if they are no JSON, or a value is one that no run can have had.
    """
    recorded = _mapping(path, run.get("parameters", "{}"))
    if namespace and recorded:
        recorded |= _checked(path, legs_of(path, run).get(namespace.strip("/"), {}))
    if not recorded:
        return {}
    known = load({}, machine_of(path, run))
    try:
        return {key: known.accepted(key, value) for key, value in recorded.items()}
    except OrthosisError as error:
        raise OrthosisError(f"{path}: its run metadata are unusable: {error}") from error


def recorded_valve(path: Path, run: Mapping[str, str], namespace: str = "") -> Section:
    """Return the rows of the valves, as they were for a leg: those of the machine where a bag has none."""
    recorded = recorded_parameters(path, run, namespace)
    rows = {key: value for key, value in recorded.items() if key in VOLTAGES}
    valve: Section = load(rows, machine_of(path, run)).valve
    return valve


def legs_of(path: Path, run: Mapping[str, str]) -> dict[str, Any]:
    """Return legs and in which parameters each differs; empty for one; OrthosisError if no JSON mapping."""
    return _mapping(path, run.get("legs", "{}"))


def _mapping(path: Path, text: str) -> dict[str, Any]:
    return _checked(path, from_json(text, f"{path}: what its run metadata say of parameters"))


def _checked(path: Path, recorded: Any) -> dict[str, Any]:
    if not isinstance(recorded, dict):
        raise OrthosisError(f"{path}: the parameters in its run metadata are no mapping: {shown(recorded)}")
    return recorded


def aligned(*series: Series) -> tuple[np.ndarray, list[np.ndarray]]:
    """Join series by stamp: the stamps that all have, and each one's values there."""
    stamps = reduce(np.intersect1d, (one.stamp_ns for one in series))
    return stamps, [one.value[np.searchsorted(one.stamp_ns, stamps)] for one in series]


def _read(source: LegMessages, signals: Sequence[Signal], more: Sequence[Signal]) -> dict[str, Series]:
    there = {one.name: found for one in (*signals, *more) if (found := _found_in(source, one))}
    if lacking := [one for one in signals if one.name not in there]:
        raise source.missing(lacking[0])
    wanted = defaultdict(list)
    for signal in there.values():
        source.check(signal.topic, signal.type)
        wanted[signal.topic].append(signal)
    columns = _columns(source, wanted)
    optional = {signal.name for signal in more}
    return {
        name: _series(source, signal, *columns[name])
        for name, signal in there.items()
        if len(columns[name][0]) or name not in optional
    }


def _columns(
    source: LegMessages, wanted: Mapping[str, Sequence[Signal]]
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return stamps, ns, and recorded numbers of the signals that are wanted of topics."""
    readers = {topic: _reader(signals) for topic, signals in wanted.items()}
    samples: dict[str, list[tuple[int, tuple[float, ...]]]] = {topic: [] for topic in wanted}
    for topic, data in source.raw(wanted):
        samples[topic].append(readers[topic](data))
    columns: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for topic, signals in wanted.items():
        stamps = np.array([stamp for stamp, _ in samples[topic]], dtype=np.int64)
        rows = np.array([row for _, row in samples[topic]], dtype=float).reshape(-1, len(signals))
        columns |= {signal.name: (stamps, rows[:, index]) for index, signal in enumerate(signals)}
    return columns


def _reader(signals: Sequence[Signal]) -> Callable[[bytes], tuple[int, tuple[float, ...]]]:
    """Return what takes the stamp and the signals of a topic out of its serialised messages."""
    kind = signals[0].type
    if kind in FIELDS:
        return Reader(kind, [_path(signal) for signal in signals])
    values = attrgetter(*(signal.field for signal in signals), "header.stamp.sec")

    def read(data: bytes) -> tuple[int, tuple[float, ...]]:
        message = messages.deserialised(kind, data)
        return messages.stamp_ns(message), values(message)[:-1]

    return read


def _path(signal: Signal) -> str:
    """Return where in a message a signal is."""
    point = "points[0]." if signal.type == MOTION else ""
    return f"{point}{signal.field}['{signal.joint}']" if signal.joint else signal.field


def _found_in(source: LegMessages, signal: Signal) -> Signal | None:
    """Return a signal with the topic that a bag has for it, if there is one."""
    if source.has(signal.topic):
        return signal
    return signal._replace(topic=signal.instead) if signal.instead and source.has(signal.instead) else None


def _series(source: LegMessages, signal: Signal, stamps: np.ndarray, values: np.ndarray) -> Series:
    path = source.path
    if not len(stamps):
        raise OrthosisError(f"{path}: topic {signal.topic} is empty, needed for {signal.name}")
    stamp_ns, first = np.unique(stamps, return_index=True)
    value = values[first]
    if signal.spool:
        value = np.array([voltage_of(position, source.valve) for position in value])
    bad = ~np.isfinite(value)
    if bad.any():
        where = stamp_ns[np.argmax(bad)] / SECOND_NS
        joint = f" (of the joint {signal.joint})" if signal.joint else ""
        raise OrthosisError(
            f"{path}: {signal.name} on {signal.topic}{joint} is missing or not finite at {where:.3f} s"
        )
    low, high = PLAUSIBLE.get(signal.unit, (-np.inf, np.inf))
    if value.min() < low or value.max() > high:
        raise OrthosisError(
            f"{path}: {signal.name} on {signal.topic} from {value.min():g} to {value.max():g} {signal.unit}"
            " is implausible; check its unit"
        )
    return Series(stamp_ns, value)
