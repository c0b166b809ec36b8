# SPDX-License-Identifier: Apache-2.0
"""Dry friction of the knee joint with the Stribeck rise at low speed."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, _states):
    """Friction torque opposed to the motion, smooth through standstill."""
    stribeck = 1 + p.stribeck * ca.exp(-((s.velocity / p.stribeck_velocity) ** 2))
    return Contribution({"torque": -p.coulomb * stribeck * ca.tanh(s.velocity / p.transition_velocity)})


EFFECTS = [
    Effect(
        name="joint_friction",
        stage="torque",
        parameters=(
            Quantity("coulomb", 0.8, "N m", 0.0, 20.0, "Coulomb torque", 0.0),
            Quantity("stribeck", 0.2, "-", 0.0, 2.0, "rise of the torque at low speed / Coulomb torque"),
            Quantity(
                "stribeck_velocity",
                0.1,
                "rad/s",
                0.005,
                5.0,
                "speed at which the rise has decayed",
                fitted=False,
            ),
            Quantity(
                "transition_velocity", 0.02, "rad/s", 0.001, 1.0, "width of the change of sign", fitted=False
            ),
        ),
        expression=_expression,
        physics="Bearings, chain and orthosis shells rub with a torque that hardly depends on the speed, "
        "is a little larger at the start (Stribeck), and changes its sign with the direction.",
        source="assumption, 0.3 to 1 N m for an orthosis joint",
        minimum_effect=0.05,
        confounded_with=("muscle_hysteresis",),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
    )
]
