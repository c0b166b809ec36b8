# SPDX-License-Identifier: Apache-2.0
"""Damping of the muscles that differs between shortening and lengthening."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

ROUNDING = 1e-3  # m/s, over which |rate| is rounded at standstill
REFERENCE_PRESSURE = 6.0e5  # Pa gauge at which `asymmetry` holds


def _expression(s, p, _states):
    """D + a while a muscle shortens, D - a while it lengthens: the difference is -a |rate|."""

    def lost(rate, gauge):
        speed = ca.sqrt(rate**2 + ROUNDING**2) - ROUNDING
        return -p.asymmetry * gauge / REFERENCE_PRESSURE * speed

    return Contribution(
        {
            "extensor_force": lost(s.extensor_rate, s.extensor_gauge),
            "flexor_force": lost(s.flexor_rate, s.flexor_gauge),
        }
    )


EFFECTS = [
    Effect(
        name="direction_dependent_damping",
        stage="force",
        parameters=(
            Quantity(
                "asymmetry", 150.0, "N s/m", -3000.0, 3000.0,
                "half the difference of the dampings of shortening and lengthening at 6 bar gauge", 0.0,
            ),
        ),
        expression=_expression,
        physics="A muscle is damped more while it contracts than while it relaxes, the more the higher its "
        "pressure. At equal pressures the two muscles of a joint hide it: one shortens while the other "
        "lengthens at the same rate.",
        source="Reynolds et al. 2003 (relaxation damped less than contraction); magnitude: assumption",
        minimum_effect=30.0,
        coordinate="extensor_rate",
        starts=({"asymmetry": -150.0},),
        confounded_with=("pressure_dependent_damping",),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
    )
]  # fmt: skip
