# SPDX-License-Identifier: Apache-2.0
"""Position control of the rig's carriage by exact input-output linearisation, Eqs. (9)-(12).

The output y = x_S has to be differentiated three times until the mass flow u shows, Eq. (10):
relative degree 3. With the mass flow of Eq. (11) the third derivative is the new input v.

Eq. (12) prints x_S-double-dot as its feed-forward, and derivatives of too low an order at alpha_3 and
alpha_2. Relative degree 3 asks for the third derivative of the reference, alpha_3 on the error of
the acceleration, alpha_2 on that of the velocity, alpha_1 on that of the position and alpha_0 on the
integral, so that e = x_d - x obeys

    e'''' + alpha_3 e''' + alpha_2 e'' + alpha_1 e' + alpha_0 e = 0.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import signal

from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.components import muscle as muscle_model
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.components.actuator import volume_terms
from pam_orthosis.model.mechanisms.carriage import carriage_acceleration, positioner_contraction
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression


class CarriageReference(NamedTuple):
    """Desired position m and its first three derivatives, m/s, m/s^2, m/s^3."""

    position: float
    velocity: float
    acceleration: float
    jerk: float


class CarriageEstimate(NamedTuple):
    """Estimated position m, velocity m/s, acceleration m/s^2."""

    position: float
    velocity: float
    acceleration: float


def error_coefficients(poles: Sequence[float]) -> NDArray[np.float64]:
    """Return alpha_0 .. alpha_3 of Eq. (12) for four poles of the error, 1/s^(4-k)."""
    return np.array(np.poly(poles)[:0:-1])


def demanded_jerk(
    reference: Sequence[Expression],
    estimate: Sequence[Expression],
    integral: Expression,
    alpha: Sequence[float],
) -> Expression:
    """Return v of Eq. (12) with the derivative orders of relative degree 3, m/s^3.

    Reference and alpha have 4 entries, the estimate 3; the integral is that of the position error, m s.

    Eq. (12) prints lower orders at alpha_3 and alpha_2 and in the feed-forward, with which the error grows.
    """
    errors = [reference[i] - estimate[i] for i in range(3)]
    v = reference[3] + alpha[0] * integral
    for k, error in enumerate(errors, start=1):
        v += alpha[k] * error
    return v


def positioner_force(position: Expression, pressure: Expression, nominal: Parameters) -> Expression:
    """Return F_M,r of Eq. (8), N; not clamped at slack, so that its derivatives stay defined."""
    contraction = positioner_contraction(position, nominal.rig)
    gauge = pressure - nominal.valve.ambient_pressure
    return muscle_model.towing_force(contraction, gauge, nominal.muscle.mas_40)


def slack_pressure(position: Expression, nominal: Parameters) -> Expression:
    """Return the absolute pressure at which the MAS-40 begins to pull, Pa."""
    contraction, m = positioner_contraction(position, nominal.rig), nominal.muscle.mas_40
    gauge = muscle_model.counterforce(contraction, m) / muscle_model.area(contraction, m)
    return gauge + nominal.valve.ambient_pressure


def linearising_flow(
    jerk: Expression,
    position: Expression,
    velocity: Expression,
    pressure: Expression,
    nominal: Parameters,
    force_rate: Expression = 0.0,
) -> Expression:
    """Return the mass flow of Eq. (11) that makes the third derivative of x_S equal to `jerk`, kg/s.

    Eq. (9) is solved for the pressure's rate, Eq. (6) for the flow; the partial derivatives come by
    differentiation of the model. `force_rate` is dF_M,d/dt of Eq. (10), N/s, which the paper neglects.
    """
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    contraction = positioner_contraction(x, nominal.rig)
    force = positioner_force(x, p, nominal)
    by_pressure, by_position = ca.gradient(force, p), ca.gradient(force, x)
    rate = (force_rate - nominal.rig.carriage_mass * jerk - by_position * velocity) / by_pressure
    volume, volume_by_pressure, volume_by_contraction = volume_terms(
        lambda dl, gauge: muscle_model.volume(dl, gauge, nominal.muscle.mas_40),
        contraction,
        p - nominal.valve.ambient_pressure,
    )
    contraction_rate = ca.jtimes(contraction, x, velocity)
    flow = pneumatics.required_mass_flow(
        p, rate, contraction_rate, volume + nominal.valve.hose.volume,
        volume_by_pressure, volume_by_contraction, nominal.valve,
    )  # fmt: skip
    return ca.substitute(flow, ca.vertcat(x, p), ca.vertcat(position, pressure))


def control_function(nominal: Parameters) -> ca.Function:
    """Return (reference, estimate, integral, pressure, dF_M,d/dt) -> mass flow, Eqs. (11)-(12)."""
    reference, estimate = ca.SX.sym("reference", 4), ca.SX.sym("estimate", 3)
    integral, pressure, force_rate = (ca.SX.sym(name) for name in ("integral", "pressure", "force_rate"))
    alpha = error_coefficients([-nominal.rig.position.pole] * 4).tolist()
    jerk = demanded_jerk(ca.vertsplit(reference), ca.vertsplit(estimate), integral, alpha)
    flow = linearising_flow(jerk, estimate[0], estimate[1], pressure, nominal, force_rate)
    return ca.Function("carriage_control", [reference, estimate, integral, pressure, force_rate], [flow])


class _Observer:
    """A sampled observer of a position whose acceleration is known but for an error, which is held constant.

    The error's derivative is, where it has as many poles as that. `spread` are the poles' relative distances:
    scipy places only distinct ones on one output.
    """

    def __init__(self, nominal: Parameters, pole: float, spread: Sequence[float]):
        self._transition, self._input, self._gain = _observer_matrices(
            nominal.rig.control_period, pole, spread
        )
        self._state: NDArray[np.float64] | None = None

    def step(self, position: float, known: float) -> NDArray[np.float64]:
        """Return position, velocity and error, m and derivatives, at a measurement; the first is at rest."""
        if self._state is None:  # whatever the forces say is their model's error
            self._state, self._before = np.zeros(len(self._gain)), known
            self._state[[0, 2]] = position, -known
        predicted = self._transition @ self._state + self._input * (0.5 * (self._before + known))
        self._state = predicted + self._gain * (position - predicted[0])
        self._before = known
        return self._state


class CarriageObserver:
    """Observer of the carriage's velocity and acceleration from position, load cell and pressure.

    Eq. (1) with both forces gives the acceleration up to an error of the force model, which is
    estimated as a third state held constant: the paper measures the position only and does not say
    where the velocity comes from.
    """

    def __init__(self, nominal: Parameters):
        position, pressure, force = ca.SX.sym("x"), ca.SX.sym("p"), ca.SX.sym("force")
        known = carriage_acceleration(
            force, positioner_force(position, pressure, nominal), nominal.rig.carriage_mass
        )
        self._known = compiled(ca.Function("carriage_known", [position, pressure, force], [known]))
        self._observer = _Observer(nominal, nominal.rig.position.observer_pole, (0.9, 1.0, 1.1))

    def step(self, position: float, pressure: float, force: float) -> CarriageEstimate:
        """Return the estimate at the instant of this measurement (m, absolute Pa, N)."""
        known = float(self._known(position, pressure, force)[0][0])
        x, velocity, error = self._observer.step(position, known).tolist()
        return CarriageEstimate(x, velocity, known + error)


class Differentiated:
    """dF_M,d/dt from the load cell: the difference of two readings behind a low-pass filter."""

    def __init__(self, nominal: Parameters):
        self._period = nominal.rig.control_period
        self._share = 1 - math.exp(-nominal.rig.position.force_rate_pole * self._period)
        self._before, self._rate = math.nan, 0.0

    def step(self, position: float, pressure: float, force: float) -> float:
        """Return the derivative, N/s, after a sample (m, Pa, N)."""
        if not math.isnan(self._before):
            self._rate += self._share * ((force - self._before) / self._period - self._rate)
        self._before = force
        return self._rate


class DisturbanceObserver:
    """dF_M,d/dt without a load cell, the alternative that the paper names after Eq. (10).

    F_M,d is the disturbance of Eq. (7): it and its derivative are states beside position and velocity, the
    derivative held constant; F_M,r of Eq. (8) is known, the position is measured.
    """

    def __init__(self, nominal: Parameters):
        position, pressure = ca.SX.sym("x"), ca.SX.sym("p")
        self._mass = nominal.rig.carriage_mass
        known = carriage_acceleration(0, positioner_force(position, pressure, nominal), self._mass)
        self._known = compiled(ca.Function("carriage_pulled", [position, pressure], [known]))
        pole = nominal.rig.position.force_rate_pole
        self._observer = _Observer(nominal, pole, (0.85, 0.95, 1.05, 1.15))

    def step(self, position: float, pressure: float, force: float) -> float:
        """Return the derivative, N/s, after a sample (m, Pa, N)."""
        known = float(self._known(position, pressure)[0][0])
        return float(self._mass * self._observer.step(position, known)[3])


# None: nothing, as the paper has dF_M,d/dt in Eq. (10)
FORCE_RATES: dict[str, Callable[[Parameters], Differentiated | DisturbanceObserver] | None] = {
    "neglected": None,
    "differentiated": Differentiated,
    "observed": DisturbanceObserver,
}


def _observer_matrices(
    t: float, pole: float, spread: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return transition (n, n), input (n,) and gain (n,) of a sampled observer with n poles about -`pole`."""
    n = len(spread)
    transition = np.array(
        [[t ** (j - i) / math.factorial(j - i) if j >= i else 0.0 for j in range(n)] for i in range(n)]
    )
    poles = np.exp(-pole * t * np.array(spread))
    # the measurement of now corrects the prediction of now: the error's matrix is (1 - k c) A
    placed = signal.place_poles(transition.T, transition[:1].T, poles)
    return transition, np.array([t**2 / 2, t, *[0.0] * (n - 2)]), placed.gain_matrix[0]


