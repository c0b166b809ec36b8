# SPDX-License-Identifier: Apache-2.0
"""What a machine looks like: a tree of frames, joints between them, bodies and actuators along it.

The one geometry of pictures, URDF, TF and markers. All is in one plane, x and z; y is the axis of whatever
turns, to the left (REP-103).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.model.compiled import Compiled

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


class Joint(NamedTuple):
    """A joint at `origin` (m) of its parent's frame, none of them turned there; `limits` in rad or m."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Vector = ZERO
    axis: Vector = ZERO
    limits: tuple[float, float] = (0.0, 0.0)


class Solid(NamedTuple):
    """A box (`size` along x, y, z) or a cylinder (radius, length), turned by roll, pitch and yaw, rad."""

    link: str
    colour: str
    centre: Vector
    size: tuple[float, ...]
    turned: Vector = ZERO


class Mass(NamedTuple):
    """What a link weighs, kg, where along its x, m, and its moments there: about x, and across, kg m^2."""

    link: str
    mass: float
    centre: float
    along: float
    across: float


class Bar(NamedTuple):
    """An actuator: a bar along x of its own frame, from the frame's origin to where its joint slides.

    Attributes:
        rest: its length where it is not contracted, m.
        grows: 1 if it gets longer with the contraction, as a cylinder's chamber does, -1 if shorter.
        way: 1 or -1, where along x it points.
        reach: how far a chain goes on from its end, from the frame's origin, m; None: there is none.
    """

    rest: float
    grows: float
    way: float
    reach: float | None

    def length(self, contraction: float) -> float:
        """Return how long it is at a contraction, m."""
        return self.rest + self.grows * contraction

    def joints(
        self, name: str, parent: str, origin: Vector, limits: tuple[float, float]
    ) -> tuple[Joint, ...]:
        """Return its fixed joints, those of end and port, and the one by which the other end slides."""
        start, axis = (self.way * self.rest, 0.0, 0.0), (self.way * self.grows, 0.0, 0.0)
        return (
            Joint(f"{name}_anchor", "fixed", parent, f"{name}_muscle", origin),
            Joint(f"{name}_inlet", "fixed", f"{name}_muscle", f"{name}_port", ZERO),
            Joint(name, "prismatic", f"{name}_muscle", f"{name}_chain", start, axis, limits),
        )


class Transform(NamedTuple):
    """Where a frame is in its parent's: translation, m, and rotation (x, y, z, w)."""

    parent: str
    child: str
    translation: Vector
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class Pose(NamedTuple):
    """What moves: position of each joint by name, rad or m, and diameter of each actuator, m."""

    positions: dict[str, float]
    diameters: dict[str, float]


class Line(NamedTuple):
    """An actuator in side view: its fixed end, its other one and the end of its chain, (n, 2) m each."""

    upper: np.ndarray
    lower: np.ndarray
    chain: np.ndarray
    diameter: np.ndarray


