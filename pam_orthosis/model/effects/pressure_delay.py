# SPDX-License-Identifier: Apache-2.0
"""Delay of one pressure sensor."""

from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _effect(muscle: str) -> Effect:
    def expression(s, p, states):
        rate = getattr(s, f"{muscle}_pressure_rate")
        lost = pade.lost(states, p.delay)
        return Contribution({f"measured_{muscle}_pressure": -lost}, pade.chain(states, rate, p.delay))

    return Effect(
        name=f"{muscle}_pressure_delay",
        stage="sensor",
        parameters=(Quantity("delay", 3.0e-3, "s", 5.0e-4, 0.05, "age of the value"),),
        expression=expression,
        physics=f"Damping screen, filter or bus deliver the {muscle}'s pressure late; the pure delay is "
        "represented by its Pade approximation (2, 3), driven by the pressure's rate.",
        source="1 to 2 ms lag of the sensor class; more with filters (assumption)",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.0e-2}),
        coordinate=f"{muscle}_pressure_rate",
        confounded_with=("valve_delay", "hose_resistance", "angle_delay"),
        separated_by=("diagnostic-locked", "diagnostic-cocontraction"),
        advance=lambda p: {f"{muscle}_pressure": p.delay},
        fastest=lambda p: 0.24 * p.delay,
        states=tuple(f"{muscle}_pressure_delay_{k}" for k in "abc"),
        scales=(1.0e4,) * 3,
    )


EFFECTS = [_effect("extensor"), _effect("flexor")]
