# SPDX-License-Identifier: Apache-2.0
"""The controllers' model of the knee, Eq. (28): from belief only, muscles as polynomials."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from pam_orthosis.control import effects
from pam_orthosis.model import leg as leg_model
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model.orthosis import acceleration


@dataclass(frozen=True)
class Pair:
    """A quantity of the extensor and of the flexor."""

    extensor: object
    flexor: object


def kinematics(q, velocity, belief) -> tuple[Pair, Pair]:
    """Return contractions, m, and contraction rates, m/s."""
    extensor, flexor = leg_model.contractions(q, belief.leg)
    rates = Pair(ca.jtimes(extensor, q, velocity), ca.jtimes(flexor, q, velocity))
    return Pair(extensor, flexor), rates


def muscle_torque(q, velocity, extensor_pressure, flexor_pressure, belief):
    """Return M_k of Eq. (27) in the direction of flexion, N m, from absolute pressures, Pa."""
    m, ambient = belief.muscle.dmsp_20, belief.valve.ambient_pressure
    contraction, rate = kinematics(q, velocity, belief)
    extensor = muscle_model.force(contraction.extensor, rate.extensor, extensor_pressure - ambient, m)
    flexor = muscle_model.force(contraction.flexor, rate.flexor, flexor_pressure - ambient, m)
    return leg_model.knee_torque(extensor, flexor, belief.leg)


def leg_mechanics(q, velocity, belief):
    """Return the terms of Eq. (26) with the mass that believed effects add."""
    return leg_model.mechanics(q, velocity, belief.leg, effects.extra_foot_mass(belief))


def knee_acceleration(q, velocity, disturbance, extensor_pressure, flexor_pressure, belief):
    """Return q-double-dot of Eq. (26) with the muscles' torque, rad/s^2: the second row of Eq. (28)."""
    torque = muscle_torque(q, velocity, extensor_pressure, flexor_pressure, belief)
    terms = leg_mechanics(q, velocity, belief)
    return acceleration(torque - disturbance, terms)
