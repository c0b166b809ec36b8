# SPDX-License-Identifier: Apache-2.0
"""Damping of the muscles that grows with their pressure."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

REFERENCE_PRESSURE = 6.0e5  # Pa gauge at which `damping` holds


def _expression(s, p, _states):
    """Both muscles lose force while they shorten, gain it while they are stretched."""
    share = p.damping / REFERENCE_PRESSURE
    return Contribution(
        {
            "extensor_force": -share * s.extensor_gauge * s.extensor_rate,
            "flexor_force": -share * s.flexor_gauge * s.flexor_rate,
        }
    )


EFFECTS = [
    Effect(
        name="pressure_dependent_damping",
        stage="force",
        parameters=(
            Quantity("damping", 120.0, "N s/m", 0.0, 3000.0, "damping factor added at 6 bar gauge", 0.0),
        ),
        expression=_expression,
        physics="The pressure presses the fibres of the braid on each other and on the rubber: a muscle at a "
        "higher pressure resists a motion more. With a constant sum of pressures the sum of both dampings "
        "stays constant, so a gait hardly shows it; free decays at two mean pressures do.",
        source="Reynolds et al. 2003 (damping of contraction rises with pressure); magnitude: assumption",
        minimum_effect=20.0,
        coordinate="extensor_rate",
        confounded_with=("muscle_hysteresis", "viscous_friction"),
        separated_by=("diagnostic-decay",),
    )
]
