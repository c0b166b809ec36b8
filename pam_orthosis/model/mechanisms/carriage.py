# SPDX-License-Identifier: Apache-2.0
"""The test rig's carriage between two muscles, Eqs. (1)-(2).

Its position x_S counts from the place where the investigated muscle is not contracted, positive where it
contracts, so that dL_M,d = x_S and dL_M,r = X_S - x_S. For the free decay of section 2.4 a weight over a
pulley hangs in place of the positioner, and a hand (a stiff spring) pulls the carriage.
"""

from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from pam_orthosis.model.mechanisms.base import GRAVITY, TRANSLATION, Coordinate, Mechanics, Mechanism
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals


def carriage_acceleration(left: Expression, right: Expression, mass: Expression) -> Expression:
    """Return x_S-double-dot of Eq. (1) for the forces to the left and to the right, m/s^2."""
    return (left - right) / mass


def positioner_contraction(position: Expression, rig: Section) -> Expression:
    """Return dL_M,r of Eq. (2), m."""
    return rig.position_offset - position


@dataclass(frozen=True)
class Carriage(Mechanism):
    """The carriage, pulled to the left by the investigated muscle, to the right by the positioner."""

    kind: ClassVar[str] = "carriage"
    coordinate: ClassVar[Coordinate] = TRANSLATION
    inputs: ClassVar[tuple[str, ...]] = ("weight", "hand_stiffness", "hand_position")

    @property
    def limits(self) -> tuple[Expression, Expression]:
        """Where either muscle has its full length, m."""
        return 0.0, self.parameters.position_offset

    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return the terms of Eq. (1), as they stand in Eq. (7): a mass on a level rail."""
        return Mechanics(self.parameters.carriage_mass + extra_mass, 0, 0)

    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contractions of both muscles, m."""
        return q, positioner_contraction(q, self.parameters)

    def effort(self, s: Signals) -> Expression:
        """Return the sum of the forces to the left, N."""
        specimen, positioner = s.actuators.values()
        weight = s.external["weight"]
        right = ca.if_else(weight > 0, weight * GRAVITY, positioner.tension)
        hand_damping_time = 5.0e-3  # s, damping / stiffness of the hand
        stretch = s.external["hand_position"] - s.coordinate - hand_damping_time * s.velocity
        return specimen.tension - right + s.external["hand_stiffness"] * stretch
