# SPDX-License-Identifier: Apache-2.0
"""Delay of the angle measurement."""

from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="angle_delay",
        stage="sensor",
        parameters=(Quantity("delay", 3.0e-3, "s", 5.0e-4, 0.05, "age of the value"),),
        expression=lambda s, p, states: Contribution(
            {"measured_angle": -pade.lost(states, p.delay)}, pade.chain(states, s.velocity, p.delay)
        ),
        physics="Filter, bus or driver deliver the angle late; the pure delay is represented by its Pade "
        "approximation (2, 3), driven by the velocity.",
        source="assumption, 1 to 10 ms",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.0e-2}),
        confounded_with=("extensor_pressure_delay", "flexor_pressure_delay"),
        separated_by=("diagnostic-locked", "diagnostic-hold"),
        advance=lambda p: {"angle": p.delay},
        fastest=lambda p: 0.24 * p.delay,
        states=("angle_delay_a", "angle_delay_b", "angle_delay_c"),
        scales=(0.05, 0.05, 0.05),
    )
]
