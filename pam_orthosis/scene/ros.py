# SPDX-License-Identifier: Apache-2.0
"""ROS messages by the definitions of rosbags: they need no ROS, and know `tf2_msgs`, which PyPI has not."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.topics import SECOND_NS


def new(kind: str, **fields: Any) -> Any:
    """Return a message of `package/msg/Type`; all fields are to be given."""
    return _store().types[kind](**fields)


def serialised(kind: str, message: Any) -> bytes:
    """Return a message as CDR, padded with zeros."""
    return bytes(_store().serialize_cdr(message, kind))


def deserialised(kind: str, data: bytes) -> Any:
    """Return the message that CDR holds."""
    return _store().deserialize_cdr(data, kind)


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


@lru_cache
def _store() -> Any:
    return get_typestore(Stores.ROS2_JAZZY)
