# SPDX-License-Identifier: Apache-2.0
"""Markers of the actuators: each as long and as thick as it is, its colour by its pressure, and its chain."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from pam_orthosis.bag import messages as ros
from pam_orthosis.scene.shape import ZERO, Bar, Vector

_ALONG_X = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))  # a cylinder stands on z
KINDS = {"cylinder": 3, "line": 4}
_COLD, _HOT = (0.15, 0.35, 0.85), (0.9, 0.15, 0.1)


# what differs from one instant to the next in the marker of an actuator and in that of its chain
_MOVING = (
    ("pose.position.x", "scale.x", "scale.y", "scale.z", "color.r", "color.g", "color.b"),
    ("points[0].x",),
)


def moving_fields(bar: Bar) -> tuple[tuple[str, ...], ...]:
    """Return what differs from one instant to the next in each marker of an actuator."""
    return _MOVING if bar.reach is not None else _MOVING[:1]


def bar_markers(header: Any, name: str, bar: Bar) -> list[Any]:
    """Return the markers of an actuator, with zeros for what moves; `header` is of its fixed end's frame."""
    tube = _marker(header, name, 0, "cylinder", ZERO, ZERO, turned=_ALONG_X)
    if bar.reach is None:
        return [tube]
    ends = [ZERO, (bar.reach, 0.0, 0.0)]
    return [tube, _marker(header, name, 1, "line", (0.004, 0.0, 0.0), (0.3, 0.3, 0.3), points=ends)]


def bar_numbers(bar: Bar, contraction: float, diameter: float, share: float) -> tuple[tuple[float, ...], ...]:
    """Return what moves; `share` of the highest pressure is 0 to 1."""
    length = bar.length(contraction)
    tube = (bar.way * length / 2, diameter, diameter, length, *pressure_colour(share))
    return (tube,) if bar.reach is None else (tube, (bar.way * length,))


def pressure_colour(share: float) -> Vector:
    """Return the colour of a share of the highest pressure: blue for none, red for all."""
    share = min(max(share, 0.0), 1.0)
    red, green, blue = (cold + share * (hot - cold) for cold, hot in zip(_COLD, _HOT, strict=True))
    return red, green, blue


def _marker(
    header: Any,
    name: str,
    number: int,
    kind: str,
    size: Vector,
    colour: Vector,
    turned: Iterable[float] = (0.0, 0.0, 0.0, 1.0),
    points: Iterable[Vector] = (),
) -> Any:
    red, green, blue = colour
    empty = np.zeros(0, np.uint8)
    return ros.new(
        "visualization_msgs/msg/Marker",
        header=header,
        ns=name,
        id=number,
        type=KINDS[kind],
        action=0,
        pose=ros.new("geometry_msgs/msg/Pose", position=ros.point(ZERO), orientation=ros.quaternion(turned)),
        scale=ros.vector(size),
        color=ros.new("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=ros.new("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=True,
        points=[ros.point(one) for one in points],
        colors=[],
        texture_resource="",
        texture=ros.new("sensor_msgs/msg/CompressedImage", header=ros.header(0), format="", data=empty),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=ros.new("visualization_msgs/msg/MeshFile", filename="", data=empty),
        mesh_use_embedded_materials=False,
    )
