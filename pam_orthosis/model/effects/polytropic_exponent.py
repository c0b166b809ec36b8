# SPDX-License-Identifier: Apache-2.0
"""Polytropic exponent of the gas that differs from the believed one."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="polytropic_exponent",
        stage="gas",
        parameters=(
            Quantity("shift", 0.1, "-", -0.2, 0.4, "true exponent - believed exponent of Eq. (3)", 0.0),
        ),
        expression=lambda _s, p, _states: Contribution({"polytropic_exponent": p.shift}),
        physics="Heat exchange with rubber and fittings decides where the gas lies between isothermal "
        "(n = 1) and adiabatic (n = 1.4): small chambers and slow strokes are nearer to isothermal.",
        source="paper, Eq. (3); published values 1.0 to 1.4, charging above discharging",
        minimum_effect=0.02,
        starts=({"shift": -0.08},),
        coordinate="extensor_pressure",
        confounded_with=(
            "extensor_dead_volume",
            "flexor_dead_volume",
            "extensor_valve_gain",
            "flexor_valve_gain",
        ),
        separated_by=("diagnostic-decay", "diagnostic-locked"),
    )
]
