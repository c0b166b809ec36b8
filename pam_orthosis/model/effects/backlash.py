# SPDX-License-Identifier: Apache-2.0
"""Backlash between the knee and the cogwheel that the chain turns."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

HOLD = 50.0  # 1/(rad s): about 2 1/s for a knee that rests inside a gap of 0.3 degrees
LEAST_GAP = 2.0e-3  # rad: a smaller gap is crossed as if it were this wide, lest the model be stiff


def _expression(s, p, states):
    """A play operator of unit width (Bouc-Wen form, exponent 4): the cogwheel lags behind the knee."""
    (z,) = states
    gap = ca.fmax(p.half_width, LEAST_GAP)
    speed = ca.sqrt(s.velocity**2 + 1e-12)
    rate = (s.velocity - 0.5 * (speed * z * ca.fabs(z) ** 3 + s.velocity * z**4)) / gap
    radius = s.leg.cogwheel_diameter / 2
    wound, winding = radius * p.half_width * z, radius * p.half_width * rate
    return Contribution(
        {
            "extensor_contraction": wound,
            "flexor_contraction": -wound,
            "extensor_rate": winding,
            "flexor_rate": -winding,
        },
        (rate,),
    )


EFFECTS = [
    Effect(
        name="backlash",
        stage="body",
        parameters=(
            Quantity("half_width", 6.0e-3, "rad", 0.0, 0.1, "half the angle that the knee moves freely", 0.0),
        ),
        expression=_expression,
        physics="Chain links, keys and the arbor have clearance: when the knee reverses, the sprocket stays "
        "until the clearance is used up, and with it the muscles.",
        source="assumption, 0.3 to 1.5 degrees of an unloaded chain drive",
        minimum_effect=5.0e-4,
        starts=({"half_width": 2.0e-2},),
        confounded_with=("muscle_hysteresis", "angle_delay"),
        separated_by=("diagnostic-triangle",),
        fastest=lambda p: 0.05 * p.half_width,
        states=("cogwheel_play",),
        scales=(1.0,),
        # where a knee comes to rest inside its play is decided by less torque than is known
        held={"cogwheel_play": {"angle": HOLD}},
    )
]
