# SPDX-License-Identifier: Apache-2.0
"""Write signals that are arrays as a bag, without ROS: the topics of the graph, one message a sample.

The layout of a message of ours does not depend on its numbers: each topic's message is serialised
once, and only stamp and values are put into a copy of it.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import BY_NAME, SECOND_NS, SIGNALS, Signal, resolve

_STORE = get_typestore(Stores.ROS2_JAZZY)
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
    """Write signals of the table `bag.topics.SIGNALS`, all sampled at the same stamps.

    Topics of joint states, trajectories and pressures only (no wrench). Of slow topics, as the graph would,
    those of each `every`-th stamp from the first.

    Raises:
        OrthosisError: the folder holds a bag or cannot be written.
    """
    topics: dict[str, list[Signal]] = {}
    for name in signals:
        topics.setdefault(SIGNALS[name].topic, []).append(SIGNALS[name])
    quick = {topic: members for topic, members in topics.items() if not BY_NAME[topic].slow}
    templates = {topic: _template(topic, members) for topic, members in topics.items()}
    with BagWriter(folder, run) as bag:
        for topic in topics:
            bag.add_topic(resolve(topic), BY_NAME[topic].type)
        for index, stamp_ns in enumerate(stamps_ns.tolist()):
            for topic, members in (quick if index % every else topics).items():
                data, places = templates[topic]
                _STAMP.pack_into(data, _STAMP_AT, *divmod(stamp_ns, SECOND_NS))
                for signal, place in zip(members, places, strict=True):
                    _NUMBER.pack_into(data, place, signals[signal.name][index])
                bag.write(resolve(topic), stamp_ns, bytes(data))


def _template(topic: str, members: list[Signal]) -> tuple[bytearray, list[int]]:
    """Return a serialised message and the places of its members' numbers."""
    marks = {signal.name: _MARK * (2 + number) for number, signal in enumerate(members)}
    message = _message(BY_NAME[topic].type, {signal: marks[signal.name] for signal in members})
    data = bytearray(_STORE.serialize_cdr(message, message.__msgtype__))
    return data, [data.index(_NUMBER.pack(mark)) for mark in marks.values()]


def _message(type_name: str, values: Mapping[Signal, float]) -> Any:
    kind = _STORE.types
    stamp = kind["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    first = next(iter(values))
    frame = f"{first.topic.split('/')[0]}_muscle" if type_name.endswith("FluidPressure") else ""
    header = kind["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)
    if type_name.endswith("FluidPressure"):
        return kind[type_name](header=header, fluid_pressure=next(iter(values.values())), variance=0.0)
    names = list(dict.fromkeys(signal.joint for signal in values))
    fields = {signal.field: np.array([number]) for signal, number in values.items()}
    if type_name.endswith("JointState"):
        empty = {name: np.zeros(0) for name in ("position", "velocity", "effort")}
        return kind[type_name](header=header, name=names, **(empty | fields))
    lists = ("positions", "velocities", "accelerations", "effort")
    point = kind["trajectory_msgs/msg/JointTrajectoryPoint"](
        **{name: fields.get(name, np.zeros(0)) for name in lists},
        time_from_start=kind["builtin_interfaces/msg/Duration"](sec=0, nanosec=0),
    )
    return kind[type_name](header=header, joint_names=names, points=[point])
