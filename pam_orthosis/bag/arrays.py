# SPDX-License-Identifier: Apache-2.0
"""Write signals that are arrays as a bag, without ROS: the topics of the graph, one message a sample.

The layout of a message of ours does not depend on its numbers: each topic's message is serialised
once, and only stamp and values are put into a copy of it.
"""

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.bag import messages
from pam_orthosis.bag.read import machine_of, recorded_valve
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import MOTION, PRESSURE, SECOND_NS, VECTOR, WRENCH, Signal, Topics, resolve
from pam_orthosis.model.components.spool import spool_position
from pam_orthosis.model.rows import Section

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4  # after the encapsulation header: the header's stamp comes first in the messages
_NUMBER = struct.Struct("<d")
_MARK = 1.2345678901234567e-300  # a number that no message holds otherwise


def write_arrays(
    folder: Path,
    stamps_ns: np.ndarray,
    signals: Mapping[str, np.ndarray],
    run: Mapping[str, str],
    every: int = 1,
) -> None:
    """Write signals of the machine that the run metadata name, all sampled at the same stamps.

    Of slow topics, as the graph would, those of each `every`-th stamp from the first.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """
    write_legs(folder, stamps_ns, {"": signals}, run, every)


def write_legs(
    folder: Path,
    stamps_ns: np.ndarray,
    legs: Mapping[str, Mapping[str, np.ndarray]],
    run: Mapping[str, str],
    every: int = 1,
) -> None:
    """Write the same signals of several legs, by namespace, as `write_arrays` does those of one."""
    table, valve = Topics(machine_of(folder, run)), recorded_valve(folder, run)
    topics: dict[str, list[Signal]] = {}
    for name in next(iter(legs.values())):
        topics.setdefault(table.signals[name].topic, []).append(table.signals[name])
    quick = {topic: members for topic, members in topics.items() if not table.by_name[topic].slow}
    templates = {topic: _template(members) for topic, members in topics.items()}
    with BagWriter(folder, run) as bag:
        for leg in legs:
            for topic in topics:
                bag.add_topic(resolve(topic, leg), table.by_name[topic].type)
        for index, stamp_ns in enumerate(stamps_ns.tolist()):
            for leg, signals in legs.items():
                for topic, members in (quick if index % every else topics).items():
                    data = _filled(templates[topic], members, stamp_ns, signals, index, valve)
                    bag.write(resolve(topic, leg), stamp_ns, data)


def _filled(
    template: tuple[bytearray, list[int]],
    members: list[Signal],
    stamp_ns: int,
    signals: Mapping[str, np.ndarray],
    index: int,
    valve: Section,
) -> bytes:
    """Return a topic's message of one stamp."""
    data, places = template
    _STAMP.pack_into(data, _STAMP_AT, *divmod(stamp_ns, SECOND_NS))
    for signal, place in zip(members, places, strict=True):
        number = signals[signal.name][index]
        _NUMBER.pack_into(data, place, spool_position(number, valve) if signal.spool else number)
    return bytes(data)


def _template(members: list[Signal]) -> tuple[bytearray, list[int]]:
    """Return a serialised message and the places of its members' numbers."""
    marks = {signal.name: _MARK * (2 + number) for number, signal in enumerate(members)}
    message = _message(members[0].type, {signal: marks[signal.name] for signal in members})
    data = bytearray(messages.serialised(message.__msgtype__, message))
    return data, [data.index(_NUMBER.pack(mark)) for mark in marks.values()]


def _message(type_name: str, values: Mapping[Signal, float]) -> Any:
    first, *_ = values
    fields = {signal.field: number for signal, number in values.items()}
    if type_name == PRESSURE:
        return messages.fluid_pressure(0, first.topic.split("/")[0], values[first])
    if type_name == VECTOR:
        return messages.mass_flow(0, first.topic.split("/")[0], values[first])
    if type_name == MOTION:
        return messages.trajectory(0, first.joint, fields)
    if type_name == WRENCH:
        return messages.wrench(0, first.field.partition(".")[2], values[first])
    names = dict.fromkeys(signal.joint for signal in values)
    return messages.joint_state(0, list(names), **{name: [number] for name, number in fields.items()})
