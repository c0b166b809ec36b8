# SPDX-License-Identifier: Apache-2.0
"""ROS messages by the definitions of rosbags: they need no ROS, and know `tf2_msgs`, which PyPI has not."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from pam_orthosis.bag.cdr import store
from pam_orthosis.bag.topics import JOINT, MOTION, PRESSURE, SECOND_NS, VECTOR, WRENCH


def new(kind: str, **fields: Any) -> Any:
    """Return a message of `package/msg/Type`; all fields are to be given."""
    return store().types[kind](**fields)


def serialised(kind: str, message: Any) -> bytes:
    """Return a message as CDR, padded with zeros."""
    return bytes(store().serialize_cdr(message, kind))


def deserialised(kind: str, data: bytes) -> Any:
    """Return the message that CDR holds."""
    return store().deserialize_cdr(data, kind)


def vector(values: Iterable[float], kind: str = "geometry_msgs/msg/Vector3") -> Any:
    """Return a vector or point (x, y, z)."""
    return new(kind, **dict(zip("xyz", map(float, values), strict=True)))


def point(values: Iterable[float]) -> Any:
    """Return a point (x, y, z), m."""
    return vector(values, "geometry_msgs/msg/Point")


def quaternion(values: Iterable[float]) -> Any:
    """Return a rotation (x, y, z, w)."""
    return new("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, values), strict=True)))


def header(stamp_ns: int, frame: str = "") -> Any:
    """Return a header."""
    stamp = new("builtin_interfaces/msg/Time", sec=stamp_ns // SECOND_NS, nanosec=stamp_ns % SECOND_NS)
    return new("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def stamp_ns(message: Any) -> int:
    """Return the stamp of a message with a header, ns."""
    stamp = message.header.stamp
    return int(stamp.sec) * SECOND_NS + int(stamp.nanosec)


def joint_state(
    stamp_ns: int,
    names: Sequence[str],
    position: Sequence[float] = (),
    velocity: Sequence[float] = (),
    effort: Sequence[float] = (),
) -> Any:
    """Return named, stamped scalars; what is not known stays empty."""
    numbers = {"position": position, "velocity": velocity, "effort": effort}
    arrays = {name: np.array(values, dtype=float) for name, values in numbers.items()}
    return new(JOINT, header=header(stamp_ns), name=list(names), **arrays)


def fluid_pressure(stamp_ns: int, actuator: str, pressure: float) -> Any:
    """Return an absolute pressure of an actuator, or of all if none is named, Pa, of unknown variance."""
    own = header(stamp_ns, f"{actuator}_muscle" if actuator else "")
    return new(PRESSURE, header=own, fluid_pressure=pressure, variance=0.0)


def mass_flow(stamp_ns: int, actuator: str, flow: float) -> Any:
    """Return a mass flow into an actuator, kg/s, as a vector in the frame of its port."""
    return new(VECTOR, header=header(stamp_ns, f"{actuator}_port"), vector=vector((flow, 0.0, 0.0)))


def wrench(stamp_ns: int, place: str, value: float, frame: str = "") -> Any:
    """Return a wrench that is zero but at a place, such as `torque.y`, N m or N."""
    kind, _, axis = place.partition(".")
    parts = {
        of: vector([value * (of == kind and axis == one) for one in "xyz"]) for of in ("force", "torque")
    }
    return new(WRENCH, header=header(stamp_ns, frame), wrench=new("geometry_msgs/msg/Wrench", **parts))


def trajectory(stamp_ns: int, joint: str, fields: Mapping[str, float]) -> Any:
    """Return a trajectory of one point of one joint; what is not in `fields` stays empty."""
    lists = ("positions", "velocities", "accelerations", "effort")
    point = new(
        f"{MOTION}Point",
        **{name: np.array([fields[name]] if name in fields else [], dtype=float) for name in lists},
        time_from_start=new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
    )
    return new(MOTION, header=header(stamp_ns), joint_names=[joint], points=[point])
