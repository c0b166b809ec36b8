# SPDX-License-Identifier: Apache-2.0
"""Start, stop, emergency stop and reset in a running graph, seen in its bag."""

import os
from functools import reduce

import numpy as np
import pytest
from conftest import wait_for

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.parameters import load

rclpy = pytest.importorskip("rclpy")
FOLLOWS_DEG = 3.0


class Caller:
    """A ROS node of somebody else: calls services and sets parameters of a running graph."""

    def __init__(self, domain):
        from rclpy.experimental import EventsExecutor
        from rosgraph_msgs.msg import Clock

        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node = rclpy.create_node("caller", context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._time_s = 0.0
        self.node.create_subscription(Clock, "/clock", self._on_clock, 10)

    def let_pass(self, seconds):
        """Wait until so much simulated time has passed."""
        begun = self._time_s
        wait_for(lambda: self._executor.spin_once(timeout_sec=0.1) or self._time_s > begun + seconds)

    def _on_clock(self, message):
        self._time_s = message.clock.sec + 1e-9 * message.clock.nanosec

    def call(self, name, kind, request):
        """Call a service; return its response."""
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout_sec=30)
        future = client.call_async(request)
        self._executor.spin_until_future_complete(future, timeout_sec=30)
        assert future.done()
        return future.result()

    def trigger(self, name):
        from std_srvs.srv import Trigger

        return self.call(name, Trigger, Trigger.Request())

    def set(self, node, key, value):
        """Set a parameter of a node; return the result."""
        from rcl_interfaces.srv import SetParameters

        parameter = rclpy.parameter.Parameter(key, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        return self.call(f"{node}/set_parameters", SetParameters, request).results[0]

    def close(self):
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)


@pytest.fixture
def caller(monkeypatch):
    from pam_orthosis.model.parameters import config_folder

    domain = 60 + os.getpid() % 40
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "loopback.xml"))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
    caller = Caller(domain)
    yield caller
    caller.close()


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


def common(*series):
    """Return the stamps that all series have, and their values there."""
    stamps = reduce(np.intersect1d, [each.stamp_ns for each in series])
    return stamps, [each.value[np.searchsorted(each.stamp_ns, stamps)] for each in series]
