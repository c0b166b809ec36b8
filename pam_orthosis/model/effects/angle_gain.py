# SPDX-License-Identifier: Apache-2.0
"""Gain error of the angle measurement."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="angle_gain",
        stage="sensor",
        parameters=(Quantity("gain", 1.02, "-", 0.5, 1.5, "measured / true angle", 1.0),),
        expression=lambda s, p, _states: Contribution({"measured_angle": (p.gain - 1) * s.measured_angle}),
        physics="A gear or a lever between knee and encoder, or a potentiometer's slope, is a little off.",
        source="assumption, 1 to 3 %",
        minimum_effect=3.0e-3,
        starts=({"gain": 0.98},),
        coordinate="angle",
        confounded_with=("parallel_elasticity", "angle_offset"),
        separated_by=("diagnostic-cocontraction",),
    )
]
