# SPDX-License-Identifier: Apache-2.0
"""What a viewer needs of a leg, as serialised ROS messages: description, TF, joints, markers.

The same bytes go into the bag and, where their type is installed, out of a node.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.cdr import Template
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.model.orthosis import MUSCLES
from pam_orthosis.scene import ros
from pam_orthosis.scene.frames import ROOT, WORLD, LegFrames, Pose, Transform
from pam_orthosis.scene.markers import MOVING, muscle_markers, muscle_numbers
from pam_orthosis.scene.urdf import robot_description

PERIOD_NS = SECOND_NS // 25
TF, TF_STATIC = "/tf", "/tf_static"
DESCRIPTION, JOINTS, MARKERS = "robot_description", "leg_joints", "markers"
TYPES = {
    TF: "tf2_msgs/msg/TFMessage",
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    DESCRIPTION: "std_msgs/msg/String",
    JOINTS: "sensor_msgs/msg/JointState",
    MARKERS: "visualization_msgs/msg/MarkerArray",
}
LATCHED = (TF_STATIC, DESCRIPTION)  # said once, to be had later on
_STAMP = ("header.stamp.sec", "header.stamp.nanosec")
_PLACE = (
    *(f"transform.translation.{axis}" for axis in "xyz"),
    *(f"transform.rotation.{axis}" for axis in "xyzw"),
)


def in_scene(topic: str, leg: str) -> str:
    """Return the name of a leg's topic: TF is common to all legs."""
    return topic if topic.startswith("/") or not leg else f"{leg}/{topic}"


class Said(NamedTuple):
    """A serialised message and its topic, one of `TYPES`."""

    topic: str
    data: bytes


class _Parts:
    """Says a message whose parts have a stamp each; it is made once, and numbers are filled in.

    Args:
        topic: one of `TYPES`.
        message: an example.
        moving: path of a part -> paths in it, behind the stamp, of the numbers that differ.
    """

    def __init__(self, topic: str, message: Any, moving: dict[str, Sequence[str]]):
        self._topic = topic
        fields = [f"{part}.{field}" for part, those in moving.items() for field in (*_STAMP, *those)]
        example = ros.serialised(TYPES[topic], message)
        self._make = Template(example, TYPES[topic], fields[len(_STAMP) :])

    def __call__(self, stamp_ns: int, parts: Iterable[Iterable[float]]) -> Said:
        stamp = divmod(stamp_ns, SECOND_NS)
        numbers = [number for part in parts for number in (*stamp, *part)]
        return Said(self._topic, self._make(stamp_ns, *numbers[len(_STAMP) :]))


class LegScene:
    """Makes the messages of one leg.

    Args:
        parameters: tree with the branches `leg`, `muscle` and `valve`.
        leg: its namespace, which its frames have as prefix; none if it is the only one.
        legs: the namespaces of all legs, from left to right.
    """

    def __init__(self, parameters: Any, leg: str = "", legs: Sequence[str] = ("",)):
        self.frames = LegFrames(parameters)
        self.description = robot_description(self.frames)
        self._prefix = f"{leg}/" if leg else ""
        self._left = parameters.leg.hip_distance * ((len(legs) - 1) / 2 - legs.index(leg))
        self._pressures = parameters.valve.ambient_pressure, parameters.valve.supply_pressure
        positions = self.frames.positions(0.0, self.frames.pose(0.0))
        self._joints = Template(ros.serialised(TYPES[JOINTS], _joint_state(positions)), TYPES[JOINTS])
        moving = [self._own(one) for one in self.frames.moving(positions)]
        self._transforms = _Parts(
            TF, _transforms(0, moving), {f"transforms[{i}]": _PLACE for i in range(len(moving))}
        )
        self._markers = self._marker_parts()

    def once(self, stamp_ns: int) -> list[Said]:
        """Return what is said once: the description, and the frames that do not move.

        The hips of several legs are in one world; the hip of a single leg is the world.
        """
        hip = [Transform(WORLD, self._prefix + ROOT, (0.0, self._left, 0.0))] if self._prefix else []
        fixed = [*hip, *map(self._own, self.frames.fixed())]
        description = ros.new(TYPES[DESCRIPTION], data=self.description)
        return [_said(DESCRIPTION, description), _said(TF_STATIC, _transforms(stamp_ns, fixed))]

    def sample(self, stamp_ns: int, angle: float, pressures: Iterable[float]) -> list[Said]:
        """Return what is said at an instant.

        Args:
            stamp_ns: the instant.
            angle: knee angle, rad.
            pressures: of extensor and flexor, absolute, Pa.
        """
        pose = self.frames.pose(angle)
        positions = self.frames.positions(angle, pose)
        places = ((*one.translation, *one.rotation) for one in self.frames.moving(positions))
        return [
            self._transforms(stamp_ns, places),
            Said(JOINTS, self._joints(stamp_ns, *positions.values())),
            self._markers(stamp_ns, self._marker_numbers(pose, pressures)),
        ]

    def _own(self, one: Transform) -> Transform:
        return one._replace(parent=self._prefix + one.parent, child=self._prefix + one.child)

    def _marker_parts(self) -> _Parts:
        anchor = self.frames.shape.anchor_distance
        markers = [
            marker
            for name in MUSCLES
            for marker in muscle_markers(ros.header(0, f"{self._prefix}{name}_muscle"), name, anchor)
        ]
        moving = [fields for _ in MUSCLES for fields in MOVING]
        return _Parts(
            MARKERS,
            ros.new(TYPES[MARKERS], markers=markers),
            {f"markers[{i}]": fields for i, fields in enumerate(moving)},
        )

    def _marker_numbers(self, pose: Pose, pressures: Iterable[float]) -> Iterator[tuple[float, ...]]:
        low, high = self._pressures
        for name, pressure in zip(MUSCLES, pressures, strict=True):
            length = self.frames.muscle_length - pose.contractions[name]
            yield from muscle_numbers(length, pose.diameters[name], (pressure - low) / (high - low))


def _said(topic: str, message: Any) -> Said:
    return Said(topic, ros.serialised(TYPES[topic], message))


def _joint_state(positions: dict[str, float]) -> Any:
    nothing = np.zeros(0)
    return ros.new(
        TYPES[JOINTS],
        header=ros.header(0),
        name=list(positions),
        position=np.array(list(positions.values())),
        velocity=nothing,
        effort=nothing,
    )


def _transforms(stamp_ns: int, transforms: Iterable[Transform]) -> Any:
    return ros.new(TYPES[TF], transforms=[_stamped(stamp_ns, one) for one in transforms])


def _stamped(stamp_ns: int, one: Transform) -> Any:
    place = ros.new(
        "geometry_msgs/msg/Transform",
        translation=ros.vector(one.translation),
        rotation=ros.quaternion(one.rotation),
    )
    return ros.new(
        "geometry_msgs/msg/TransformStamped",
        header=ros.header(stamp_ns, one.parent),
        child_frame_id=one.child,
        transform=place,
    )
