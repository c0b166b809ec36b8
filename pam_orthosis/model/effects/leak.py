# SPDX-License-Identifier: Apache-2.0
"""Leak of one muscle to the ambient."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    flow, gauge = f"{muscle}_flow", f"{muscle}_gauge"
    return Effect(
        name=f"{muscle}_leak",
        stage="flow",
        parameters=(
            Quantity("coefficient", 1.0e-10, "kg/(s Pa)", 0.0, 2.0e-8, "mass flow per gauge pressure", 0.0),
        ),
        expression=lambda s, p, _states: Contribution({flow: -p.coefficient * getattr(s, gauge)}),
        physics=f"A fitting or a crack of the {muscle} loses air, the more the higher the pressure; linear "
        "as a narrow laminar gap is.",
        source="measured decay of a closed muscle: 200 s with a bad fitting, 5000 s when tight",
        minimum_effect=1.0e-12,
        coordinate=f"{muscle}_pressure",
        confounded_with=("valve_dead_band", f"{muscle}_pressure_gain"),
        separated_by=("diagnostic-hold",),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
