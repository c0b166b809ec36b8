# SPDX-License-Identifier: Apache-2.0
"""Dry friction of the knee joint with the Stribeck rise at low speed."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, states):
    """Friction torque opposed to the motion; through standstill smooth in speed, or elastic (bristles)."""
    (bristle,) = states
    stribeck = 1 + p.stribeck * ca.exp(-((s.velocity / p.stribeck_velocity) ** 2))
    sliding = ca.tanh(s.velocity / p.transition_velocity)
    speed = ca.sqrt(s.velocity**2 + 1e-12)
    bent = s.velocity - 0.5 * (speed * bristle * ca.fabs(bristle) + s.velocity * bristle**2)
    torque = -p.coulomb * stribeck * ((1 - p.bristles) * sliding + p.bristles * bristle)
    return Contribution({"torque": torque}, (bent / p.presliding,))


EFFECTS = [
    Effect(
        name="joint_friction",
        stage="torque",
        parameters=(
            Quantity("coulomb", 0.8, "N m", 0.0, 20.0, "Coulomb torque", 0.0),
            Quantity(
                "stribeck",
                0.2,
                "-",
                0.0,
                2.0,
                "rise of the torque at low speed / Coulomb torque",
                meaningful=(0.0, 2.0),
            ),
            Quantity(
                "stribeck_velocity",
                0.1,
                "rad/s",
                0.005,
                5.0,
                "speed at which the rise has decayed",
                fitted=False,
                meaningful=(0.005, 5.0),
            ),
            Quantity(
                "transition_velocity",
                0.02,
                "rad/s",
                0.001,
                1.0,
                "width of the change of sign",
                fitted=False,
                meaningful=(0.001, 0.3),  # wider, most of a slow step has viscous friction
            ),
            Quantity(
                "bristles",
                0.0,
                "-",
                0.0,
                1.0,
                "share of the torque that sticks at standstill",
                fitted=False,
                meaningful=(0.0, 1.0),
            ),
            Quantity(
                "presliding",
                5.0e-3,
                "rad",
                2.0e-4,
                0.1,
                "angle until what sticks slides",
                fitted=False,
                meaningful=(2.0e-4, 0.05),  # wider, it is an elasticity
            ),
        ),
        expression=_expression,
        physics="Bearings, chain and orthosis shells rub with a torque that hardly depends on the speed, "
        "is a little larger at the start (Stribeck), and changes its sign with the direction. Surfaces "
        "that stick yield elastically over a small angle first (bristles, as in the LuGre and Dahl models).",
        source="assumption, 0.3 to 1 N m for an orthosis joint; Canudas de Wit et al. 1995 (bristles)",
        states=("friction_bristle",),
        scales=(1.0,),
        minimum_effect=0.05,
        confounded_with=("muscle_hysteresis",),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
    )
]
