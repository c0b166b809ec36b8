# SPDX-License-Identifier: Apache-2.0
"""Mechanisms of several coordinates, each of which is the joint of a machine of its own."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.ankle import foot_bodies, passive_moment
from pam_orthosis.model.mechanisms.base import Mechanics
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression


@dataclass(frozen=True)
class Leg:
    """Knee and ankle, the ankle on its linear bearing: Eqs. (24)-(26) with a foot that turns.

    Attributes:
        joints: kinds of the mechanisms whose coordinates these are, in order.
        subjects: files of `config/` with rows that its joints have.
        parameters: the section `leg` with its rows of the ankle.
    """

    joints: ClassVar[tuple[str, ...]] = ("knee", "ankle")
    subjects: ClassVar[tuple[str, ...]] = ("ankle", "coupled")
    parameters: Section

    def bodies(self, q: Expression, extra_mass: Expression = 0.0) -> list[leg.Body]:
        """Return all bodies at knee and ankle angle (2,), rad, with a mass on the ankle's axis, kg."""

        def foot(shank: Expression, ankle: Expression, p: Section) -> list[leg.Body]:
            return [*foot_bodies(q[1], shank, ankle, p), leg.Body(extra_mass, 0.0, ankle, 0.0)]

        return leg.bodies(q[0], self.parameters, foot)

    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return inertia (2, 2), k (2,) and G (2,) of Eq. (26); G holds the person's moment at the ankle.

        Angles and velocities of knee and ankle are symbols (2,); `extra_mass` is on the ankle's axis, kg.
        """
        p, terms = self.parameters, leg.lagrange(q, velocity, self.bodies(q, extra_mass))
        if not p.person.present:
            return terms
        passive = p.ankle.passive_share * passive_moment(q[1], q[0])
        return Mechanics(terms.inertia, terms.coriolis, terms.gravity + ca.vertcat(0, passive))

    def terms_of(
        self,
        joint: int,
        q: Expression,
        velocity: Expression,
        beside: Expression,
        extra_mass: Expression = 0.0,
    ) -> Mechanics:
        """Return a joint's terms of Eq. (26), the other one moving as is known: what that asks is in k and G.

        Args:
            joint: its number.
            q: its angle, a symbol, rad.
            velocity: a symbol, rad/s.
            beside: angle, velocity and acceleration of the other joint, symbols (3,).
            extra_mass: as for `terms`.
        """
        order = slice(None, None, -1 if joint else 1)
        x, v = ([own, beside[i]][order] for i, own in enumerate((q, velocity)))
        terms = self.terms(ca.vertcat(*x), ca.vertcat(*v), extra_mass)
        carried = terms.coriolis[joint] + terms.inertia[joint, 1 - joint] * beside[2]
        return Mechanics(terms.inertia[joint, joint], carried, terms.gravity[joint])


COUPLED = {"leg": Leg}


def accelerations(effort: Expression, terms: Mechanics, free: Sequence[int]) -> Expression:
    """Return q-double-dot (n,) of Eq. (26) for the efforts on n coordinates; those that are not free rest."""
    own, rest = list(free), effort - terms.coriolis - terms.gravity
    result = ca.SX.zeros(rest.shape[0])
    if own:
        result[own] = ca.inv_minor(terms.inertia[own, own]) @ rest[own]
    return result
