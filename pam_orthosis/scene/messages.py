# SPDX-License-Identifier: Apache-2.0
"""What a viewer needs of a machine, as serialised ROS messages: description, TF, joints, markers.

The same bytes go into the bag and, where their type is installed, out of a node.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

from pam_orthosis.bag import messages as ros
from pam_orthosis.bag.cdr import Template
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.scene.markers import bar_markers, bar_numbers, moving_fields
from pam_orthosis.scene.shape import Pose, Transform
from pam_orthosis.scene.shapes import shape_of
from pam_orthosis.scene.urdf import robot_description

WORLD = "world"
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

    `moving`: path of a part -> paths in it, behind the stamp, of the numbers that differ.
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


class Scene:
    """Makes the messages of one machine, of those of all legs from left to right.

    Its frames have the leg's namespace as prefix; none if it is the only one.
    """

    def __init__(self, parameters: Parameters, leg: str = "", legs: Sequence[str] = ("",)):
        self.machine = parameters.declared
        self.shape = shape_of(parameters)
        self.description = robot_description(self.shape)
        self._prefix = f"{leg}/" if leg else ""
        self._left = self.shape.spacing * ((len(legs) - 1) / 2 - legs.index(leg))
        self._pressures = parameters.valve.ambient_pressure, parameters.valve.supply_pressure
        positions = self.shape.pose(0.0).positions
        joints = ros.joint_state(0, list(positions), list(positions.values()))
        self._joints = Template(
            ros.serialised(TYPES[JOINTS], joints),
            TYPES[JOINTS],
        )
        moving = [self._own(one) for one in self.shape.moving(positions)]
        self._transforms = _Parts(
            TF, _transforms(0, moving), {f"transforms[{i}]": _PLACE for i in range(len(moving))}
        )
        self._markers = self._marker_parts()

    def once(self, stamp_ns: int) -> list[Said]:
        """Return what is said once: the description, and the frames that do not move.

        The roots of several machines are in one world; that of a single one is the world.
        """
        side = (0.0, self._left, 0.0)
        root = [Transform(WORLD, self._prefix + self.shape.root, side)] if self._prefix else []
        fixed = [*root, *map(self._own, self.shape.fixed())]
        description = ros.new(TYPES[DESCRIPTION], data=self.description)
        return [_said(DESCRIPTION, description), _said(TF_STATIC, _transforms(stamp_ns, fixed))]

    def sample(self, stamp_ns: int, coordinate: float, pressures: Iterable[float]) -> list[Said]:
        """Return what is said at an instant: coordinate in rad or m, absolute pressures in Pa."""
        pose = self.shape.pose(coordinate)
        places = ((*one.translation, *one.rotation) for one in self.shape.moving(pose.positions))
        return [
            self._transforms(stamp_ns, places),
            Said(JOINTS, self._joints(stamp_ns, *pose.positions.values())),
            self._markers(stamp_ns, self._marker_numbers(pose, pressures)),
        ]

    def _own(self, one: Transform) -> Transform:
        return one._replace(parent=self._prefix + one.parent, child=self._prefix + one.child)

    def _marker_parts(self) -> _Parts:
        markers: list[Any] = []
        moving: list[Any] = []
        for name, bar in self.shape.bars.items():
            markers += bar_markers(ros.header(0, f"{self._prefix}{name}_muscle"), name, bar)
            moving += moving_fields(bar)
        return _Parts(
            MARKERS,
            ros.new(TYPES[MARKERS], markers=markers),
            {f"markers[{i}]": fields for i, fields in enumerate(moving)},
        )

    def _marker_numbers(self, pose: Pose, pressures: Iterable[float]) -> Iterator[tuple[float, ...]]:
        low, high = self._pressures
        for (name, bar), pressure in zip(self.shape.bars.items(), pressures, strict=True):
            share = (pressure - low) / (high - low)
            yield from bar_numbers(bar, pose.positions[name], pose.diameters[name], share)


def _said(topic: str, message: Any) -> Said:
    return Said(topic, ros.serialised(TYPES[topic], message))


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
