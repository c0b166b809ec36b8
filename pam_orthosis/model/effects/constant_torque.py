# SPDX-License-Identifier: Apache-2.0
"""A constant torque on the knee."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="constant_torque",
        stage="torque",
        parameters=(Quantity("torque", 1.0, "N m", -50.0, 50.0, "torque in the direction of flexion", 0.0),),
        expression=lambda _s, p, _states: Contribution({"torque": p.torque}),
        physics="A steady pull: muscle tone, a bent strap, a rig that is not level.",
        source="assumption",
        minimum_effect=0.05,
        starts=({"torque": -1.0},),
        coordinate="angle",
        confounded_with=("angle_offset", "extensor_force_scale", "flexor_force_scale"),
        separated_by=("diagnostic-cocontraction",),
    )
]
