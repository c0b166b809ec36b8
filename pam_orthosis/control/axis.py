# SPDX-License-Identifier: Apache-2.0
"""The controllers' model of a machine, Eq. (28): one coordinate that two antagonistic actuators move.

Forces of the first actuator count by the lever arm of the second: with equal arms, as those of Eq. (27),
they are the forces themselves.
"""

from functools import cached_property
from typing import TypeAlias

import casadi as ca
import numpy as np

from pam_orthosis.control import effects
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.mechanisms.base import Mechanics, acceleration
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression

Pair: TypeAlias = tuple[Expression, Expression]  # a quantity of both actuators, in the machine's order


class Axis:
    """Mechanism and actuators of a machine by the nominal model only; the mechanism's stops are left out.

    Raises:
        OrthosisError: the machine has not two actuators that move its coordinate in opposite directions.
    """

    def __init__(self, nominal: Parameters):
        self.nominal = nominal
        machine = nominal.declared
        self.mechanism = machine.mechanism(nominal)
        if len(machine.actuators) != 2:
            raise OrthosisError(
                f"{machine.name}: the controllers move two actuators against each other,"
                f" not {len(machine.actuators)}"
            )
        self.actuators: tuple[Actuator, ...] = tuple(one.built(nominal) for one in machine.actuators)
        self._check_directions()

    @cached_property
    def affine(self) -> bool:
        """Whether all forces are affine in the pressure."""
        return all(one.affine for one in self.actuators)

    def kinematics(self, q: Expression, velocity: Expression) -> tuple[Pair, Pair]:
        """Return contractions, m, and contraction rates, m/s."""
        first, second = self.mechanism.contractions(q)
        return (first, second), (ca.jtimes(first, q, velocity), ca.jtimes(second, q, velocity))

    def lever(self, q: Expression) -> Pair:
        """Return by what a force of the first counts as one of the second, and the second's lever arm."""
        _, (first, second) = self.kinematics(q, 1)
        return -first / second, second

    def effort(self, q: Expression, velocity: Expression, pressures: Pair) -> Expression:
        """Return the actuators' torque or force, Eq. (27), from absolute pressures, Pa."""
        first, second = self.tensions(q, velocity, pressures)
        share, arm = self.lever(q)
        return arm * (second - share * first)

    def tensions(self, q: Expression, velocity: Expression, pressures: Pair) -> Pair:
        """Return the actuators' forces, N, from absolute pressures, Pa."""
        first, second = (
            one.tension(one.force(dl, pressure - self.nominal.valve.ambient_pressure), rate)
            for one, dl, rate, pressure in zip(
                self.actuators, *self.kinematics(q, velocity), pressures, strict=True
            )
        )
        return first, second

    def forces(self, q: Expression, velocity: Expression, about: Pair) -> tuple[Pair, Pair, Pair]:
        """Return area, m^2, counterforce and damping force, N, of both, those of the first by its lever.

        A force that is not affine in the gauge pressure is linearised about these pressures.
        """
        contractions, rates = self.kinematics(q, velocity)
        areas, counterforces = zip(*map(_linear, self.actuators, contractions, about), strict=True)
        dampings = [one.damping * rate for one, rate in zip(self.actuators, rates, strict=True)]
        share, _ = self.lever(q)
        area, counterforce, damping = (
            (share * first, second) for first, second in (areas, counterforces, dampings)
        )
        return area, counterforce, damping

    def outside(self, q: Expression, gauge: Pair) -> Expression:
        """Return 1 where a law of an actuator is not identified, else 0."""
        contractions, _ = self.kinematics(q, 0)
        first, second = (
            one.outside(dl, p) for one, dl, p in zip(self.actuators, contractions, gauge, strict=True)
        )
        return ca.logic_or(first, second)

    def terms(self, q: Expression, velocity: Expression) -> Mechanics:
        """Return the terms of Eq. (26) with the mass that nominal effects add."""
        return self.mechanism.terms(q, velocity, effects.extra_mass(self.nominal))

    def acceleration(
        self, q: Expression, velocity: Expression, disturbance: Expression, pressures: Pair
    ) -> Expression:
        """Return q-double-dot of Eq. (26) with the actuators' effort: the second row of Eq. (28)."""
        return acceleration(self.effort(q, velocity, pressures) - disturbance, self.terms(q, velocity))

    def _check_directions(self) -> None:
        machine, q = self.nominal.declared, ca.SX.sym("q")
        arms = ca.Function("arms", [q], list(self.kinematics(q, ca.SX(1))[1]))
        places = 33  # between the stops, at which the actuators have to pull against each other
        for place in np.linspace(*self.mechanism.limits, places).tolist():
            first, second = map(float, arms(place))
            if not first * second < 0:
                coordinate = machine.coordinate
                raise OrthosisError(
                    f"{machine.name}: {' and '.join(machine.names)} do not pull against each other at"
                    f" {coordinate.name} = {place:.3g} {coordinate.unit}, as the controllers need them to"
                )


def _linear(actuator: Actuator, contraction: Expression, about: Expression) -> Pair:
    """Return area and counterforce of the force area * gauge - counterforce, about a gauge pressure."""
    if actuator.affine:
        return actuator.affine(contraction)
    p = ca.SX.sym("p")
    force = actuator.force(contraction, p)
    area, force = ca.substitute([ca.gradient(force, p), force], [p], [ca.SX(about)])
    return area, area * about - force
