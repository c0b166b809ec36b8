# SPDX-License-Identifier: Apache-2.0
"""Air that comes in warmer while the muscles work."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="temperature_drift",
        stage="gas",
        parameters=(
            Quantity("rise", 15.0, "K", -60.0, 80.0, "final rise of the gas temperature", 0.0),
            Quantity("time_constant", 20.0, "s", 0.5, 3600.0, "time constant of the warming"),
        ),
        expression=lambda s, p, _states: Contribution(
            {"temperature": p.rise * (1 - ca.exp(-s.time / p.time_constant))}
        ),
        physics="Cyclic work and friction warm muscle and hose from the first stroke on, and so the air "
        "that comes in: the same mass flow then raises the pressure more, Eq. (6). Enclosed air is not.",
        source="a muscle warms by 10 to 20 K in cyclic work (assumption)",
        minimum_effect=2.0,
        starts=({"rise": -15.0}, {"time_constant": 100.0}),
        coordinate="time",
        confounded_with=("extensor_valve_gain", "flexor_valve_gain"),
        separated_by=("diagnostic-locked",),
    )
]
