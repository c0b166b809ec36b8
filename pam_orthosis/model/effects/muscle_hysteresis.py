# SPDX-License-Identifier: Apache-2.0
"""Hysteresis of the braid: the force depends on the direction from which a contraction was reached."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

REFERENCE_PRESSURE = 6.0e5  # Pa gauge at which `half_width` holds


def _operator(z, rate, sliding):
    """Return dz/dt of the Bouc-Wen operator with unit saturation (A = beta + gamma = 1, n = 2)."""
    smooth = ca.sqrt(rate**2 + 1e-12)
    return (rate - 0.5 * (smooth * z * ca.fabs(z) + rate * z**2)) / sliding


def _force(z, pressure_gauge, p):
    level = p.offset_share + (1 - p.offset_share) * pressure_gauge / REFERENCE_PRESSURE
    return -p.half_width * level * z


def _expression(s, p, states):
    """A muscle that shortens pulls less, one that is stretched pulls more."""
    ze, zf = states
    return Contribution(
        {
            "extensor_force": _force(ze, s.extensor_gauge, p),
            "flexor_force": _force(zf, s.flexor_gauge, p),
        },
        (
            _operator(ze, s.extensor_rate, p.sliding_distance),
            _operator(zf, s.flexor_rate, p.sliding_distance),
        ),
    )


EFFECTS = [
    Effect(
        name="muscle_hysteresis",
        stage="force",
        parameters=(
            Quantity("half_width", 12.0, "N", 0.0, 200.0, "half width of the force loop at 6 bar gauge", 0.0),
            Quantity(
                "offset_share",
                0.4,
                "-",
                0.0,
                1.0,
                "share of the half width left without pressure",
                fitted=False,
                meaningful=(0.0, 1.0),
            ),
            Quantity(
                "sliding_distance",
                1.0e-3,
                "m",
                5.0e-5,
                0.02,
                "contraction until the fibres slide",
                meaningful=(5.0e-5, 0.01),  # wider, it is an elasticity
            ),
        ),
        expression=_expression,
        physics="The fibres of the braid rub on each other and on the rubber. They stick over a short "
        "distance, then slide; the friction grows with the pressure that presses them together.",
        source="Bouc-Wen operator; half width 8 to 15 N for a 20 mm muscle, extrapolated from a measured "
        "loop of a DMSP-10-250",
        minimum_effect=2.0,
        starts=({"sliding_distance": 3.0e-4}, {"sliding_distance": 4.0e-3}),
        coordinate="extensor_rate",
        confounded_with=("joint_friction", "creep"),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
        states=("extensor_hysteresis", "flexor_hysteresis"),
        scales=(1.0, 1.0),
    )
]
