# SPDX-License-Identifier: Apache-2.0
"""What only the orthosis' knee can have: play of its chain, a mass at the foot."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals

HOLD = 50.0  # 1/(rad s): about 2 1/s for a knee that rests inside a gap of 0.3 degrees


def _backlash(s: Signals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """A play operator of unit width (Bouc-Wen form, exponent 4): the sprocket lags behind the knee."""
    (z,) = states
    least_gap = 2.0e-3  # rad: a smaller gap is crossed as if it were this wide, lest the model be stiff
    gap = ca.fmax(p.half_width, least_gap)
    speed = ca.sqrt(s.velocity**2 + 1e-12)
    rate = (s.velocity - 0.5 * (speed * z * ca.fabs(z) ** 3 + s.velocity * z**4)) / gap
    radius = s.parameters.cogwheel_diameter / 2
    wound, winding = radius * p.half_width * z, radius * p.half_width * rate
    extensor, flexor = s.actuators
    return Contribution(
        {},
        (rate,),
        {
            extensor: {"contraction": wound, "rate": winding},
            flexor: {"contraction": -wound, "rate": -winding},
        },
    )


EFFECTS = [
    Effect(
        name="backlash",
        of="knee",
        stage="body",
        parameters=(
            Quantity("half_width", 6.0e-3, "rad", 0.0, 0.1, "half the angle that the knee moves freely", 0.0),
        ),
        expression=_backlash,
        physics="Chain links, keys and the arbor have clearance: when the knee reverses, the sprocket stays "
        "until the clearance is used up, and with it the muscles.",
        source="assumption, 0.3 to 1.5 degrees of an unloaded chain drive",
        minimum_effect=5.0e-4,
        starts=({"half_width": 2.0e-2},),
        confounded_with=("muscle_hysteresis", "angle_delay"),
        separated_by=("diagnostic-triangle",),
        states=("cogwheel_play",),
        scales=(1.0,),
        # where a knee comes to rest inside its play is decided by less torque than is known
        held={"cogwheel_play": {"angle": HOLD}},
    ),
    Effect(
        name="extra_foot_mass",
        of="knee",
        stage="body",
        parameters=(Quantity("mass", 0.5, "kg", -1.0, 10.0, "mass at the ankle", 0.0),),
        expression=lambda _s, p, _states: Contribution({"extra_mass": p.mass}),
        physics="A point mass at the ankle raises inertia and gravity together; Eq. (26) carries it in "
        "m(q), k and G.",
        source="paper, section 3 (Stimulative Shoe at the ankle); magnitude: assumption",
        minimum_effect=0.05,
        starts=({"mass": -0.2},),
        coordinate="acceleration",
        confounded_with=("parallel_elasticity",),
        separated_by=("diagnostic-decay",),
    ),
]  # fmt: skip
