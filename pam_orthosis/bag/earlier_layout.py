# SPDX-License-Identifier: Apache-2.0
"""Bags of version 0.1 as bags of today: topics that had other names, fields that held other quantities.

There a valve's command was a voltage in `effort`, a mass flow a `velocity`; the reference carried a mean
pressure in `effort` and the motion of a plan as a second point, the truth the gas of actuators as joints.

| topic of today | earlier topic |
|---|---|
| `NAME/valve_command` | `NAME/valve_voltage` |
| `NAME/mass_flow` | the same, `sensor_msgs/JointState` |
| `reference_pressure`, `planned_reference` | `reference` |
| `truth/NAME/pressure`, `truth/NAME/mass_flow` | `truth` |
"""

from collections.abc import Iterable
from typing import Any

from rosbags.interfaces import Connection

from pam_orthosis.bag import messages
from pam_orthosis.bag.topics import JOINT, MEAN_PRESSURE, MOTION, PLANNED, REFERENCE, TRUTH
from pam_orthosis.model.components.spool import as_commanded, spool_position
from pam_orthosis.model.parameters import Section

COMMAND, VOLTAGE, FLOW, GAS = "/valve_command", "/valve_voltage", "/mass_flow", "_gas"


def is_earlier(connections: Iterable[Connection]) -> bool:
    """Whether a bag is one of version 0.1."""
    return any(one.msgtype == JOINT and one.topic.endswith((VOLTAGE, FLOW)) for one in connections)


def differs(topic: str) -> bool:
    """Whether messages of a topic of today had another form."""
    *_, name = topic.split("/")
    truth = name_of(topic).endswith(TRUTH)
    return truth or topic.endswith((COMMAND, FLOW)) or name in (REFERENCE, MEAN_PRESSURE, PLANNED)


def name_of(topic: str) -> str:
    """Return the earlier topic that held what is on a topic of today."""
    group, _, name = topic.rpartition("/")
    if name in (MEAN_PRESSURE, PLANNED):
        return f"{group}/{REFERENCE}".lstrip("/")
    head, _, rest = topic.partition(f"{TRUTH}/")
    if rest:
        return head + TRUTH
    return topic.removesuffix(COMMAND) + VOLTAGE if topic.endswith(COMMAND) else topic


def type_of(topic: str, today: str) -> str:
    """Return the type of the earlier topic, given the type of that of today."""
    if topic.endswith(FLOW) or name_of(topic).endswith(TRUTH):
        return JOINT
    return MOTION if topic.endswith((MEAN_PRESSURE, PLANNED)) else today


def as_today(topic: str, message: Any, leg: str, valve: Section) -> Any:
    """Return what an earlier message says on a topic that differs, in a leg's frames; None if nothing."""
    _, _, name = topic.rpartition("/")
    stamp_ns = messages.stamp_ns(message)
    if topic.endswith(COMMAND):
        spools = [spool_position(as_commanded(volts, valve), valve) for volts in message.effort.tolist()]
        return messages.joint_state(stamp_ns, message.name, position=spools)
    if name in (REFERENCE, MEAN_PRESSURE, PLANNED):
        return _motion(name, message)
    if name_of(topic).endswith(TRUTH):
        return _truth(topic, message, leg)
    return messages.mass_flow(stamp_ns, _framed(leg, topic.split("/")[-2]), message.velocity[0])


def _motion(name: str, message: Any) -> Any:
    if not message.points:
        return message if name == REFERENCE else None
    stamp_ns, fields = messages.stamp_ns(message), ("positions", "velocities", "accelerations")
    point = message.points[-1 if name == PLANNED else 0]
    if name == MEAN_PRESSURE:
        return messages.fluid_pressure(stamp_ns, "", point.effort[0]) if len(point.effort) else None
    numbers = {field: getattr(point, field)[0] for field in fields if len(getattr(point, field))}
    return messages.trajectory(stamp_ns, message.joint_names[0], numbers)


def _truth(topic: str, message: Any, leg: str) -> Any:
    *_, actuator, kind = topic.split("/") if not topic.endswith(TRUTH) else ("", "")
    stamp_ns, gas = messages.stamp_ns(message), f"{actuator}{GAS}"
    if not actuator:
        kept = [index for index, name in enumerate(message.name) if not name.endswith(GAS)]
        lists = (getattr(message, field)[kept] for field in ("position", "velocity", "effort"))
        return messages.joint_state(stamp_ns, [message.name[index] for index in kept], *lists)
    if gas not in message.name:
        return None
    place, own = message.name.index(gas), _framed(leg, actuator)
    if kind == "pressure":
        return messages.fluid_pressure(stamp_ns, own, message.effort[place])
    return messages.mass_flow(stamp_ns, own, message.velocity[place])


def _framed(leg: str, actuator: str) -> str:
    return f"{leg}/{actuator}" if leg else actuator
