# SPDX-License-Identifier: Apache-2.0
"""Write signals that are arrays as a bag, without ROS: the topics of the graph, one message a sample.

The layout of a message of ours does not depend on its numbers: each topic's message is serialised once.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
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

LISTS = {JOINT: "{}[{}]", MOTION: "points[0].{}[{}]"}  # type -> where a joint's number of a field is


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
    topics = by_topic(table.signals[name] for name in next(iter(legs.values())))
    quick = {topic: members for topic, members in topics.items() if not table.by_name[topic].slow}
    templates = {topic: template(members) for topic, members in topics.items()}
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


def by_topic(signals: Iterable[Signal]) -> dict[str, list[Signal]]:
    """Return topic -> its signals."""
    topics: dict[str, list[Signal]] = {}
    for signal in signals:
        topics.setdefault(signal.topic, []).append(signal)
    return topics


def template(members: Sequence[Signal], frame: str = "") -> Template:
    """Return what makes a topic's message of a stamp and its members' numbers; `frame` of a wrench."""
    joints = list(dict.fromkeys(signal.joint for signal in members))
    message = _message(members, joints, frame)
    kind = message.__msgtype__
    fields = [LISTS.get(kind, "{}").format(one.field, joints.index(one.joint)) for one in members]
    return Template(messages.serialised(kind, message), kind, fields)


def _message(members: Sequence[Signal], joints: Sequence[str], frame: str) -> Any:
    """Return a topic's message; what no member is, of a joint, is not known."""
    first = members[0]
    if first.type == PRESSURE:
        return messages.fluid_pressure(0, first.topic.split("/")[-2], 0.0)
    if first.type == VECTOR:
        return messages.mass_flow(0, first.topic.split("/")[-2], 0.0)
    if first.type == WRENCH:
        return messages.wrench(0, first.field.partition(".")[2], 0.0, frame)
    if first.type == MOTION:
        return messages.trajectory(0, first.joint, {signal.field: 0.0 for signal in members})
    there = {(signal.field, signal.joint) for signal in members}
    fields = dict.fromkeys(signal.field for signal in members)
    numbers = {name: [0.0 if (name, one) in there else math.nan for one in joints] for name in fields}
    return messages.joint_state(0, joints, **numbers)
