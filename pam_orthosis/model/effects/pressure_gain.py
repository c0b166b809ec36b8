# SPDX-License-Identifier: Apache-2.0
"""Gain error of one pressure sensor."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    return Effect(
        name=f"{muscle}_pressure_gain",
        stage="sensor",
        parameters=(Quantity("gain", 1.03, "-", 0.5, 1.5, "measured / true gauge pressure", 1.0),),
        expression=lambda s, p, _states: Contribution(
            {f"measured_{muscle}_pressure": (p.gain - 1) * getattr(s, f"{muscle}_gauge")}
        ),
        physics=f"The slope of the {muscle}'s pressure sensor is off by some per cent; at gauge "
        "pressure zero it is right.",
        source="data sheets of 10 bar sensors: 0.5 to 1 %; a wrong range or amplifier: more",
        minimum_effect=5.0e-3,
        starts=({"gain": 0.97},),
        coordinate=f"{muscle}_pressure",
        confounded_with=(f"{muscle}_force_scale", f"{muscle}_pressure_offset"),
        separated_by=("diagnostic-cocontraction",),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
