# SPDX-License-Identifier: Apache-2.0
"""Friction of the test rig's carriage. It belongs to the rig, not to the catalogue of the knee."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, _states):
    """Dry and viscous friction opposed to the motion, smooth through standstill."""
    dry = p.coulomb * ca.tanh(s.velocity / p.transition_velocity)
    return Contribution({"carriage_force": -dry - p.viscosity * s.velocity})


RIG_EFFECTS = {
    "carriage_friction": Effect(
        name="carriage_friction",
        stage="torque",
        parameters=(
            Quantity("coulomb", 2.0, "N", 0.0, 200.0, "Coulomb friction of the carriage", 0.0),
            Quantity(
                "viscosity",
                5.0,
                "N s/m",
                0.0,
                1000.0,
                "viscous friction of the carriage",
                fitted=False,
                meaningful=(0.0, 1000.0),
            ),
            Quantity(
                "transition_velocity",
                1.0e-3,
                "m/s",
                1.0e-5,
                0.1,
                "width of the change of sign",
                fitted=False,
                meaningful=(1.0e-5, 0.015),  # as at the knee, on the sprocket
            ),
        ),
        expression=_expression,
        physics="The carriage rolls on a rail whose seals and balls rub; the paper neglects it.",
        source="assumption, ball rail of 20 kg load",
        minimum_effect=0.5,
        confounded_with=("muscle_hysteresis",),
    )
}
