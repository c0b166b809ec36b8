# SPDX-License-Identifier: Apache-2.0
"""Start, stop, emergency stop and reset in a running graph, seen in its bag."""

import numpy as np
import pytest
from live_runs import common

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.parameters import load

pytest.importorskip("rclpy")
FOLLOWS_DEG = 3.0


def test_services_and_live_parameters_act_in_a_running_graph(caller, live_run):
    run = live_run("--open", "--composed", "--param", "scenario.start_hold=0.0")
    run.wait_until_it_records()
    ramp = load().scenario.start_ramp
    caller.let_pass(ramp)
    assert not caller.trigger("inverse_valve_model/reset").success
    assert caller.set("position_controller", "control.position.c1", 30.0).successful
    assert "read-only" in caller.set("position_controller", "control.guard.hold_time", 0.03).reason
    assert caller.trigger("trajectory_publisher/stop").success
    assert not caller.trigger("trajectory_publisher/stop").success
    caller.let_pass(ramp + 0.5)
    assert caller.trigger("inverse_valve_model/emergency_stop").success
    caller.let_pass(0.5)
    assert caller.trigger("inverse_valve_model/reset").success
    assert caller.trigger("trajectory_publisher/start").success
    caller.let_pass(10.0)
    run.process.terminate()
    run.ended()
    _assert_story(run.bag)


def _assert_story(bag):
    """The reference moves, rests, moves; the muscles are vented once, both, without a gap."""
    signals = ["reference_angle", "reference_velocity", "angle", "extensor_voltage", "flexor_voltage"]
    recorded = read_bag(bag, signals)
    speed = np.abs(recorded["reference_velocity"].value)
    resting = np.flatnonzero(speed < 1e-9)
    middle = resting[resting > np.flatnonzero(speed > 0.1)[0]]
    assert len(middle)
    assert speed[middle[-1] + 1 :].max() > 0.01
    vent = load().valve.minimum_voltage
    both = [np.flatnonzero(recorded[f"{m}_voltage"].value == vent) for m in ("extensor", "flexor")]
    vented = np.intersect1d(*both)
    longest = max(np.split(vented, np.flatnonzero(np.diff(vented) > 1) + 1), key=len)
    assert len(longest) > 50
    pressure = read_bag(bag, ["truth_extensor_pressure"])["truth_extensor_pressure"].value
    assert pressure[longest[-1]] < 1.3 * load().valve.ambient_pressure
    _assert_followed(recorded, recorded["extensor_voltage"].stamp_ns[longest[-1]])


def _assert_followed(recorded, vented_ns):
    """The knee is led back after the stop, and follows the motion until the run is cut short."""
    stamps, angles = common(recorded["reference_angle"], recorded["angle"])
    error = np.rad2deg(np.abs(angles[0] - angles[1]))
    last = stamps[-1] - 500_000_000  # then the run was cut short, and vented
    assert error[(stamps > vented_ns) & (stamps < last)].max() > FOLLOWS_DEG
    settled = (stamps > vented_ns + 7_000_000_000) & (stamps < last)
    assert settled.sum() > 200
    assert np.ptp(angles[0][settled]) > 0.5
    assert error[settled].max() < FOLLOWS_DEG
