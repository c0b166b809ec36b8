# SPDX-License-Identifier: Apache-2.0
"""Read bags, ours and those of `ros2 bag record`, into arrays keyed by header stamp."""

from __future__ import annotations

import json
import struct
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.record import METADATA_FILE, RUN_RECORD
from pam_orthosis.bag.topics import BY_NAME, SECOND_NS, SIGNALS, Signal, resolve
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

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
}


class Series(NamedTuple):
    """A signal: strictly rising stamps (n,) int64 in ns, values (n,) float64 in SI."""

    stamp_ns: np.ndarray
    value: np.ndarray


@dataclass(frozen=True)
class Bag:
    """What was read: series by signal name; run metadata, parameters (both empty if foreign)."""

    path: Path
    series: Mapping[str, Series]
    run: Mapping[str, str]
    parameters: Mapping[str, Any]

    def __getitem__(self, signal: str) -> Series:
        """Return a signal's series."""
        return self.series[signal]


def read_bag(path: Path, signals: Iterable[str], optional: Iterable[str] = (), namespace: str = "") -> Bag:
    """Read signals of the table `bag.topics.SIGNALS` from a bag folder or file.

    Args:
        path: folder with `metadata.yaml`, or an `.mcap` or `.db3` file.
        signals: names that must be there.
        optional: names that are left out where the bag has no such topic.
        namespace: of the leg, e.g. `/left`.

    Raises:
        OrthosisError: missing, unclosed, damaged or empty bag; topic missing or of another type;
            value not finite.
    """
    path = Path(path)
    _check_path(path)
    store = get_typestore(Stores.ROS2_JAZZY)
    with damage_told(path), AnyReader([path], default_typestore=store) as reader:
        series = _read(reader, path, list(signals), set(optional), namespace)
    run = run_record(path)
    return Bag(path, series, run, recorded_parameters(path, run, namespace))


def raw_messages(path: Path, topics: Iterable[str], namespace: str = "") -> dict[str, dict[int, bytes]]:
    """Return the serialised messages of topics of the table, by topic and stamp; absent ones are left out.

    Raises:
        OrthosisError: missing, unclosed or damaged bag; a topic of another type.
    """
    path = Path(path)
    _check_path(path)
    names = {resolve(topic, namespace): topic for topic in topics}
    messages: dict[str, dict[int, bytes]] = {}
    store = get_typestore(Stores.ROS2_JAZZY)
    with damage_told(path), AnyReader([path], default_typestore=store) as reader:
        connections = [one for one in reader.connections if one.topic in names]
        for one in connections:
            _check_type(path, one, BY_NAME[names[one.topic]].type)
        for connection, _, data in reader.messages(connections) if connections else ():
            messages.setdefault(names[connection.topic], {}).setdefault(_stamp_ns(data), bytes(data))
    return messages


def run_record(path: Path) -> dict[str, str]:
    """Return the run metadata of a bag of ours, empty for another; OrthosisError if it is damaged."""
    with damage_told(path):
        for file in [path] if path.is_file() else sorted(path.glob("*.mcap")):
            if file.suffix == ".mcap":
                with open(file, "rb") as stream:
                    for record in make_reader(stream).iter_metadata():
                        if record.name == RUN_RECORD:
                            return dict(record.metadata)
    return {}


def recorded_parameters(path: Path, run: Mapping[str, str], namespace: str = "") -> dict[str, Any]:
    """Return the parameters of the run metadata, as they were for a leg; empty if there are none.

    Raises:
        OrthosisError: they are no JSON, or a value is one that no run can have had.
    """
    recorded = _mapping(path, run.get("parameters", "{}"))
    if namespace and recorded:
        legs = legs_of(path, run)
        recorded |= _mapping(path, json.dumps(legs.get(namespace.strip("/"), {})))
    known = load() if recorded else None
    try:
        return {key: known.accepted(key, value) for key, value in recorded.items()}
    except OrthosisError as error:
        raise OrthosisError(f"{path}: its run metadata are unusable: {error}") from error


def legs_of(path: Path, run: Mapping[str, str]) -> dict[str, Any]:
    """Return the legs of the run metadata, and in which parameters each differs; empty for one leg.

    Raises:
        OrthosisError: that is no JSON mapping.
    """
    return _mapping(path, run.get("legs", "{}"))


