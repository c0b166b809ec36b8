# SPDX-License-Identifier: Apache-2.0
"""Volume between one valve and its muscle that the model does not know."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    return Effect(
        name=f"{muscle}_dead_volume",
        stage="gas",
        parameters=(Quantity("volume", 3.0e-5, "m^3", -2.5e-5, 1.0e-3, "additional dead volume", 0.0),),
        expression=lambda _s, p, _states: Contribution({f"{muscle}_dead_volume": p.volume}),
        physics=f"A longer hose, a fitting or a sensor cavity at the {muscle}: the same air changes the "
        "pressure less, and the muscle becomes a softer gas spring.",
        source="1 m of hose of 4 mm bore holds 12.6 cm^3, of 6 mm bore 28 cm^3",
        minimum_effect=1.2e-5,
        starts=({"volume": -1.0e-5},),
        coordinate=f"{muscle}_contraction",
        confounded_with=(f"{muscle}_valve_gain", "polytropic_exponent"),
        separated_by=("diagnostic-locked", "diagnostic-decay"),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
