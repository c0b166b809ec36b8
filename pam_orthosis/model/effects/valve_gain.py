# SPDX-License-Identifier: Apache-2.0
"""Sonic conductance of one valve that differs by a factor."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    opening = f"{muscle}_opening"
    return Effect(
        name=f"{muscle}_valve_gain",
        stage="opening",
        parameters=(Quantity("gain", 0.85, "-", 0.1, 3.0, "true opening / believed opening", 1.0),),
        expression=lambda s, p, _states: Contribution({opening: (p.gain - 1) * getattr(s, opening)}),
        physics=f"A narrow fitting, a dirty screen or another valve size: every opening of the {muscle}'s "
        "valve passes more or less air by the same factor.",
        source="ISO 6358 (sonic conductance); data sheets of the valve class state 10 %",
        minimum_effect=0.02,
        starts=({"gain": 1.15},),
        coordinate=f"{muscle}_voltage",
        confounded_with=(f"{muscle}_dead_volume", "polytropic_exponent"),
        separated_by=("diagnostic-locked",),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