def _mapping(path: Path, text: str) -> dict[str, Any]:
    try:
        recorded = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise OrthosisError(f"{path}: the parameters in its run metadata are unreadable ({error})") from error
    if not isinstance(recorded, dict):
        raise OrthosisError(f"{path}: the parameters in its run metadata are no mapping: {text[:40]}")
    return recorded


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Turn whatever the readers raise over a damaged file into the error of this program."""
    try:
        yield
    except OrthosisError:
        raise
    except Exception as error:
        reason = str(error).splitlines()[0][:200] if str(error).strip() else type(error).__name__
        raise OrthosisError(
            f"{path} cannot be read as a bag ({reason}); try `pam-orthosis recover {path}`"
        ) from error


def aligned(*series: Series) -> tuple[np.ndarray, list[np.ndarray]]:
    """Join series by stamp: the stamps that all have, and each one's values there."""
    stamps = reduce(np.intersect1d, (one.stamp_ns for one in series))
    return stamps, [one.value[np.searchsorted(one.stamp_ns, stamps)] for one in series]


def _check_path(path: Path) -> None:
    if not path.exists():
        raise OrthosisError(f"no bag at {path}")
    if path.is_dir() and not (path / METADATA_FILE).exists():
        if any(path.glob("*.mcap")):
            raise OrthosisError(
                f"{path} was never closed (no {METADATA_FILE}); run `pam-orthosis recover {path}`"
            )
        raise OrthosisError(f"{path} holds no bag (no {METADATA_FILE})")


def _read(
    reader: AnyReader, path: Path, signals: list[str], optional: set[str], namespace: str
) -> dict[str, Series]:
    wanted = defaultdict(list)
    for signal in map(SIGNALS.__getitem__, [*signals, *optional]):
        wanted[resolve(signal.topic, namespace)].append(signal)
    connections = _connections(reader, path, wanted, optional)
    samples = {signal.name: ([], []) for signals in wanted.values() for signal in signals}
    for connection, _, data in reader.messages(connections):
        message = reader.deserialize(data, connection.msgtype)
        stamp_ns = message.header.stamp.sec * SECOND_NS + message.header.stamp.nanosec
        for signal in wanted[connection.topic]:
            stamps, values = samples[signal.name]
            stamps.append(stamp_ns)
            values.append(_value(message, signal))
    return {
        name: _series(path, SIGNALS[name], *lists)
        for name, lists in samples.items()
        if lists[0] or name not in optional
    }


def _connections(
    reader: AnyReader, path: Path, wanted: Mapping[str, Sequence[Signal]], optional: set[str]
) -> list:
    there = {connection.topic: connection for connection in reader.connections}
    for topic, signals in wanted.items():
        needed = [signal for signal in signals if signal.name not in optional]
        if topic not in there and needed:
            what = f"{path} has no topic {topic}, needed for {needed[0].name}"
            raise OrthosisError(what + _legs_there(there))
        if topic in there:
            _check_type(path, there[topic], BY_NAME[signals[0].topic].type)
    return [connection for connection in reader.connections if connection.topic in wanted]


def _legs_there(topics: Iterable[str]) -> str:
    """Return the hint that a bag has its legs in namespaces, if it has."""
    legs = sorted(parts[1] for parts in (topic.split("/") for topic in topics) if parts[2:] == ["reference"])
    return f"; it has the legs {', '.join(legs)}: give one by --namespace" if legs else ""


def _check_type(path: Path, connection: Any, expected: str) -> None:
    if connection.msgtype != expected:
        raise OrthosisError(
            f"{path}: topic {connection.topic} is of type {connection.msgtype}, not {expected}"
        )


def _stamp_ns(data: bytes) -> int:
    """Return the stamp with which each type of the table begins, behind the encapsulation's four bytes."""
    seconds, nanoseconds = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return seconds * SECOND_NS + nanoseconds


def _value(message: Any, signal: Signal) -> float:
    if BY_NAME[signal.topic].type.endswith("JointTrajectory"):
        if not message.points:
            return np.nan
        point = message.points[signal.point]
        return _at(getattr(point, signal.field), message.joint_names, signal.joint)
    if signal.joint:
        return _at(getattr(message, signal.field), message.name, signal.joint)
    return attrgetter(signal.field)(message)


def _at(values: Sequence[float], names: Sequence[str], name: str) -> float:
    """Return the value of a named joint, NaN where the message does not give it."""
    index = names.index(name) if name in names else len(values)
    return values[index] if index < len(values) else np.nan


def _series(path: Path, signal: Signal, stamps: list[int], values: list[float]) -> Series:
    if not stamps:
        raise OrthosisError(f"{path}: topic {signal.topic} is empty, needed for {signal.name}")
    stamp_ns, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    value = np.array(values, dtype=float)[first]
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
