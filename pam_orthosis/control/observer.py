# SPDX-License-Identifier: Apache-2.0
"""Nonlinear observer of position, velocity and disturbance of the coordinate, Eqs. (29)-(32)."""

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control import effects, live
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.reference import Pressures
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.effects.base import STAGES
from pam_orthosis.model.integrate import runge_kutta_4
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression

STEPS_PER_PERIOD = 2  # control period, whether a sample is taken in each or not
# with effects known, what the integration leaves over is no longer small against what they leave over
FINE_STEPS_PER_PERIOD = 8


class Estimate(NamedTuple):
    """Estimated position rad or m, its rate, disturbance N m or N, and the residual y - y-hat."""

    position: float
    velocity: float
    disturbance: float
    residual: float


def system(x: ca.SX, pressures: ca.SX, axis: Axis, known_effort: Expression = 0.0) -> ca.SX:
    """Return f of Eq. (31), which is Eq. (28) for the states of Eq. (29), x = [q, q-dot, tau], tau-dot = 0.

    A `known_effort` (N m or N, in the direction of the coordinate) is an input: tau is what it leaves over.
    """
    rate = axis.acceleration(x[0], x[1], x[2] - known_effort, (pressures[0], pressures[1]))
    return ca.vertcat(x[1], rate, 0)


def characteristic(pole: Expression, damping: Expression) -> tuple[Expression, Expression, Expression]:
    """Return c2, c1, c0 of the error's polynomial s^3 + c2 s^2 + c1 s + c0: a real pole and a pair.

    All lie at the distance `pole` from zero, 1/s. The pair's damping 1 gives three equal poles, 0.5 a
    Butterworth pattern: a slow disturbance is estimated (1 + 2 damping) / pole later.
    """
    spread = 1 + 2 * damping
    return spread * pole, spread * pole**2, pole**3


def gains(x: ca.SX, pressures: ca.SX, polynomial: Sequence[Expression], axis: Axis) -> ca.SX:
    """Return h of Eq. (31): the poles of A - h c, Eq. (32), are placed by Ackermann's formula.

    The measurement c x of Eq. (30) is the position. Eq. (31) prints y-hat-dot = c(x-hat) where y-hat is
    meant.

    Args:
        x: estimate (3,), the point of linearisation.
        pressures: absolute pressures of both actuators (2,), Pa.
        polynomial: c2, c1, c0 of the characteristic polynomial of A - h c.
    """
    point, held = ca.SX.sym("x", 3), ca.SX.sym("p", 2)
    jacobian = ca.jacobian(system(point, held, axis), point)
    a = ca.substitute([jacobian], [point, held], [x, pressures])[0]
    c = ca.SX([[1, 0, 0]])
    observability = ca.vertcat(c, c @ a, c @ a @ a)
    placed = a
    for coefficient in polynomial[:-1]:
        placed = (placed + coefficient * ca.SX.eye(3)) @ a
    placed += polynomial[-1] * ca.SX.eye(3)
    return placed @ ca.solve(observability, ca.SX([0, 0, 1]))


def observer_step(nominal: Parameters) -> ca.Function:
    """Return (x-hat, [y, pressures, known effort] before, the same now, tuned values) -> x-hat now.

    Between two samples the measured signals are taken as straight lines, so that the estimate of
    now contains the measurement of now.
    """
    one, steps = _fine_step(nominal)
    x, before, now = ca.MX.sym("x", 3), ca.MX.sym("before", 4), ca.MX.sym("now", 4)
    tuned = ca.MX.sym("tuned", len(live.of_observer(nominal.declared)))
    after = x
    for i in range(steps):
        middle = before + (now - before) * ((i + 0.5) / steps)
        after = one(after, middle, tuned)
    return ca.Function("observer_step", [x, before, now, tuned], [after])


def _fine_step(nominal: Parameters) -> tuple[ca.Function, int]:
    """Return (x-hat, [y, pressures, known effort], tuned values) -> x-hat later, and its steps a period.

    Functions that are called, not expressions that are written out for each step: their machine code is
    compiled in a fraction of the time.
    """
    nominal, tuned = nominal.symbolic(live.of_observer(nominal.declared))
    axis = Axis(nominal)
    steps = FINE_STEPS_PER_PERIOD if effects.known(nominal, *STAGES) else STEPS_PER_PERIOD
    steps *= nominal.control.position.every
    polynomial = characteristic(nominal.control.observer.pole, nominal.control.observer.damping)
    x, y = ca.SX.sym("x", 3), ca.SX.sym("y", 4)
    # linearising once a step is enough: the gains change slowly with the estimate
    gain = ca.Function("observer_gain", [x, y, tuned], [gains(x, y[1:3], polynomial, axis)])
    h = ca.SX.sym("h", 3)
    rate = ca.Function("observer_rate", [x, y, h, tuned],
                       [system(x, y[1:3], axis, y[3]) + h * (y[0] - x[0])])  # fmt: skip
    start, seen, given = (ca.MX.sym(str(symbol), symbol.shape[0]) for symbol in (x, y, tuned))
    placed, step = gain(start, seen, given), nominal.scenario.control_period / steps
    after = runge_kutta_4(lambda s: rate(s, seen, placed, given), start, step)
    return ca.Function("observer_fine_step", [start, seen, given], [after]), steps


class Observer:
    """The observer with its memory. Raises nothing; feed it finite measurements only."""

    def __init__(self, nominal: Parameters):
        self._step = compiled(observer_step(nominal))
        self._live = live.of_observer(nominal.declared)
        self._tuned = [nominal.at(key) for key in self._live]
        self._state: NDArray[np.float64] | None = None
        self._before = np.zeros(4)

    def retune(self, parameters: Parameters) -> None:
        """Take the values of `live.of_observer`; the estimate goes on from where it is."""
        self._tuned = [parameters.at(key) for key in self._live]

    def restart(self) -> None:
        """Begin anew at the next measurement."""
        self._state = None

    def step(
        self, position: float, pressures: Pressures, known_effort: float = 0.0, periods: int = 1
    ) -> Estimate:
        """Return the estimate at the instant of this measurement (rad or m, absolute Pa, N m or N).

        It is so many control periods later than the last one: samples between them were missed.
        """
        now = np.array([position, *pressures, known_effort])
        if self._state is None:
            self._state, self._before = np.array([position, 0.0, 0.0]), now
        for left in range(periods, 0, -1):
            then = now if left == 1 else self._before + (now - self._before) / left
            self._state[:] = self._step(self._state, self._before, then, self._tuned)[0]
            self._before = then
        q, velocity, disturbance = self._state.tolist()
        return Estimate(q, velocity, disturbance, position - q)
