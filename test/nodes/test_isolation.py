# SPDX-License-Identifier: Apache-2.0
"""Runs and strangers on one host: nobody hears whom it should not, and nobody else moves a valve."""

import os
import signal

import numpy as np
import pytest
from live_runs import QUICK, LiveRun, wait_for

from pam_orthosis.bag.read import read_bag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.launch import free_domain

rclpy = pytest.importorskip("rclpy")
STEPS = 150
MEASURED = ("angle", "extensor_pressure", "flexor_pressure")


def _expected(seed):
    """Return the numbers of a run that nobody disturbed."""
    settings = dict(text.split("=") for text in QUICK if "=" in text)
    return ClosedLoop(load({key: float(value) for key, value in settings.items()}), seed).run(STEPS)


def _regular(stamp_ns):
    """Return how many of the first samples are a period apart: those of the vented leg are not."""
    early = np.diff(stamp_ns[: STEPS + 1]) == stamp_ns[1] - stamp_ns[0]
    assert early[:5].all()  # a busy machine is not far when the stranger is noticed
    return len(early) if early.all() else int(np.argmin(early)) + 1


def _kept(depth):
    """Return the quality of service that nodes in lockstep hear: messages are kept for who comes again."""
    from rclpy.qos import DurabilityPolicy, QoSProfile

    return QoSProfile(depth=depth, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def _fill_ahead(publisher):
    """Ask for an open valve at all steps of the near future."""
    from pam_orthosis.nodes import messages

    period_ns = round(load().scenario.control_period * 1e9)
    for step in range(20 * STEPS):
        publisher.publish(messages.joint_state(step * period_ns, ["extensor_valve"], position=[1.0]))


def test_a_stranger_on_a_command_topic_is_named_and_moves_no_valve(stranger, live_run):
    from sensor_msgs.msg import JointState

    from pam_orthosis.nodes.plant_simulator import VENT_SAMPLE_NS, VENT_SAMPLES

    run = live_run("--open", *QUICK)
    run.wait_until_it_records()
    publisher = stranger.create_publisher(JointState, "extensor/valve_command", _kept(20 * STEPS))
    wait_for(lambda: publisher.get_subscription_count() > 0)
    _fill_ahead(publisher)
    status, said = run.ended()
    assert status == 3
    assert "a stranger publishes on /extensor/valve_command" in said
    assert "/stranger" in said
    recorded, expected = read_bag(run.bag, MEASURED), _expected(1)
    count = _regular(recorded["angle"].stamp_ns)
    assert all(np.array_equal(recorded[name].value[:count], expected[name][:count]) for name in MEASURED)
    vented = recorded["extensor_pressure"]
    assert vented.value[-1] < 1.5 * load().valve.ambient_pressure
    assert (np.diff(vented.stamp_ns[-VENT_SAMPLES:]) == VENT_SAMPLE_NS).all()  # the flood drowned none


@pytest.fixture
def in_process(tmp_path, monkeypatch):
    """A node of the graph and one that publishes, in this process; what lets both have their turn."""
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    with free_domain() as domain:
        rclpy.init(args=[], domain_id=domain)
        node, other = TrajectoryPublisher(), rclpy.create_node("other")
        executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(node)
        yield node, other, lambda: executor.spin_once(timeout_sec=0.05)
        node.destroy_node()
        other.destroy_node()
        rclpy.shutdown()


def test_a_publisher_that_comes_again_is_no_stranger(in_process, monkeypatch):
    from rosgraph_msgs.msg import Clock

    from pam_orthosis.nodes import ownership

    node, other, turn = in_process
    for _ in range(3):
        publisher = other.create_publisher(Clock, "/clock", _kept(10))
        wait_for(lambda: turn() or node.count_publishers("/clock") == 1)
        other.destroy_publisher(publisher)
        wait_for(lambda: turn() or node.count_publishers("/clock") == 0)
    assert node.failure is None
    there = [other.create_publisher(Clock, "/clock", _kept(10)) for _ in range(2)]
    wait_for(lambda: turn() or node.failure)
    monkeypatch.setattr(ownership, "NAME_SECONDS", 0.0)
    monkeypatch.setattr(node.ownership, "_publishing", lambda name: [])
    assert str(node.failure()) == "a stranger publishes on /clock"
    assert len(there) == 2


def test_a_second_run_in_an_open_domain_is_refused_and_disturbs_nobody(stranger, live_run, tmp_path):
    first = live_run("--open", "--composed", *QUICK)
    first.wait_until_it_records()
    second = LiveRun(tmp_path / "second", "--open", "--composed", *QUICK)
    status, said = second.ended()
    assert status == 2
    assert "publishes on /" in said
    assert "set another ROS_DOMAIN_ID" in said
    assert not (tmp_path / "second").exists()
    assert first.process.poll() is None


def test_who_only_says_that_all_are_ready_starts_no_run(in_process):
    from std_msgs.msg import String

    from pam_orthosis.bag.topics import Topics
    from pam_orthosis.model.machines import KNEE
    from pam_orthosis.nodes.plant_simulator import PlantSimulator
    from pam_orthosis.nodes.transport import qos

    _, other, turn = in_process
    plant, executor = PlantSimulator(), rclpy.executors.SingleThreadedExecutor()
    executor.add_node(plant)
    publisher = other.create_publisher(String, "ready", qos(latched=True))
    for name in Topics(KNEE).nodes:
        publisher.publish(String(data=name))
    wait_for(lambda: turn() or plant.count_publishers("ready") == 3)  # of both nodes, and the stranger's
    for _ in range(50):
        executor.spin_once(timeout_sec=0.02)
    assert not plant._pace._begun
    plant.destroy_node()


def test_two_runs_at_once_do_not_hear_each_other(tmp_path):
    runs = [LiveRun(tmp_path / f"seed{seed}", "--composed", "--seed", f"{seed}", *QUICK) for seed in (1, 2)]
    for run in runs:
        run.wait_until_it_records()
    for run in runs:
        os.kill(run.process.pid, signal.SIGINT)
    for run, seed in zip(runs, (1, 2), strict=True):
        assert run.ended()[0] == 3
        angle = read_bag(run.bag, ["angle"])["angle"]
        count = _regular(angle.stamp_ns)
        assert np.array_equal(angle.value[:count], _expected(seed)["angle"][:count])
