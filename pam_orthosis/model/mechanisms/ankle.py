# SPDX-License-Identifier: Apache-2.0
"""The orthosis' ankle: two muscles along the shank pull ropes on levers of the foot, the knee being held.

Side view as in `mechanisms.leg`. The ankle angle q is zero where the sole is at right angles to the shank
and positive in dorsiflexion. The bodies are the Stimulative Shoe and the person's foot; on them act gravity,
in the pose that the held knee gives the shank, and the passive moment of the person's ankle.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.base import Mechanics
from pam_orthosis.model.mechanisms.one_axis import lever_contraction
from pam_orthosis.model.mechanisms.passive import ankle_moment
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression

DEGREES = 180.0 / math.pi


def passive_moment(q: Expression, knee: Expression) -> Expression:
    """Return the passive moment of a person's ankle towards plantarflexion, N m (rad, rad)."""
    return ankle_moment(-DEGREES * q, DEGREES * knee)


def foot_bodies(q: Expression, shank: Expression, ankle: Expression, p: Section) -> list[leg.Body]:
    """Return the bodies that turn with the foot: the shoe and, if there is one, the person's foot.

    Args:
        q: ankle angle, rad.
        shank: angle of the shank above x, rad.
        ankle: position (x, z) of the ankle, m.
        p: the section `leg`.
    """
    toes = shank + p.configuration * (math.pi / 2 + q)
    forward, down = leg.direction(toes), leg.direction(toes - p.configuration * math.pi / 2)

    def body(mass: Expression, part: Section, size: Expression) -> leg.Body:
        centre = ankle + size * (part.forward * forward + part.below * down)
        return leg.Body(mass, mass * (part.gyration * size) ** 2, centre, toes)

    parts, person = [body(p.shoe_mass, p.ankle.shoe, p.shoe_length)], p.person
    if person.present:
        length = p.ankle.foot.length_fraction * person.height
        parts.append(body(person.foot_mass_fraction * person.mass, p.ankle.foot, length))
    return parts


def mechanics(q: Expression, velocity: Expression, p: Section, _extra_mass: Expression = 0.0) -> Mechanics:
    """Return the terms of Eq. (26), the knee being held; G holds the person's passive moment.

    A mass that an effect adds, kg, is on the ankle's axis and does not move.
    """
    knee = p.ankle.knee_angle
    shank = leg.hip_angle(knee, p) - p.configuration * knee
    terms = leg.lagrange(q, velocity, foot_bodies(q, shank, ca.vertcat(0.0, 0.0), p))
    if not p.person.present:
        return terms
    passive = p.ankle.passive_share * passive_moment(q, knee)
    return Mechanics(terms.inertia, terms.coriolis, terms.gravity + passive)


@dataclass(frozen=True)
class Ankle(leg.LegJoint):
    """The ankle of the paper's section 1, moved by a dorsiflexor and a plantarflexor.

    A mass that an effect adds is on its axis.
    """

    kind: ClassVar[str] = "ankle"
    stops: ClassVar[tuple[str, ...]] = ("ankle.joint.minimum", "ankle.joint.maximum")
    rows: ClassVar[tuple[str, ...]] = leg.ROWS
    subject: ClassVar[str] = "ankle"
    heading: ClassVar[float] = -math.pi / 2  # of the toes in pictures, whose muscles lie along -x
    mechanics: Callable[..., Mechanics] = mechanics

    @property
    def ends(self) -> Section:
        """The parameters of its soft stops."""
        joint: Section = self.parameters.ankle.joint
        return joint

    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contractions of dorsiflexor and plantarflexor, m."""
        p = self.parameters.ankle
        return lever_contraction(q, p.dorsiflexor), lever_contraction(q, p.plantarflexor)
