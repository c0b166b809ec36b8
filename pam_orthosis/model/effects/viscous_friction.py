# SPDX-License-Identifier: Apache-2.0
"""Viscous friction of the knee joint."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="viscous_friction",
        stage="torque",
        parameters=(Quantity("viscosity", 0.1, "N m s/rad", 0.0, 20.0, "torque per speed", 0.0),),
        expression=lambda s, p, _states: Contribution({"torque": -p.viscosity * s.velocity}),
        physics="Grease and soft tissue resist with a torque proportional to the speed.",
        source="assumption, 0.05 to 0.2 N m s/rad for an orthosis joint",
        minimum_effect=0.03,
        confounded_with=("pressure_dependent_damping",),
        separated_by=("diagnostic-decay",),
    )
]