class Sketch(NamedTuple):
    """A machine in side view (x, z) at n coordinates: corners of its body, (n, k, 2) m, actuators by name."""

    body: np.ndarray
    actuators: dict[str, Line]

    @property
    def extent(self) -> np.ndarray:
        """The lowest and the highest x and z of body and fixed ends: two rows."""
        ends = (line.upper for line in self.actuators.values())
        points = np.concatenate([self.body.reshape(-1, 2), *ends])
        return np.array([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True)
class Shape:
    """The geometry of one machine.

    Attributes:
        joints: parents first.
        bars: the actuators by name.
        outline: frame and point of each corner of the body that a side view joins by a line.
        wheel: corner of the outline about which a wheel turns, and its radius, m.
        rail: corner of the outline that slides on a bearing, and what is said of it.
        solids, masses: of the links.
        spacing: between machines side by side, m.
        function: coordinate -> positions of the joints that move, in their order, and the bars' diameters.
    """

    joints: tuple[Joint, ...]
    bars: Mapping[str, Bar]
    outline: tuple[tuple[str, Vector], ...]
    solids: tuple[Solid, ...]
    masses: tuple[Mass, ...]
    spacing: float
    function: ca.Function
    wheel: tuple[int, float] | None = None
    rail: tuple[int, str] | None = None

    @property
    def root(self) -> str:
        """The frame that carries all others."""
        return self.joints[0].parent

    @property
    def links(self) -> tuple[str, ...]:
        """The frames, the root first."""
        return (self.root, *(joint.child for joint in self.joints))

    @property
    def corners(self) -> tuple[str, ...]:
        """The joint at each corner of the outline; empty where there is none."""
        names = {joint.child: joint.name for joint in self.joints}
        return tuple(names.get(frame, "") if point == ZERO else "" for frame, point in self.outline)

    @cached_property
    def moved(self) -> tuple[Joint, ...]:
        """The joints that move."""
        return tuple(joint for joint in self.joints if joint.kind != "fixed")

    @cached_property
    def _of_one(self) -> Compiled:
        return Compiled(self.function)

    def pose(self, coordinate: float) -> Pose:
        """Return what the machine is like at a coordinate."""
        values = [float(part[0]) for part in self._of_one(coordinate)]
        names = (joint.name for joint in self.moved)
        return Pose(dict(zip(names, values, strict=False)), self._diameters(values))

    def fixed(self) -> list[Transform]:
        """Return the transforms that never change."""
        return [Transform(j.parent, j.child, j.origin) for j in self.joints if j.kind == "fixed"]

    def moving(self, positions: Mapping[str, float]) -> list[Transform]:
        """Return the transforms of the joints at these positions."""
        return [_moved(joint, positions[joint.name]) for joint in self.moved]

    def sketch(self, coordinates: np.ndarray) -> Sketch:
        """Return the side view at coordinates (n,)."""
        values = [part.full()[0] for part in self.function(np.atleast_2d(coordinates))]
        names = (joint.name for joint in self.moved)
        frames = self._frames(dict(zip(names, values, strict=False)), np.shape(values[0]))
        diameters = self._diameters(values)

        def line(name: str, bar: Bar) -> Line:
            lower = frames[f"{name}_chain"].at(ZERO)
            chain = lower if bar.reach is None else frames[f"{name}_muscle"].at((bar.reach, 0.0, 0.0))
            return Line(frames[f"{name}_muscle"].at(ZERO), lower, chain, diameters[name])

        body = np.stack([frames[frame].at(point) for frame, point in self.outline], axis=1)
        return Sketch(body, {name: line(name, bar) for name, bar in self.bars.items()})

    def _diameters(self, values: list[Any]) -> dict[str, Any]:
        return dict(zip(self.bars, values[len(self.moved) :], strict=True))

    def _frames(self, positions: Mapping[str, np.ndarray], shape: tuple[int, ...]) -> dict[str, _Frame]:
        frames = {self.root: _Frame(np.zeros((*shape, 2)), np.zeros(shape))}
        for joint in self.joints:
            parent, turned = frames[joint.parent], np.zeros(shape)
            place = np.array(joint.origin)
            if joint.kind == "prismatic":
                place = place + np.outer(positions[joint.name], joint.axis)
            elif joint.kind == "revolute":
                turned = -joint.axis[1] * positions[joint.name]
            frames[joint.child] = _Frame(parent.at(place), parent.heading + turned)
        return frames


class _Frame(NamedTuple):
    """A frame in side view: where it is, (n, 2) m, and its heading from x to z, (n,) rad."""

    origin: np.ndarray
    heading: np.ndarray

    def at(self, point: Vector | np.ndarray) -> np.ndarray:
        """Return where a point (or one each) of the frame is."""
        x, _, z = np.moveaxis(np.asarray(point), -1, 0)
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        return np.asarray(self.origin + np.column_stack([x * cosine - z * sine, x * sine + z * cosine]))


def ranges(function: ca.Function, low: float, high: float) -> list[tuple[float, float]]:
    """Return the least and the largest value of each result of a function between two coordinates."""
    values = function(np.linspace(low, high, 101)[None, :])
    return [(float(part.full().min()), float(part.full().max())) for part in values]


def _moved(joint: Joint, position: float) -> Transform:
    """Return the transform of a revolute or prismatic joint at a position."""
    if joint.kind == "prismatic":
        x, y, z = (start + position * axis for start, axis in zip(joint.origin, joint.axis, strict=True))
        return Transform(joint.parent, joint.child, (x, y, z))
    sine = math.sin(position / 2)
    x, y, z = (sine * axis for axis in joint.axis)
    return Transform(joint.parent, joint.child, joint.origin, (x, y, z, math.cos(position / 2)))
