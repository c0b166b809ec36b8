# SPDX-License-Identifier: Apache-2.0
"""Offset of one pressure sensor."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    return Effect(
        name=f"{muscle}_pressure_offset",
        stage="sensor",
        parameters=(Quantity("offset", 8.0e3, "Pa", -1.0e5, 1.0e5, "measured - true pressure", 0.0),),
        expression=lambda _s, p, _states: Contribution({f"measured_{muscle}_pressure": p.offset}),
        physics=f"The zero of the {muscle}'s pressure sensor has drifted, by temperature or "
        "because it was set at another barometric pressure.",
        source="data sheets of 10 bar sensors: 0.5 to 1 % of the span",
        minimum_effect=1.0e3,
        starts=({"offset": -8.0e3},),
        coordinate=f"{muscle}_pressure",
        confounded_with=("constant_torque", f"{muscle}_pressure_gain"),
        separated_by=("diagnostic-cocontraction", "diagnostic-hold"),
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
