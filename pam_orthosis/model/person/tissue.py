# SPDX-License-Identifier: Apache-2.0
"""What a person's tissue and reflexes do at a joint, as effects below `plant.person`.

They are the truth of a person, not of the apparatus: neither the nominal model nor the gap workflow has them.
"""

import math

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.passive import knee_moment
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals


def _passive_moment(s: Signals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """The knee's passive moment at the hip angle of Eq. (24), and a viscous part."""
    hip = leg.hip_angle(s.coordinate, s.parameters)
    elastic = knee_moment(s.coordinate * (180 / math.pi), hip * (180 / math.pi))
    return Contribution({"effort": p.scale * elastic - p.viscosity * s.velocity})


def _ligaments(s: Signals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """Ligaments stop a knee at both ends of its range, steeply."""
    low = 6.09 * ca.exp(-33.94 * (s.coordinate + 0.13))
    high = 11.03 * ca.exp(11.33 * (s.coordinate - 2.40))
    return Contribution({"effort": p.scale * (low - high)})


def _clonus(s: Signals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """Fast flexion stretches the extensors, which answer by bursts that die away."""
    (activity,) = states
    stretched = 0.5 * (1 + ca.tanh((s.velocity - p.threshold) / (0.1 * p.threshold)))
    burst = ca.fmax(ca.sin(2 * math.pi * p.frequency * s.time), 0)
    rise = 0.05  # s, in which a fast stretch brings clonus on
    rate = stretched * (1 - activity) / rise - activity / p.decay
    return Contribution({"effort": -p.amplitude * activity * burst}, (rate,))


TISSUE: tuple[Effect, ...] = (
    Effect(
        name="clonus",
        of="rotation",
        stage="torque",
        parameters=(
            Quantity("amplitude", 12.0, "N m", 0.0, 100.0, "largest torque of a burst", 0.0),
            Quantity("frequency", 6.0, "Hz", 3.0, 10.0, "bursts a second"),
            Quantity("threshold", 3.0, "rad/s", 0.1, 12.0, "velocity of flexion that brings it on"),
            Quantity("decay", 0.6, "s", 0.05, 30.0, "time constant in which it dies away"),
        ),
        expression=_clonus,
        physics="A muscle that is stretched fast contracts, yields and contracts again, some times a second.",
        source="frequency: 5 to 8 Hz, as published for clonus; the rest is an assumption",
        states=("clonus",),
        scales=(1.0,),
    ),
    Effect(
        name="ligaments",
        of="knee",
        stage="torque",
        parameters=(Quantity("scale", 1.0, "-", 0.0, 5.0, "stiffness / published stiffness", 0.0),),
        expression=_ligaments,
        physics="At the ends of a joint's range its ligaments take up load steeply.",
        source="Anderson 1999 (end stops of knee and ankle), as public codes have it",
    ),
    Effect(
        name="passive_moment",
        of="knee",
        stage="torque",
        parameters=(
            Quantity("scale", 1.0, "-", 0.0, 5.0, "moment / published mean of healthy adults", 0.0),
            Quantity("viscosity", 0.1, "N m s/rad", 0.0, 10.0, "torque per speed"),
        ),
        expression=_passive_moment,
        physics="Relaxed muscles, tendons and skin bend a straight knee and straighten a bent one; muscles"
        " over two joints make that depend on the hip.",
        source="Riener and Edrich 1999, coefficients as five independent public codes have them",
    ),
)  # fmt: skip
