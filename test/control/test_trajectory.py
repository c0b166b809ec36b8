# SPDX-License-Identifier: Apache-2.0
"""Reference trajectories."""

import os
import subprocess
import sys

import numpy as np
import pytest

from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import parameters

MS = 1_000_000


STEPS = {"scenario.trajectory": "steps", "scenario.start_angle": 0.3, "scenario.step.rise": 1.0}


@pytest.mark.parametrize(
    "overrides", [{}, {"scenario.cycle_time": 1.25}, {"scenario.trajectory": "sine"}, STEPS]
)
def test_velocity_and_acceleration_are_the_derivatives(overrides):
    trajectory = make_trajectory(parameters.load(overrides))
    step = 10_000  # ns
    for t in np.linspace(0.9e9, 5e9, 300).astype(int).tolist():
        before, now, after = (trajectory.sample(t + d) for d in (-step, 0, step))
        assert now.velocity == pytest.approx((after.position - before.position) / 2e-5, abs=1e-5)
        assert now.acceleration == pytest.approx((after.velocity - before.velocity) / 2e-5, abs=1e-3)


def test_it_rests_then_repeats_every_cycle():
    p = parameters.load({"scenario.cycle_time": 1.6})
    trajectory = make_trajectory(p)
    assert trajectory.sample(0).velocity == 0
    assert trajectory.sample(0).position == pytest.approx(p.scenario.start_angle, abs=1e-6)
    for t in (4000 * MS, 4321 * MS, 5100 * MS):
        assert trajectory.sample(t) == pytest.approx(trajectory.sample(t + 1600 * MS), abs=1e-9)


def test_the_gait_is_that_of_a_healthy_knee():
    trajectory = make_trajectory(parameters.load())
    degrees = np.rad2deg([trajectory.sample(t * MS).position for t in range(4000, 6000, 4)])
    assert 60 < degrees.max() < 70
    assert -2 < degrees.min() < 6


def _changed_trajectory():
    """A gait that changes its cycle time, twice within one ramp, stops and goes on."""
    trajectory = make_trajectory(parameters.load())
    trajectory.set_cycle_time(5000 * MS, 1.2)
    trajectory.set_cycle_time(5700 * MS, 3.0)
    trajectory.stop(9000 * MS)
    trajectory.go_on(14000 * MS)
    return trajectory


def test_changes_of_the_cadence_keep_the_derivatives_consistent():
    trajectory = _changed_trajectory()
    step = 10_000  # ns
    for t in np.linspace(4.9e9, 17e9, 500).astype(int).tolist():
        before, now, after = (trajectory.sample(t + d) for d in (-step, 0, step))
        assert now.velocity == pytest.approx((after.position - before.position) / 2e-5, abs=1e-5)
        assert now.acceleration == pytest.approx((after.velocity - before.velocity) / 2e-5, abs=1e-3)


def test_a_change_begins_when_it_is_asked_for_and_ends_with_the_new_cycle_time():
    plain, changed = make_trajectory(parameters.load()), _changed_trajectory()
    for t in range(0, 5000 * MS, 50 * MS):
        assert changed.sample(t) == plain.sample(t)
    assert changed.sample(5500 * MS) != plain.sample(5500 * MS)
    rest = changed.sample(11000 * MS)
    assert rest.velocity == pytest.approx(0, abs=1e-12)
    assert rest == pytest.approx(changed.sample(14000 * MS), abs=1e-12)
    assert changed.sample(16000 * MS) == pytest.approx(changed.sample(19000 * MS), abs=1e-9)


def test_a_cycle_time_set_at_rest_is_that_of_the_next_start():
    trajectory = make_trajectory(parameters.load())
    trajectory.stop(4000 * MS)
    assert trajectory.stopped
    trajectory.set_cycle_time(7000 * MS, 1.0)
    assert trajectory.sample(9000 * MS) == pytest.approx(trajectory.sample(8000 * MS), abs=1e-12)
    trajectory.go_on(10000 * MS)
    assert trajectory.sample(12000 * MS) == pytest.approx(trajectory.sample(13000 * MS), abs=1e-9)


def test_steps_go_from_level_to_level_in_the_time_of_a_rise():
    trajectory = make_trajectory(parameters.load({**STEPS, "scenario.step.rise": 0.25}))
    angles = np.array([trajectory.sample(t * MS).position for t in range(8000, 12000, 10)])
    assert (angles.min(), angles.max()) == pytest.approx((0.3, 0.9))
    between = (angles > 0.3 + 1e-9) & (angles < 0.9 - 1e-9)
    assert between.sum() * 0.01 == pytest.approx(4 * 0.25, abs=0.05)  # two cycles
    with pytest.raises(OrthosisError, match="at most half"):
        parameters.load({**STEPS, "scenario.cycle_time": 0.5})


@pytest.mark.parametrize("name", ["gait-fast", "gait-slow", "gait-adult", "gait-children", "steps"])
def test_scenarios_start_where_their_motion_does(name):
    p = parameters.load(parameters.scenario_overrides(name))
    trajectory = make_trajectory(p)
    assert trajectory.sample(0).position == pytest.approx(p.scenario.start_angle, abs=1e-5)
    degrees = np.rad2deg([trajectory.sample(t * MS).position for t in range(4000, 9000, 20)])
    assert 50 < degrees.max() < 70
    assert -2 < degrees.min() < 20


REFERENCE = """
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model import parameters
trajectory = make_trajectory(parameters.load())
print(*(number.hex() for t in range(0, 6000, 5) for number in trajectory.sample(t * 1_000_000)[:3]))
"""


def test_the_reference_is_the_same_to_the_bit_with_the_kernels_of_another_processor():
    """numpy's OpenBLAS takes its scalar product by the processor; the variable names another processor."""
    told = [
        subprocess.run(
            [sys.executable, "-c", REFERENCE],
            env=os.environ | {"OPENBLAS_CORETYPE": kernel},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kernel in ("Prescott", "Haswell")
    ]
    assert told[0] == told[1] != ""
