# SPDX-License-Identifier: Apache-2.0
"""Friction, elasticity and torques beside those that the model of a coordinate has."""

import casadi as ca

from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression, Signals


def _carriage_friction(s: Signals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """Dry and viscous friction opposed to the motion, smooth through standstill."""
    dry = p.coulomb * ca.tanh(s.velocity / p.transition_velocity)
    return Contribution({"effort": -dry - p.viscosity * s.velocity})


def _joint_friction(s: Signals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """Friction torque opposed to the motion; through standstill smooth in speed, or elastic (bristles)."""
    (bristle,) = states
    stribeck = 1 + p.stribeck * ca.exp(-((s.velocity / p.stribeck_velocity) ** 2))
    sliding = ca.tanh(s.velocity / p.transition_velocity)
    speed = ca.sqrt(s.velocity**2 + 1e-12)
    bent = s.velocity - 0.5 * (speed * bristle * ca.fabs(bristle) + s.velocity * bristle**2)
    torque = -p.coulomb * stribeck * ((1 - p.bristles) * sliding + p.bristles * bristle)
    return Contribution({"effort": torque}, (bent / p.presliding,))


def _parallel_elasticity(s: Signals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """A torque back to the rest angle, whose stiffness may grow, and may be another on each side of it."""
    bent = s.coordinate - p.rest_angle
    both_sides = bent + p.one_sided * ca.fabs(bent)
    return Contribution({"effort": -p.stiffness * both_sides * (1 + p.hardening * bent**2)})


def _stretch_reflex(s: Signals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """A torque against the excess of the velocity over the threshold, lagged or after a dead time."""
    excess, *late = states
    bending, stretching = ca.fmax(s.velocity - p.threshold, 0), ca.fmin(s.velocity + p.threshold, 0)
    above = (1 + p.one_sided) * bending + (1 - p.one_sided) * stretching
    answered = (1 - p.dead) * excess + p.dead * pade.delayed(tuple(late))
    rates = ((above - excess) / p.lag, *pade.chain(tuple(late), above, p.lag))
    return Contribution({"effort": -p.gain * answered}, rates)


EFFECTS = [
    Effect(
        name="carriage_friction",
        of="translation",
        stage="torque",
        parameters=(
            Quantity("coulomb", 2.0, "N", 0.0, 200.0, "Coulomb friction of the carriage", 0.0),
            Quantity("viscosity", 5.0, "N s/m", 0.0, 1000.0, "viscous friction of the carriage", 0.0,
                     fitted=False, meaningful=(0.0, 990.0)),
            Quantity("transition_velocity", 1.0e-3, "m/s", 1.0e-5, 0.1, "width of the change of sign",
                     fitted=False, meaningful=(1.0e-5, 0.015)),  # wider, it is viscous
        ),
        expression=_carriage_friction,
        physics="The carriage rolls on a rail whose seals and balls rub; the paper neglects it.",
        source="assumption, ball rail of 20 kg load",
        minimum_effect=0.5,
        confounded_with=("muscle_hysteresis",),
    ),
    Effect(
        name="constant_torque",
        of="rotation",
        stage="torque",
        parameters=(Quantity("torque", 1.0, "N m", -50.0, 50.0, "torque in the direction of flexion", 0.0),),
        expression=lambda _s, p, _states: Contribution({"effort": p.torque}),
        physics="A steady pull: muscle tone, a bent strap, a rig that is not level.",
        source="assumption",
        minimum_effect=0.05,
        starts=({"torque": -1.0},),
        coordinate="angle",
        confounded_with=("angle_offset", "{actuator}_force_scale"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="joint_friction",
        of="rotation",
        stage="torque",
        parameters=(
            Quantity("coulomb", 0.8, "N m", 0.0, 20.0, "Coulomb torque", 0.0),
            Quantity("stribeck", 0.2, "-", 0.0, 2.0, "rise of the torque at low speed / Coulomb torque",
                     meaningful=(0.0, 1.9)),
            Quantity("stribeck_velocity", 0.1, "rad/s", 0.005, 5.0, "speed at which the rise has decayed",
                     fitted=False, meaningful=(0.005, 5.0)),
            Quantity("transition_velocity", 0.02, "rad/s", 0.001, 1.0, "width of the change of sign",
                     fitted=False,
                     meaningful=(0.001, 0.3)),  # wider, most of a slow step has viscous friction
            Quantity("bristles", 0.0, "-", 0.0, 1.0, "share of the torque that sticks at standstill",
                     fitted=False, meaningful=(0.0, 1.0)),
            Quantity("presliding", 5.0e-3, "rad", 2.0e-4, 0.1, "angle until what sticks slides", fitted=False,
                     meaningful=(2.0e-4, 0.05)),  # wider, it is an elasticity
        ),
        expression=_joint_friction,
        physics="Bearings, chain and orthosis shells rub with a torque that hardly depends on the speed, "
        "is a little larger at the start (Stribeck), and changes its sign with the direction. Surfaces "
        "that stick yield elastically over a small angle first (bristles, as in the LuGre and Dahl models).",
        source="assumption, 0.3 to 1 N m for an orthosis joint; Canudas de Wit et al. 1995 (bristles)",
        states=("friction_bristle",),
        scales=(1.0,),
        minimum_effect=0.05,
        confounded_with=("muscle_hysteresis",),
        separated_by=("diagnostic-decay", "diagnostic-cocontraction"),
    ),
    Effect(
        name="parallel_elasticity",
        of="rotation",
        stage="torque",
        parameters=(
            Quantity("stiffness", 2.0, "N m/rad", -50.0, 200.0, "stiffness of the spring", 0.0),
            Quantity("rest_angle", 0.6, "rad", -1.0, 2.0, "angle at which it is free of load",
                     fitted=False),
            Quantity("hardening", 0.0, "1/rad^2", 0.0, 20.0, "growth of the stiffness / square of the angle",
                     fitted=False, meaningful=(0.0, 19.0)),
            Quantity("one_sided", 0.0, "-", -1.0, 1.0,
                     "difference of the stiffnesses above and below the rest angle / their sum",
                     fitted=False, meaningful=(-1.0, 1.0)),
        ),
        expression=_parallel_elasticity,
        physics="Shells, straps, hoses and soft tissue pull the joint towards a middle angle. Soft tissue "
        "stiffens as it is stretched; a strap or a cuff pulls on one side only.",
        source="assumption; a human knee's passive stiffness in mid range is a few N m/rad",
        minimum_effect=0.1,
        starts=({"stiffness": -2.0},),
        coordinate="angle",
        middle="rest_angle",
        confounded_with=("force_map_misfit", "constant_torque"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="periodic_torque",
        of="rotation",
        stage="torque",
        parameters=(
            Quantity("amplitude", 1.0, "N m", 0.0, 50.0, "amplitude", 0.0),
            Quantity("frequency", 1.3, "Hz", 0.01, 20.0, "frequency"),
            Quantity("phase", 0.0, "rad", -7.0, 7.0, "phase at the time 0", meaningful=(-7.0, 7.0)),
        ),
        expression=lambda s, p, _states: Contribution(
            {"effort": p.amplitude * ca.sin(2 * ca.pi * p.frequency * s.time + p.phase)}
        ),
        physics="A disturbance of one frequency: clonus (5 to 8 Hz), a rocking bed, a helper's hand. The "
        "paper's fig. 8 shows the observer's answer to such a torque.",
        source="paper, fig. 8; magnitude: assumption",
        minimum_effect=0.03,
        starts=tuple({"frequency": f, "phase": phi} for f in (0.4, 0.8, 2.0, 5.0) for phi in (0.0, 1.57)),
        coordinate="time",
        periodic=("frequency", "phase"),
        confounded_with=("constant_torque",),
        separated_by=("diagnostic-hold",),
    ),
    Effect(
        name="stretch_reflex",
        of="rotation",
        stage="torque",
        parameters=(
            Quantity("gain", 0.5, "N m s/rad", 0.0, 50.0, "torque per velocity above the threshold", 0.0),
            Quantity("threshold", 1.0, "rad/s", 0.0, 8.0, "velocity of stretch at which the reflex sets in"),
            Quantity("lag", 0.04, "s", 0.005, 0.3, "time constant and dead time of the reflex arc",
                     meaningful=(0.02, 0.2)),  # no arc is faster; those over the cortex take 0.1 s
            Quantity("dead", 0.0, "-", 0.0, 1.0, "share of the torque that comes after the dead time alone",
                     fitted=False, meaningful=(0.0, 1.0)),
            Quantity("one_sided", 0.0, "-", -1.0, 1.0,
                     "difference of the gains of flexion and extension / their sum", fitted=False,
                     meaningful=(-1.0, 1.0)),
        ),
        expression=_stretch_reflex,
        physics="After a lesion of the spinal cord a muscle that is stretched faster than a threshold "
        "contracts by a reflex, some tens of milliseconds later, in one direction or both. Nerves conduct "
        "with a dead time, muscles build up their force with a lag.",
        source="spasticity as a velocity-dependent stretch reflex (Lance 1980); the first answer to a tap on "
        "the knee's tendon comes after 16 ms, in the electromyogram (Kim et al., J. Korean Acad. Rehabil. "
        "Med. 21(2), 1997), the force later; magnitude: assumption",
        minimum_effect=0.03,
        starts=({"threshold": 0.3}, {"threshold": 2.5}, {"lag": 0.1}),
        confounded_with=("viscous_friction",),
        separated_by=("diagnostic-triangle", "diagnostic-decay"),
        states=("reflex", "reflex_delay_a", "reflex_delay_b", "reflex_delay_c"),
        scales=(1.0, 0.02, 0.02, 0.02),
    ),
    Effect(
        name="viscous_friction",
        of="rotation",
        stage="torque",
        parameters=(Quantity("viscosity", 0.1, "N m s/rad", 0.0, 20.0, "torque per speed", 0.0),),
        expression=lambda s, p, _states: Contribution({"effort": -p.viscosity * s.velocity}),
        physics="Grease and soft tissue resist with a torque proportional to the speed.",
        source="assumption, 0.05 to 0.2 N m s/rad for an orthosis joint",
        minimum_effect=0.03,
        confounded_with=("pressure_dependent_damping",),
        separated_by=("diagnostic-decay",),
    ),
]  # fmt: skip
