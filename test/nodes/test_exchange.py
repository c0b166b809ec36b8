# SPDX-License-Identifier: Apache-2.0
"""Messages within a process: straight to who listens there, or to all through the middleware."""

import os
import signal
import time
from functools import partial

import numpy as np
import pytest
from live_runs import QUICK, wait_for

from pam_orthosis.bag.cdr import serialised_stamp_ns
from pam_orthosis.bag.read import read_bag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.nodes.exchange import AT_ONCE, Exchange, Outlet
from pam_orthosis.nodes.supervisor import supervise

FAILING = """
import sys
from pam_orthosis.nodes import composed, pressure_controller
node = pressure_controller.PressureControllerNode
step = node._step
def failing(self, stamp_ns, *inputs):
    if self.role.startswith("flexor") and stamp_ns == 500_000_000:
        raise ValueError("on purpose")
    step(self, stamp_ns, *inputs)
node._step = failing
sys.exit(composed.main())
"""
MEASURED = ("angle", "extensor_pressure", "flexor_pressure")


class Middleware:
    """A publisher and its handle, and how many subscriptions the middleware knows of."""

    topic_name = "/estimate"

    def __init__(self, subscriptions):
        self.handle = self
        self.subscriptions, self.published = subscriptions, []

    def get_subscription_count(self):
        """Return how many listen, in this process or elsewhere."""
        return self.subscriptions

    def publish(self, data):
        """Take a message."""
        self.published.append(data)


class Turns:
    """An executor: runs one task a turn."""

    def __init__(self):
        self.tasks = []

    def create_task(self, task):
        """Take a task."""
        self.tasks.append(task)

    def turn(self):
        """Run the next task; return whether there was one."""
        if not self.tasks:
            return False
        self.tasks.pop(0)()
        return True


@pytest.fixture
def connected():
    """Return an outlet with one listener in its process, its publisher, executor, what came, what failed."""
    publisher, turns, came, failed = Middleware(1), Turns(), [], []
    outlet = Outlet(publisher)
    Exchange(turns, failed.append).connect([outlet], [("/estimate", came.append), ("/other", came.append)])
    return outlet, publisher, turns, came, failed


def test_messages_go_straight_until_somebody_else_listens(connected):
    outlet, publisher, turns, came, _ = connected
    outlet.send(b"near")
    assert came == []  # not within the sender's callback
    publisher.subscriptions = 2
    outlet.send(b"near in the same turn")
    turns.turn()
    assert came == [b"near", b"near in the same turn"]
    outlet.send(b"all")
    outlet.send(b"all again")
    for publisher.subscriptions in (0, 1):
        outlet.send(b"some")
    assert publisher.published == [b"all", b"all again", b"some"]
    assert turns.turn()
    assert came[2:] == [b"some"]
    assert not turns.turn()


def test_without_a_listener_in_the_process_all_is_published():
    publisher, turns = Middleware(0), Turns()
    outlet = Outlet(publisher)
    Exchange(turns, pytest.fail).connect([outlet], [("/other", pytest.fail)])
    outlet.send(b"1")
    assert publisher.published == [b"1"]
    assert not turns.tasks


def test_a_loop_of_messages_leaves_others_their_turns():
    publisher, turns, came = Middleware(1), Turns(), []
    outlet = Outlet(publisher)

    def answer(data):
        came.append(data)
        outlet.send(data)

    Exchange(turns, pytest.fail).connect([outlet], [("/estimate", answer)])
    outlet.send(b"")
    for turn in range(1, 4):
        assert len(turns.tasks) == 1
        turns.turn()
        assert len(came) == turn * AT_ONCE


def test_what_a_listener_raises_is_told_and_what_waits_is_handed_on():
    publisher, turns, came, failed = Middleware(1), Turns(), [], []
    outlet, error = Outlet(publisher), ValueError("no number")

    def listener(data):
        came.append(data)
        if data == b"bad":
            raise error

    Exchange(turns, failed.append).connect([outlet], [("/estimate", listener)])
    for data in (b"good", b"bad", b"last words"):
        outlet.send(data)
    while turns.turn():
        pass
    assert failed == [error]
    assert came == [b"good", b"bad", b"last words"]
    outlet.send(b"more")
    assert turns.turn()
    assert came[-1] == b"more"


def _listened(executor, seconds):
    """Listen without a pause, or messages are lost."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        executor.spin_once(timeout_sec=0.05)
    return True


def _has_grown(file, size):
    return file.stat().st_size > size


def test_a_listener_elsewhere_gets_messages_once_in_order_and_changes_nothing(stranger, live_run):
    import rclpy
    from sensor_msgs.msg import JointState

    run = live_run("--open", "--composed", *QUICK)
    run.wait_until_it_records()
    executor = rclpy.executors.SingleThreadedExecutor(context=stranger.context)
    executor.add_node(stranger)
    heard = []
    subscription = stranger.create_subscription(
        JointState, "estimate", lambda data: heard.append(serialised_stamp_ns(data)), 5000, raw=True
    )
    wait_for(lambda: _listened(executor, 0.5) and len(heard) > 500)
    stranger.destroy_subscription(subscription)
    file = run.bag / f"{run.bag.name}_0.mcap"
    for _ in range(3):  # chunks that are recorded without the listener
        size = file.stat().st_size
        wait_for(partial(_has_grown, file, size))
    os.kill(run.process.pid, signal.SIGINT)
    run.ended()
    period_ns = round(load().scenario.control_period * 1e9)
    steps = np.diff(heard)
    assert np.all(steps >= period_ns)
    assert np.median(steps) == period_ns  # a listener without a processor loses what ten newer ones replace
    recorded = read_bag(run.bag, MEASURED)
    regular = np.diff(recorded["angle"].stamp_ns) == period_ns
    count = len(regular) if regular.all() else int(np.argmin(regular)) + 1
    assert count * period_ns > heard[-1]
    settings = dict(text.split("=") for text in QUICK if "=" in text)
    undisturbed = ClosedLoop(load({key: float(value) for key, value in settings.items()}), 1).run(count)
    assert all(np.array_equal(recorded[name].value[:count], undisturbed[name][:count]) for name in MEASURED)


def test_a_composed_node_that_breaks_is_named_and_the_leg_is_vented(tmp_path):
    pytest.importorskip("rclpy")
    from pam_orthosis.nodes.plant_simulator import VENT_SAMPLES

    parameters, bag = load({"scenario.duration": 2.0}), tmp_path / "walk"
    commands = launch.commands(tmp_path, parameters, bag, "default", launch.Mode(composed=True))
    python, _, _, _, *words = commands["composed"]
    commands["composed"] = [python, "-c", FAILING, *words]
    with launch.free_domain() as domain:
        environment = launch.environment(tmp_path, domain)
        with pytest.raises(RunFailed) as failure:
            supervise(commands, environment, tmp_path, lambda _: None)
    assert "in flexor_pressure_controller: ValueError: on purpose" in str(failure.value)
    recorded = read_bag(bag, ["angle", "truth_extensor_pressure", "truth_flexor_pressure"])
    assert len(recorded["angle"].value) == 101 + VENT_SAMPLES
    for name in ("truth_extensor_pressure", "truth_flexor_pressure"):
        assert recorded[name].value[-1] < 1.5 * parameters.valve.ambient_pressure
