# SPDX-License-Identifier: Apache-2.0
"""Where leg and muscles are at a knee angle: the one geometry of pictures, URDF, TF and markers.

Side view as in `model.leg`: hip in the origin, x along the ankle's bearing, z up. Both muscles lie along
the thigh, the extensor on its front, at the distance of the sprocket's radius; their upper ends are
fixed, their lower ends pull the chain. With muscles of 0.5 m the upper ends lie beyond the hip.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.model import leg as leg_model
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model.compiled import Compiled
from pam_orthosis.model.orthosis import MUSCLES

# side of the thigh: the extensor on the front, which is up for a knee that points up
SIDES = {"extensor": 1.0, "flexor": -1.0}


class MusclePose(NamedTuple):
    """One muscle: its ends and where its chain meets the sprocket, (n, 2) m; the rest (n,) m."""

    upper: np.ndarray
    lower: np.ndarray
    chain: np.ndarray
    contraction: np.ndarray
    diameter: np.ndarray


class Pose(NamedTuple):
    """Joints (x, z), (n, 2) m each; hip angle (n,) rad; muscles by name."""

    hip: np.ndarray
    knee: np.ndarray
    ankle: np.ndarray
    toe: np.ndarray
    hip_angle: np.ndarray
    muscles: dict[str, MusclePose]


@dataclass(frozen=True)
class LegShape:
    """The geometry of one leg.

    Args:
        parameters: tree with the branches `leg` and `muscle`.
    """

    parameters: Any

    @property
    def radius(self) -> float:
        """Radius of the sprocket, m."""
        return self.parameters.leg.cogwheel_diameter / 2

    @property
    def anchor_distance(self) -> float:
        """Distance along the thigh from the knee's axis to the fixed ends of the muscles, m."""
        return self.parameters.leg.muscle_clearance + self.parameters.muscle.dmsp_20.length

    @cached_property
    def _function(self) -> ca.Function:
        leg, m = self.parameters.leg, self.parameters.muscle.dmsp_20
        q = ca.SX.sym("q")
        contractions = leg_model.contractions(q, leg)
        diameters = [muscle_model.braid_diameter(one, m) for one in contractions]
        return ca.Function("leg_shape", [q], [leg_model.hip_angle(q, leg), *contractions, *diameters])

    @cached_property
    def _of_one(self) -> Compiled:
        return Compiled(self._function)

    def at(self, angle: float) -> list[float]:
        """Return hip angle, rad, contractions and diameters of the muscles, m, at one knee angle, rad."""
        return [float(part[0]) for part in self._of_one(angle)]

    def pose(self, angles: np.ndarray) -> Pose:
        """Return where everything is at knee angles (n,), rad."""
        angles = np.atleast_1d(np.asarray(angles, dtype=float))
        hip_angle, *muscles = (part.full()[0] for part in self._function(angles[None, :]))
        leg = self.parameters.leg
        thigh, shank = leg_model.segment_lengths(leg)
        shank_angle = hip_angle - leg.configuration * angles
        along, down = _direction(hip_angle), _direction(shank_angle)
        knee = thigh * along
        ankle = knee + shank * down
        toe = ankle + leg.shoe_length * leg.configuration * _normal(down)
        contractions, diameters = muscles[:2], muscles[2:]
        return Pose(
            np.zeros_like(knee), knee, ankle, toe, hip_angle,
            {
                name: self._muscle(name, knee, along, contraction, diameter)
                for name, contraction, diameter in zip(MUSCLES, contractions, diameters, strict=True)
            },
        )  # fmt: skip

    def offset(self, name: str) -> float:
        """Return how far a muscle lies beside the thigh's axis, towards +z of the straight leg, m."""
        return SIDES[name] * self.parameters.leg.configuration * self.radius

    def _muscle(self, name: str, knee, along, contraction, diameter) -> MusclePose:
        beside = knee + self.offset(name) * _normal(along)
        lower = self.parameters.leg.muscle_clearance + contraction
        return MusclePose(
            beside - self.anchor_distance * along, beside - lower[:, None] * along, beside,
            contraction, diameter,
        )  # fmt: skip


def _direction(angle: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _normal(direction: np.ndarray) -> np.ndarray:
    """Return a direction turned by a right angle, from x to z."""
    return np.column_stack([-direction[:, 1], direction[:, 0]])
