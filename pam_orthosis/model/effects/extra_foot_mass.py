# SPDX-License-Identifier: Apache-2.0
"""Mass at the foot that the model does not know: a heavier shoe, a load."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

EFFECTS = [
    Effect(
        name="extra_foot_mass",
        stage="body",
        parameters=(Quantity("mass", 0.5, "kg", -1.0, 10.0, "mass at the ankle", 0.0),),
        expression=lambda _s, p, _states: Contribution({"extra_foot_mass": p.mass}),
        physics="A point mass at the ankle raises inertia and gravity together; Eq. (26) carries it in "
        "m(q), k and G.",
        source="paper, section 3 (Stimulative Shoe at the ankle); magnitude: assumption",
        minimum_effect=0.05,
        starts=({"mass": -0.2},),
        coordinate="acceleration",
        confounded_with=("parallel_elasticity",),
        separated_by=("diagnostic-decay",),
    )
]
