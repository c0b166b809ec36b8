# SPDX-License-Identifier: Apache-2.0
"""Spastic stretch reflex of a person's leg: a torque against fast stretching."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, states):
    """The excess of the velocity over the threshold, lagged, is answered by a torque against it."""
    (excess,) = states
    above = ca.fmax(s.velocity - p.threshold, 0) + ca.fmin(s.velocity + p.threshold, 0)
    return Contribution({"torque": -p.gain * excess}, ((above - excess) / p.lag,))


EFFECTS = [
    Effect(
        name="stretch_reflex",
        stage="torque",
        parameters=(
            Quantity("gain", 0.5, "N m s/rad", 0.0, 50.0, "torque per velocity above the threshold", 0.0),
            Quantity("threshold", 1.0, "rad/s", 0.0, 8.0, "velocity of stretch at which the reflex sets in"),
            Quantity(
                "lag",
                0.04,
                "s",
                0.005,
                0.3,
                "time constant of the reflex arc",
                meaningful=(0.005, 0.2),  # arcs over the cortex take 0.1 s
            ),
        ),
        expression=_expression,
        physics="After a lesion of the spinal cord a muscle that is stretched faster than a threshold "
        "contracts by a reflex, some tens of milliseconds later, in both directions of the knee.",
        source="spasticity as a velocity-dependent stretch reflex (Lance 1980); magnitude: assumption",
        minimum_effect=0.03,
        starts=({"threshold": 0.3}, {"threshold": 2.5}, {"lag": 0.1}),
        confounded_with=("viscous_friction",),
        separated_by=("diagnostic-triangle", "diagnostic-decay"),
        fastest=lambda p: p.lag,
        states=("reflex",),
        scales=(1.0,),
    )
]
