# SPDX-License-Identifier: Apache-2.0
"""A spring parallel to the knee: orthosis shells, straps, passive tissue."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="parallel_elasticity",
        stage="torque",
        parameters=(
            Quantity("stiffness", 2.0, "N m/rad", -50.0, 200.0, "stiffness of the spring", 0.0),
            Quantity(
                "rest_angle",
                0.6,
                "rad",
                -1.0,
                2.0,
                "knee angle at which it is free of load",
                fitted=False,
                meaningful=(-1.0, 2.0),
            ),
        ),
        expression=lambda s, p, _states: Contribution({"torque": -p.stiffness * (s.angle - p.rest_angle)}),
        physics="Shells, straps, hoses and soft tissue pull the knee towards a middle angle.",
        source="assumption; a human knee's passive stiffness in mid range is a few N m/rad",
        minimum_effect=0.1,
        starts=({"stiffness": -2.0},),
        coordinate="angle",
        confounded_with=("force_map_misfit", "constant_torque"),
        separated_by=("diagnostic-cocontraction",),
    )
]
