# SPDX-License-Identifier: Apache-2.0
"""Exact linearisation of the rig: Eqs. (9)-(12), its error dynamics and what it reaches."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.control import linearisation, rig_loop
from pam_orthosis.model import parameters
from pam_orthosis.model.components import muscle, pneumatics

NOMINAL = parameters.load().rig_nominal()


def slope(function, x, step):
    """Return a central difference."""
    return (function(x + step) - function(x - step)) / (2 * step)


@pytest.mark.parametrize("seed", range(20))
def test_equation_11_as_printed_gives_the_same_flow(seed):
    """Eq. (11) as printed, with numeric partial derivatives of the force of Eq. (8), as in Eq. (9)."""
    random = np.random.default_rng(seed)
    position, velocity = random.uniform(0.01, 0.12), random.uniform(-0.1, 0.1)
    pressure, v = random.uniform(3e5, 6e5), random.uniform(-30, 30)
    m, valve, mass = NOMINAL.muscle.mas_40, NOMINAL.valve, NOMINAL.rig.carriage_mass
    dl, gauge = NOMINAL.rig.position_offset - position, pressure - valve.ambient_pressure
    n, heat = valve.polytropic_exponent, pneumatics.GAS_CONSTANT * valve.temperature
    force_dl = slope(lambda x: float(muscle.towing_force(x, gauge, m)), dl, 1e-5)
    force_p = slope(lambda p: float(muscle.towing_force(dl, p, m)), gauge, 10.0)
    volume = float(muscle.volume(dl, gauge, m)) + valve.hose.volume
    volume_dl = slope(lambda x: float(muscle.volume(x, gauge, m)), dl, 1e-5)
    volume_p = slope(lambda p: float(muscle.volume(dl, p, m)), gauge, 10.0)
    dl_rate = -velocity
    printed = (-v * mass - force_dl * dl_rate) * (volume + n * pressure * volume_p) / (n * heat * force_p)
    printed += n * pressure * volume_dl * -1 * velocity / (n * heat)
    flow = linearisation.linearising_flow(v, position, velocity, ca.SX(pressure), NOMINAL)
    assert float(ca.evalf(flow)) == pytest.approx(printed, rel=1e-5, abs=1e-9)


def test_the_flow_makes_the_third_derivative_what_is_demanded():
    """Relative degree 3, Eq. (10): simulate gas and force, differentiate the acceleration."""
    position, velocity, pressure, wanted, held = 0.06, 0.05, 4e5, 12.0, 900.0
    flow = linearisation.linearising_flow(wanted, position, velocity, ca.SX(pressure), NOMINAL)
    m, valve, n = NOMINAL.muscle.mas_40, NOMINAL.valve, NOMINAL.valve.polytropic_exponent

    def volume(x, p):
        dl = NOMINAL.rig.position_offset - x
        return float(muscle.volume(dl, p - valve.ambient_pressure, m)) + valve.hose.volume

    def acceleration(x, p):
        return float(
            (held - linearisation.positioner_force(x, ca.DM(p), NOMINAL)) / NOMINAL.rig.carriage_mass
        )

    step = 1e-6
    moved = position + velocity * step
    supplied = pneumatics.GAS_CONSTANT * valve.temperature * float(ca.evalf(flow)) * step

    def balance(p):
        return (
            (p - pressure) / n * volume(position, pressure)
            + pressure * (volume(moved, p) - volume(position, pressure))
            - supplied
        )

    low, high = 0.9 * pressure, 1.1 * pressure
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if balance(middle) < 0 else (low, middle)
    jerk = (acceleration(moved, middle) - acceleration(position, pressure)) / step
    assert jerk == pytest.approx(wanted, rel=1e-3)


def test_error_poles_are_as_placed_and_the_printed_orders_are_not_stable():
    """Eq. (12) as it is meant and as it is printed."""
    pole = NOMINAL.rig.position.pole
    alpha = linearisation.error_coefficients([-pole] * 4)
    error = ca.SX.sym("e", 4)  # e and its derivatives
    zero = np.zeros(3)
    v = linearisation.demanded_jerk([*ca.vertsplit(error[1:]), 0.0], zero, error[0], alpha)
    roots = np.roots(np.concatenate([[1.0], np.array(ca.evalf(ca.jacobian(v, error))).ravel()[::-1]]))
    assert np.abs(roots + pole).max() < 0.01 * pole
    # Eq. (12) as printed: alpha3 on the velocity error, alpha2 and alpha1 on the position error
    printed = np.roots([1.0, 0.0, alpha[3], alpha[2] + alpha[1], alpha[0]])
    assert printed.real.max() > 0


def ramp_and_hold(specimen, pressure, overrides=None):
    """Return the true position error, m, of a release, a pull to zero contraction and the way back."""
    rig = rig_loop.Rig(parameters.load(overrides), specimen, seed=1)
    for _ in rig.set_pressure(pressure):
        pass
    samples = list(rig.release(pressure))
    free = rig.reference_position
    samples += [*rig.ramp_to(pressure, 0.0), *rig.ramp_to(pressure, free)]
    return np.array([s.reference.position - s.truth.position for s in samples]), free


@pytest.mark.parametrize("force", [0.95, 1.05])
def test_the_carriage_follows_within_a_millimetre_with_the_mas_40_five_per_cent_off(force):
    error, free = ramp_and_hold("dmsp_20", 7e5, {"plant.rig.mas_40.force": force})
    assert free > 0.12, "the ramp must cover the contraction range"
    assert np.abs(error).max() <= 1e-3


def test_the_bound_fails_for_slow_poles():
    error, _ = ramp_and_hold("dmsp_20", 7e5, {"rig.position.pole": 12.0})
    assert np.abs(error).max() > 1e-3


def test_a_small_muscle_with_a_short_stroke_is_released_without_going_slack():
    error, free = ramp_and_hold("dmsp_10", 2e5)
    assert 1e-3 < free < 0.01
    assert np.abs(error).max() <= 1e-3


def test_the_controller_needs_no_plant():
    controller = linearisation.CarriageController(NOMINAL)
    reference = linearisation.CarriageReference(0.05, 0.0, 0.0, 0.0)
    flow, estimate = controller.step(0.05, 4e5, 900.0, reference)
    assert np.isfinite(flow)
    assert estimate.velocity == 0.0
    with pytest.raises(AttributeError):
        _ = NOMINAL.plant
