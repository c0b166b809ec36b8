# SPDX-License-Identifier: Apache-2.0
"""Force of one muscle that differs from its map by a factor."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    force = f"{muscle}_force"
    return Effect(
        name=f"{muscle}_force_scale",
        stage="force",
        parameters=(Quantity("scale", 0.9, "-", 0.3, 2.0, "true force / force of the map", 1.0),),
        expression=lambda s, p, _states: Contribution({force: (p.scale - 1) * getattr(s, force)}),
        physics=f"The {muscle}'s specimen, its wear, or a broken fibre makes the whole static force map "
        "larger or smaller by a factor.",
        source="manufacturer's tolerance 10 %; published maps of the same type differ by 6 to 9 %",
        minimum_effect=0.02,
        starts=({"scale": 1.1},),
        coordinate=f"{muscle}_pressure",
        confounded_with=(f"{muscle}_pressure_gain", "constant_torque"),
        separated_by=("diagnostic-cocontraction",),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
