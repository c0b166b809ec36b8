# SPDX-License-Identifier: Apache-2.0
"""A position controller slower than the pressure controllers, without ROS."""

import numpy as np
import pytest

from pam_orthosis.control.guard import position_guard
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.observer import Observer
from pam_orthosis.control.position import PositionController, position_nominal
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

FAST = {"scenario.control_period": 0.002}
HELD = ("estimate_angle", "disturbance", "extensor_pressure_reference", "flexor_pressure_reference")


def _run(seconds=6.0, **overrides):
    p = load({**FAST, **overrides})
    return ClosedLoop(p, 1).run(round(seconds / p.scenario.control_period))


def test_pressures_at_500_hz_and_position_at_100_hz_walk():
    """With the gains for 200 Hz; an observer that integrates 10 ms in two steps comes to 1.3 degrees."""
    run = _run(8.0, **{"control.position.every": 5})
    error = np.rad2deg(run["reference_angle"] - run["angle"])
    assert np.abs(error).max() <= 0.9
    assert np.sqrt(np.mean(error**2)) <= 0.3


def test_what_the_position_controller_says_is_held_and_the_rest_goes_on():
    run = _run(1.4, **{"control.position.every": 5})
    for name in HELD:
        groups = run[name].reshape(-1, 5)
        assert np.all(groups == groups[:, :1])
        assert len(np.unique(groups[:, 0])) > 100
    assert np.ptp(run["extensor_voltage"].reshape(-1, 5), axis=1).min() > 0.0


def test_the_position_controller_knows_its_own_period():
    p = load({**FAST, "control.position.every": 5})
    assert position_nominal(p).scenario.control_period == pytest.approx(0.010)
    assert p.scenario.control_period == 0.002
    assert position_nominal(load()).flat() == load().nominal().flat()


def test_its_observer_integrates_as_finely_as_one_that_works_each_period():
    """Straight lines between samples: to follow them in one slow step or in five is the same."""
    slow, fine = (load({**FAST, "control.position.every": every}) for every in (5, 1))
    coarse, whole = Observer(position_nominal(slow)), Observer(fine.nominal())
    for k in range(151):
        measured = 0.3 + 0.003 * k, (3e5 + 400 * k, 2e5)
        if k % 5 == 0:
            one = coarse.step(*measured)
        last = whole.step(*measured)
    assert one[:2] == pytest.approx(last[:2], rel=1e-4)


def test_its_guards_count_time_not_steps():
    p = load({**FAST, "control.position.every": 5})
    guarded = GuardedPosition(p, PositionController(p))
    slow = position_guard(position_nominal(p))
    assert guarded._guards["angle"]._hold == slow._hold == round(p.control.guard.hold_time / 0.010)
    assert slow._step == pytest.approx(5 * position_guard(p)._step)


def test_an_old_estimate_goes_on_at_its_velocity_and_an_old_reference_stays():
    p = load(FAST)
    old, new = PressureController(p, "flexor"), PressureController(p, "flexor")
    assert old.step(3e5, 3.2e5, 0.6, 1.5, 1, 0.008) == new.step(3e5, 3.2e5, 0.6 + 0.008 * 1.5, 1.5)
    assert old.step(3e5, 3.2e5, 0.6, 1.5, 1, 0.008) != new.step(3e5, 3.2e5, 0.6, 1.5)


def test_no_position_controller_is_slower_than_a_control_period_may_be_nor_than_the_run():
    with pytest.raises(OrthosisError, match=r"control.position.every = 5 .* at most 0.05"):
        load({"scenario.control_period": 0.02, "control.position.every": 5})
    rates = {"scenario.control_period": 0.01, "control.position.every": 4}
    load({**rates, "scenario.duration": 0.16})
    with pytest.raises(OrthosisError, match=r"scenario.duration = 0.15 .* control.position.every = 4"):
        load({**rates, "scenario.duration": 0.15})
