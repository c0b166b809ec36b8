# SPDX-License-Identifier: Apache-2.0
"""Nodes of a run have the same parameters, or say which they have not; they are quiet while they wait."""

import os
import socket
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from live_runs import wait_for
from own_domain import own_domain

from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE, read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch

rclpy = pytest.importorskip("rclpy")
CYLINDER = Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "cylinder.yaml"


@pytest.fixture
def start(tmp_path, monkeypatch):
    """Return a function: settings of nodes -> a trajectory publisher, a position controller, their turn."""
    from pam_orthosis.nodes.position_controller import PositionControllerNode
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    nodes = []

    def start(*settings):
        words = [word for setting in settings for word in ("-p", setting)]
        rclpy.init(args=["--ros-args", *words], domain_id=own_domain())
        nodes.extend([TrajectoryPublisher(), PositionControllerNode()])
        executor = rclpy.executors.SingleThreadedExecutor()
        for node in nodes:
            executor.add_node(node)
        return *nodes, lambda: executor.spin_once(timeout_sec=0.05)

    yield start
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown()


@pytest.mark.parametrize(
    ("setting", "key", "one", "other"),
    [
        ("scenario.duration:=600.0", "scenario.duration", "600.0", "20.0"),
        ("realtime:=true", "realtime", "True", "False"),
        ("leg.shank.mass:=4.5", "leg.shank.mass", "4.5", str(load().leg.shank.mass)),
        (f"machine_file:={CYLINDER}", "machine_file", read_machine(CYLINDER).identity, "knee"),
    ],
)
def test_both_nodes_name_the_parameter_in_which_they_differ(start, setting, key, one, other):
    first, second, turn = start(f"trajectory_publisher:{setting}")
    wait_for(lambda: turn() or (first.failure and second.failure))
    here, there = (
        f"{key} is {one} in /trajectory_publisher",
        f"{key} is {other} in /position_controller",
    )
    assert str(first.failure()).startswith(f"{here} and {other} in /position_controller")
    assert str(second.failure()).startswith(f"{there} and {one} in /trajectory_publisher")
    assert not first.active
    assert not second.active


def test_nodes_that_agree_wait_for_the_others(start):
    first, second, turn = start()
    wait_for(lambda: turn() or second.role not in first.barrier._agreements[0].absent)
    wait_for(lambda: turn() or first.role not in second.barrier._agreements[0].absent)
    assert first.failure is None
    assert second.failure is None


def test_what_is_no_configuration_is_passed_over():
    from std_msgs.msg import String

    from pam_orthosis.nodes.agreement import Agreement

    agreement = Agreement("/a", "a", {"x": 1.0}, ["a", "b"])
    for text in ("", "b", "[]", "3", "null", '{"node": "/b"}', '{"node": "/b", "role": "b", "values": 1}'):
        agreement.add(String(data=text))
    assert agreement.absent == ["b"]
    agreement.add(Agreement("/b", "b", {"x": 1.0, "y": 2.0}, []).message)
    assert agreement.absent == []
    assert agreement.text == ""
    agreement.add(Agreement("/b", "b", {"x": 2.0}, []).message)
    assert agreement.text.startswith("x is 1.0 in /a and 2.0 in /b")


def test_a_node_that_waits_says_for_whom_once_and_then_every_half_minute(start, monkeypatch):
    from pam_orthosis.nodes import barrier

    node = start()[0]
    said, now = [], [barrier.time.monotonic()]
    node.barrier._notice = barrier.Notice(node, barrier.PEER_SECONDS)  # as if it had just been made
    monkeypatch.setattr(node, "get_logger", lambda: SimpleNamespace(info=said.append))
    monkeypatch.setattr(barrier.time, "monotonic", lambda: now[0])
    counts = []
    for _ in range(100):
        now[0] += 1.0
        node.barrier._look()
        counts.append(len(said))
    assert counts[3] == 0
    assert [counts[10], counts[30], counts[40], counts[70], counts[99]] == [1, 1, 2, 3, 4]
    assert all("waiting for" in line and "plant_simulator" in line for line in said)


def test_each_node_says_in_one_line_that_it_is_ready_and_the_process_how_the_run_ended(tmp_path):
    with launch.free_domain() as domain:
        parameters = load({"scenario.duration": 0.2})
        (command,) = launch.commands(
            tmp_path, parameters, tmp_path / "bag", "default", launch.Mode(composed=True)
        ).values()
        environment = launch.environment(tmp_path, domain)
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=60, check=True
        )
    *ready, end = [line.rpartition(" [")[2] for line in (done.stdout + done.stderr).splitlines()]
    lines = {f"{name}]: ready: ROS domain {domain}, 200 Hz in lockstep" for name in Topics(KNEE).nodes}
    assert (set(ready), len(ready)) == (lines, len(lines))
    assert end == "bag_recorder]: the run is over at 0.195 s"


def test_a_domain_of_somebody_without_multicast_is_not_taken(monkeypatch):
    with launch.free_domain() as free:
        pass
    monkeypatch.setattr(os, "getpid", lambda: free)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as somebody:
        somebody.bind(("127.0.0.1", launch.FIRST_PORT + launch.PORTS * free + 10))
        with launch.free_domain() as other:
            assert other != free
    with launch.free_domain() as again:
        assert again == free
