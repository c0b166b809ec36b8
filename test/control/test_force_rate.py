# SPDX-License-Identifier: Apache-2.0
"""The derivative of the investigated muscle's force in Eq. (10): neglected, differentiated or observed."""

import numpy as np
import pytest

from pam_orthosis.control import linearisation
from pam_orthosis.model.parameters import load
from pam_orthosis.report.paper import force_rate

NOMINAL = load().rig_nominal()
PERIOD, POLE = NOMINAL.rig.control_period, NOMINAL.rig.position.force_rate_pole
TIME = PERIOD * np.arange(2000)
RAD = 2 * np.pi * 0.4  # rad/s of the carriage


def moving_carriage():
    """Return position, force and its derivative of a carriage that swings, MAS-40 at 4 bar, Eq. (1)."""
    position = 0.06 + 0.02 * np.sin(RAD * TIME)
    held = linearisation.ca.DM(4e5)
    pull = np.array([float(linearisation.positioner_force(x, held, NOMINAL)) for x in position])
    force = pull - NOMINAL.rig.carriage_mass * 0.02 * RAD**2 * np.sin(RAD * TIME)
    return position, force, np.gradient(force, PERIOD)


@pytest.mark.parametrize(("choice", "poles"), [("differentiated", 1), ("observed", 4)])
def test_the_derivative_comes_as_late_as_its_poles_say(choice, poles):
    position, force, true = moving_carriage()
    estimator = linearisation.FORCE_RATES[choice](NOMINAL)
    found = np.array([estimator.step(x, 4e5, f) for x, f in zip(position, force, strict=True)])
    late = np.interp(TIME - poles / POLE, TIME, true)
    settled = TIME > 1.0
    assert np.abs(found - late)[settled].max() < 0.05 * np.abs(true).max()
    assert np.abs(found - true)[settled].max() > np.abs(found - late)[settled].max()


def test_the_disturbance_observer_needs_no_load_cell():
    position, force, _ = moving_carriage()
    blind, seeing = (linearisation.DisturbanceObserver(NOMINAL) for _ in range(2))
    for x, f in zip(position[:200], force[:200], strict=True):
        assert blind.step(x, 4e5, 0.0) == seeing.step(x, 4e5, f)


def test_the_law_adds_the_derivative_to_the_force_that_the_pressure_has_to_follow():
    """The third derivative of Eq. (10) is (dF_M,d/dt - dF_M,r/dt) / m: both signs and the mass."""
    pressure, mass = linearisation.ca.SX(4e5), NOMINAL.rig.carriage_mass
    still, moved = (
        linearisation.linearising_flow(jerk, 0.06, 0.02, pressure, NOMINAL, rate)
        for jerk, rate in ((5.0, 0.0), (5.0 + 300.0 / mass, 300.0))
    )
    assert float(linearisation.ca.evalf(still)) == pytest.approx(
        float(linearisation.ca.evalf(moved)), rel=1e-9
    )


def test_the_paper_s_choice_is_the_shipped_one():
    assert NOMINAL.rig.position.force_rate == "neglected"
    assert linearisation.CarriageController(NOMINAL).force_rate == 0.0


def test_a_lag_is_found():
    true = np.sin(3 * TIME) + 0.2 * np.sin(11 * TIME)
    late = np.interp(TIME - 0.036, TIME, true)
    assert force_rate.lag(true, late, PERIOD) == pytest.approx(0.036, abs=PERIOD)


@pytest.fixture(scope="module")
def compared():
    return {one.choice: one for one in force_rate.compared()}


def test_both_know_more_of_the_derivative_than_nothing(compared):
    for choice in ("differentiated", "observed"):
        assert compared[choice].rate_error < 0.8 * compared["neglected"].rate_error
        assert compared[choice].position_error < compared["neglected"].position_error < 1e-3
    assert compared["neglected"].lag is None
    assert compared["observed"].noise < 0.5 * compared["differentiated"].noise
    assert compared["observed"].lag > compared["differentiated"].lag
