# SPDX-License-Identifier: Apache-2.0
"""Write signals that are arrays as a bag, without ROS: the topics of the graph, one message a sample.

The layout of a message of ours does not depend on its numbers: each topic's message is serialised once.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.bag import messages
from pam_orthosis.bag.cdr import Template
from pam_orthosis.bag.read import machine_of, recorded_valve
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import (
    JOINT,
    MOTION,
    PRESSURE,
    VECTOR,
    WRENCH,
    Signal,
    Topics,
    resolve,
)
from pam_orthosis.model.components.spool import spool_position
from pam_orthosis.model.rows import Section

LISTS = {JOINT: "{}[0]", MOTION: "points[0].{}[0]"}  # type -> where a field's number is


def write_arrays(
    folder: Path,
    stamps_ns: np.ndarray,
    signals: Mapping[str, np.ndarray],
    run: Mapping[str, str],
    every: int = 1,
) -> None:
    """Write signals of the machine that the run metadata name, all sampled at the same stamps.

    Of slow topics, as the graph would, those of each `every`-th stamp from the first. OrthosisError as of
    `BagWriter`.
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
                    data = templates[topic](stamp_ns, *_numbers(members, signals, index, valve))
                    bag.write(resolve(topic, leg), stamp_ns, data)


def _numbers(
    members: list[Signal], signals: Mapping[str, np.ndarray], index: int, valve: Section
) -> Iterator[float]:
    for signal in members:
        number = signals[signal.name][index]
        yield spool_position(number, valve) if signal.spool else number


def _template(members: list[Signal]) -> Template:
    """Return what makes a topic's message of a stamp and its members' numbers."""
    message = _message(members[0].type, dict.fromkeys(members, 0.0))
    kind = message.__msgtype__
    fields = [LISTS.get(kind, "{}").format(signal.field) for signal in members]
    return Template(messages.serialised(kind, message), kind, fields)


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
