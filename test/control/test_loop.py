# SPDX-License-Identifier: Apache-2.0
"""The whole cascade on the emulated hardware, without ROS."""

import numpy as np
import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model import parameters


def walk(scenario, seconds=8.0, seed=1, **overrides):
    p = parameters.load({**parameters.scenario_overrides(scenario), **overrides})
    return ClosedLoop(p, seed).run(round(seconds / p.scenario.control_period))


def errors(run):
    return np.rad2deg(run["reference_angle"] - run["angle"])


@pytest.mark.parametrize(
    ("scenario", "largest", "rms", "seed"),
    [("default", 1.0, 0.5, 1), ("default", 1.0, 0.5, 5), ("person", 1.5, 0.5, 2)],
)
def test_tracking(scenario, largest, rms, seed):
    run = walk(scenario, seed=seed)
    error = errors(run)
    rest = (run["time"] > 0.5) & (run["time"] < 1.0)
    assert np.abs(error).max() <= largest
    assert np.sqrt(np.mean(error**2)) <= rms
    assert np.abs(error[rest]).mean() <= 0.3
    assert not run["saturated"].any()


def test_the_tracking_test_can_fail():
    run = walk("default", 6.0, **{"control.position.c1": 3.0, "control.position.c2": 3.0})
    assert np.abs(errors(run)).max() > 3.0


def test_pressures_stay_within_the_limits():
    run = walk("default")
    p = parameters.load()
    for name in ("extensor_pressure", "flexor_pressure"):
        assert run[name].min() > p.valve.ambient_pressure
        assert run[name].max() < p.control.position.maximum_pressure


def test_the_loop_repeats_itself_bit_by_bit():
    runs = [walk("default", 1.5) for _ in range(2)]
    assert all(np.array_equal(runs[0][name], runs[1][name]) for name in runs[0])


def test_controllers_do_not_follow_the_plants_hidden_parameters():
    """A change of the truth must reach the controllers through measurements only: not at the first step."""
    runs = [walk("default", 0.1, **{"plant.effects.joint_friction.coulomb": c}) for c in (0.2, 3.0)]
    assert runs[0]["extensor_voltage"][0] == runs[1]["extensor_voltage"][0]
