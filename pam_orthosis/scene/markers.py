# SPDX-License-Identifier: Apache-2.0
"""Markers of the muscles: each as long and as thick as it is, its colour by its pressure, and its chain."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from pam_orthosis.scene import ros
from pam_orthosis.scene.frames import Vector

CYLINDER, LINE_STRIP = 3, 4
_ALONG_X = (0.0, math.sqrt(0.5), 0.0, math.sqrt(0.5))  # a cylinder stands on z
_COLD, _HOT = (0.15, 0.35, 0.85), (0.9, 0.15, 0.1)
_ZERO = (0.0, 0.0, 0.0)
_CHAIN_WIDTH, _CHAIN_COLOUR = 0.004, (0.3, 0.3, 0.3)


# what differs from one instant to the next in each marker of a muscle
MOVING = (
    ("pose.position.x", "scale.x", "scale.y", "scale.z", "color.r", "color.g", "color.b"),
    ("points[0].x",),
)


def muscle_markers(header: Any, name: str, anchor_distance: float) -> list[Any]:
    """Return the markers of a muscle, with zeros for what is `MOVING`.

    Args:
        header: of the frame at its fixed end.
        name: of the muscle.
        anchor_distance: from its fixed end to the knee's axis along the thigh, m.
    """
    ends = [_ZERO, (anchor_distance, 0.0, 0.0)]
    width = (_CHAIN_WIDTH, 0.0, 0.0)
    return [
        _marker(header, name, 0, CYLINDER, _ZERO, _ZERO, turned=_ALONG_X),
        _marker(header, name, 1, LINE_STRIP, width, _CHAIN_COLOUR, points=ends),
    ]


def muscle_numbers(length: float, diameter: float, share: float) -> tuple[tuple[float, ...], ...]:
    """Return what is `MOVING`.

    Args:
        length: of the muscle, m.
        diameter: of it, m.
        share: of the highest pressure, 0 to 1.
    """
    return (length / 2, diameter, diameter, length, *pressure_colour(share)), (length,)


def pressure_colour(share: float) -> Vector:
    """Return the colour of a share of the highest pressure: blue for none, red for all."""
    share = min(max(share, 0.0), 1.0)
    red, green, blue = (cold + share * (hot - cold) for cold, hot in zip(_COLD, _HOT, strict=True))
    return red, green, blue


def _marker(
    header: Any,
    name: str,
    number: int,
    kind: int,
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
        type=kind,
        action=0,
        pose=ros.new("geometry_msgs/msg/Pose", position=ros.point(_ZERO), orientation=ros.quaternion(turned)),
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
