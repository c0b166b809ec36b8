# SPDX-License-Identifier: Apache-2.0
"""The tree of frames of a leg: links, the joints between them, where each joint stands.

The geometry is that of `report.leg_shape`; URDF, TF and markers are made of this tree alone. Each link's x
runs along its segment, away from the hip; y is the axis of the knee, to the left (REP-103).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.model import leg as leg_model
from pam_orthosis.model.orthosis import MUSCLES
from pam_orthosis.report.leg_shape import LegShape

ROOT, WORLD = "hip", "world"
LIMIT_SAMPLES = 101

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]


class Joint(NamedTuple):
    """A joint at `origin` (m) of its parent's frame, none of them turned there; `limits` in rad or m."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Vector
    axis: Vector = (0.0, 0.0, 0.0)
    limits: tuple[float, float] = (0.0, 0.0)


class Transform(NamedTuple):
    """Where a frame is in its parent's: translation, m, and rotation (x, y, z, w)."""

    parent: str
    child: str
    translation: Vector
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)


class Pose(NamedTuple):
    """What moves with the knee: hip angle, rad, and by muscle its contraction and its diameter, m."""

    hip_angle: float
    contractions: dict[str, float]
    diameters: dict[str, float]


class LegFrames:
    """The frames of one leg.

    Args:
        parameters: tree with the branches `leg` and `muscle`.
    """

    def __init__(self, parameters: Any):
        self.parameters = parameters
        self.shape = LegShape(parameters)
        self.thigh_length, self.shank_length = leg_model.segment_lengths(parameters.leg)
        self.muscle_length = parameters.muscle.dmsp_20.length

    @cached_property
    def joints(self) -> tuple[Joint, ...]:
        """The joints, parents first."""
        knee = (self.thigh_length, 0.0, 0.0)
        ankle = (self.shank_length, 0.0, 0.0)
        flexion = (0.0, float(self.parameters.leg.configuration), 0.0)
        limits = self._limits()
        return (
            Joint("hip", "revolute", ROOT, "thigh", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), limits["hip"]),
            Joint("knee_housing", "fixed", "thigh", "knee", knee),
            Joint("knee", "revolute", "knee", "shank", (0.0, 0.0, 0.0), flexion, limits["knee"]),
            Joint("arbor", "fixed", "shank", "cogwheel", (0.0, 0.0, 0.0)),
            Joint("ankle", "fixed", "shank", "foot", ankle),
            *(joint for muscle in MUSCLES for joint in self._muscle_joints(muscle, limits[muscle])),
        )

    @cached_property
    def links(self) -> tuple[str, ...]:
        """The frames, the root first."""
        return (ROOT, *(joint.child for joint in self.joints))

    def pose(self, angle: float) -> Pose:
        """Return what the leg is like at a knee angle, rad."""
        hip_angle, *measures = self.shape.at(angle)
        count = len(MUSCLES)
        return Pose(
            hip_angle,
            dict(zip(MUSCLES, measures[:count], strict=True)),
            dict(zip(MUSCLES, measures[count:], strict=True)),
        )

    def positions(self, angle: float, pose: Pose) -> dict[str, float]:
        """Return the position of each joint that moves, rad or m, by name."""
        return {"hip": pose.hip_angle, "knee": angle, **pose.contractions}

    def fixed(self) -> list[Transform]:
        """Return the transforms that never change."""
        return [Transform(j.parent, j.child, j.origin) for j in self.joints if j.kind == "fixed"]

    def moving(self, positions: Mapping[str, float]) -> list[Transform]:
        """Return the transforms of the joints at these positions."""
        return [moved(j, positions[j.name]) for j in self.joints if j.kind != "fixed"]

    def _muscle_joints(self, muscle: str, limits: tuple[float, float]) -> tuple[Joint, Joint]:
        along = self.thigh_length - self.shape.anchor_distance
        upper = (along, 0.0, self.shape.offset(muscle))
        stretched = (self.muscle_length, 0.0, 0.0)
        return (
            Joint(f"{muscle}_anchor", "fixed", "thigh", f"{muscle}_muscle", upper),
            Joint(
                muscle,
                "prismatic",
                f"{muscle}_muscle",
                f"{muscle}_chain",
                stretched,
                (-1.0, 0.0, 0.0),
                limits,
            ),
        )

    def _limits(self) -> dict[str, tuple[float, float]]:
        """Return the range of each joint over that of the knee."""
        stops = self.parameters.leg.joint
        angles = np.linspace(stops.minimum, stops.maximum, LIMIT_SAMPLES)
        pose = self.shape.pose(angles)
        moved_by = {"hip": pose.hip_angle, "knee": angles}
        moved_by |= {name: one.contraction for name, one in pose.muscles.items()}
        return {name: (float(min(values)), float(max(values))) for name, values in moved_by.items()}


def moved(joint: Joint, position: float) -> Transform:
    """Return the transform of a revolute or prismatic joint at a position."""
    if joint.kind == "prismatic":
        x, y, z = (start + position * axis for start, axis in zip(joint.origin, joint.axis, strict=True))
        return Transform(joint.parent, joint.child, (x, y, z))
    sine = math.sin(position / 2)
    x, y, z = (sine * axis for axis in joint.axis)
    return Transform(joint.parent, joint.child, joint.origin, (x, y, z, math.cos(position / 2)))
