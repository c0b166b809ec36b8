# SPDX-License-Identifier: Apache-2.0
"""Offset of the encoder."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="angle_offset",
        stage="sensor",
        parameters=(Quantity("offset", 0.02, "rad", -0.5, 0.5, "measured - true angle", 0.0),),
        expression=lambda _s, p, _states: Contribution({"measured_angle": p.offset}),
        physics="The encoder's zero was set at another angle than the straight leg: force, inertia and "
        "gravity are all taken at a wrong angle.",
        source="assumption, 0.5 to 3 degrees of mounting error",
        minimum_effect=2.0e-3,
        starts=({"offset": -0.02},),
        coordinate="angle",
        confounded_with=("constant_torque", "parallel_elasticity"),
        separated_by=("diagnostic-cocontraction",),
    )
]