class CarriageController:
    """Observer and linearising law with its integral; knows the nominal model only.

    `force_rate` is what it took for dF_M,d/dt at its last step, N/s.
    """

    def __init__(self, parameters: Parameters):
        nominal = parameters.rig_nominal()
        self._observer = CarriageObserver(nominal)
        self._control = compiled(control_function(nominal))
        choice = FORCE_RATES[nominal.rig.position.force_rate]
        self._force_rate = choice and choice(nominal)
        self._period = nominal.rig.control_period
        self._integral = 0.0
        self.force_rate = 0.0

    def step(
        self, position: float, pressure: float, force: float, reference: CarriageReference
    ) -> tuple[float, CarriageEstimate]:
        """Return the mass flow into the MAS-40, kg/s, and the estimate (m, absolute Pa, N)."""
        estimate = self._observer.step(position, pressure, force)
        integral = self._integral + (reference.position - position) * self._period
        # m s; a slack MAS-40 cannot push: beyond this the integral would only wind up
        integral_limit = 2.0e-3
        self._integral = min(max(integral, -integral_limit), integral_limit)
        if self._force_rate is not None:
            self.force_rate = self._force_rate.step(position, pressure, force)
        flow = float(self._control(reference, estimate, self._integral, pressure, self.force_rate)[0][0])
        return flow, estimate
