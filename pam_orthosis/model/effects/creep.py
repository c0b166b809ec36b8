# SPDX-License-Identifier: Apache-2.0
"""Creep of the muscles: after a change of length the force relaxes over seconds."""

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, states):
    """One Maxwell branch beside each muscle; the states are the stretches of its spring, m."""
    de, df = states
    return Contribution(
        {"extensor_force": -p.stiffness * de, "flexor_force": -p.stiffness * df},
        (s.extensor_rate - de / p.time_constant, s.flexor_rate - df / p.time_constant),
    )


EFFECTS = [
    Effect(
        name="creep",
        stage="force",
        parameters=(
            Quantity("stiffness", 600.0, "N/m", 0.0, 20000.0, "stiffness of the branch that relaxes", 0.0),
            Quantity("time_constant", 1.0, "s", 0.05, 30.0, "time constant of the relaxation"),
        ),
        expression=_expression,
        physics="Rubber and fibres of a muscle flow: at once it answers a change of length as a stiffer "
        "spring, then the additional force relaxes. At a constant load it creeps on by several per cent.",
        source="measured creep of about a quarter of the fast part in 4 s, time constants 0.5 to 1 s "
        "(facts of published DMSP-10 data); data sheet: relaxation up to 5 %",
        minimum_effect=50.0,
        starts=({"time_constant": 0.25}, {"time_constant": 5.0}),
        coordinate="extensor_contraction",
        confounded_with=("muscle_hysteresis", "parallel_elasticity"),
        separated_by=("diagnostic-hold", "diagnostic-cocontraction"),
        fastest=lambda p: p.time_constant,
        states=("extensor_creep", "flexor_creep"),
        scales=(0.01, 0.01),
    )
]
