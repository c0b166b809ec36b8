# SPDX-License-Identifier: Apache-2.0
"""The states of nodes: they come up by themselves or by hand, stop, are unmade, and made anew."""

import os
import signal
import subprocess
import sys
from itertools import count

import pytest
from live_runs import LIMIT_S, wait_for

pytest.importorskip("rclpy")
from lifecycle_msgs.msg import Transition, TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from sensor_msgs.msg import JointState

from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE

NODES = Topics(KNEE).nodes
NODE = "position_controller"
TURNS = 20  # of the manager, a second or more, in which a graph does hundreds of steps


class Manager:
    """Somebody else, who changes the states of nodes in one process, and counts the valves' commands."""

    def __init__(self, node, folder, settings, nodes=NODES):
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)
        self._executor.add_node(node)
        self.commands = 0
        node.create_subscription(JointState, "/extensor/valve_command", self._count, 10)
        given = {"bag_recorder:directory": folder / "bag", "scenario.duration": 3600.0, **settings}
        words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
        command = [sys.executable, "-m", "pam_orthosis.nodes.entry", "composed", *nodes, "--ros-args", *words]
        environment = {**os.environ, "ROS_LOG_DIR": str(folder)}
        self.process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)

    def _count(self, _command):
        self.commands += 1

    def until(self, condition):
        wait_for(lambda: self._executor.spin_once(timeout_sec=0.05) or self.process.poll() or condition())
        assert not self.process.poll()

    def listeners(self):
        """Return how many nodes listen to the samples."""
        return self._node.count_subscribers("/joint_states")

    def pass_time(self):
        left = iter(range(TURNS))
        self.until(lambda: next(left, None) is None)

    def work(self):
        """Wait until commands come."""
        there = self.commands
        self.until(lambda: self.commands > there + 3)

    def _answer(self, client, request):
        """Return an answer; who asks one that does not know him yet, or is leaving, gets none: asks again."""
        futures, turns = [], count()

        def answered():
            if client.service_is_ready() and len(futures) < 1 + next(turns) // TURNS:
                futures.append(client.call_async(request))
            return any(future.done() for future in futures)

        self.until(answered)
        return next(future for future in futures if future.done()).result()

    def set(self, node, transition):
        client = self._node.create_client(ChangeState, f"/{node}/change_state")
        nothing = ChangeState.Request(transition=Transition(label="nothing"))
        assert not self._answer(client, nothing).success  # from now on an answer arrives
        number = getattr(Transition, f"TRANSITION_{transition.upper()}")
        future = client.call_async(ChangeState.Request(transition=Transition(id=number)))
        self.until(future.done)
        return future.result().success

    def state(self, node):
        client = self._node.create_client(GetState, f"/{node}/get_state")
        return self._answer(client, GetState.Request()).current_state.label

    def end(self):
        """End the process; return what it said."""
        self.process.send_signal(signal.SIGTERM)
        said = self.process.communicate(timeout=LIMIT_S)[1]
        assert self.process.returncode == 0, said
        assert "Traceback" not in said
        return said


@pytest.fixture
def manage(stranger, tmp_path):
    """Return a function that starts all nodes of the knee, with settings, in one process."""
    managers = []

    def start(nodes=NODES, **settings):
        managers.append(Manager(stranger, tmp_path, settings, nodes))
        return managers[-1]

    yield start
    for one in managers:
        one.process.kill()


def test_by_hand_nodes_are_configured_then_active_once_their_peers_are_there(manage):
    graph = manage(autostart="false")
    assert graph.state(NODE) == "unconfigured"
    assert not graph.set(NODE, "activate")  # there is no such transition
    assert graph.set(NODE, "configure")
    assert not graph.set(NODE, "activate")
    for node in set(NODES) - {NODE}:
        assert graph.set(node, "configure")
    for node in NODES:
        graph.until(lambda node=node: graph.set(node, "activate"))
    graph.work()
    said = graph.end()
    assert "position_controller waits for plant_simulator, trajectory_publisher" in said


@pytest.mark.parametrize("realtime", ["false", "true"])
def test_a_node_that_is_deactivated_does_nothing_and_then_goes_on(manage, realtime):
    graph = manage(realtime=realtime)
    graph.work()
    assert graph.set(NODE, "deactivate")
    graph.pass_time()
    before = graph.commands
    graph.pass_time()
    assert graph.commands == before
    assert graph.state(NODE) == "inactive"
    assert graph.set(NODE, "activate")
    graph.work()
    graph.end()


def test_after_a_cleanup_a_node_is_made_anew(manage, tmp_path):
    alone = manage(nodes=["bag_recorder"], autostart="false")
    (tmp_path / "bag").mkdir()
    in_the_way = tmp_path / "bag" / "metadata.yaml"
    in_the_way.touch()
    assert not alone.set("bag_recorder", "configure")
    alone.until(lambda: alone.listeners() == 0)
    in_the_way.unlink()
    for _ in range(2):
        alone.until(lambda: alone.state("bag_recorder") == "unconfigured")
        assert alone.set("bag_recorder", "configure")
        alone.until(lambda: alone.listeners() == 1)
        assert alone.set("bag_recorder", "cleanup")
        alone.until(lambda: alone.listeners() == 0)
        for file in (tmp_path / "bag").iterdir():
            file.unlink()
    alone.until(lambda: alone.state("bag_recorder") == "unconfigured")
    assert "bag holds a bag already" in alone.end()


def test_a_shutdown_ends_the_process(manage):
    graph = manage(autostart="false")
    assert graph.set(NODE, "unconfigured_shutdown")
    assert graph.process.wait(LIMIT_S) == 0


def test_an_event_of_a_transition_reaches_no_late_listener_and_has_no_time(stranger):
    """Why `ready`, `end` and `recorded` are topics of their own."""
    node = LifecycleNode("managed", context=stranger.context)
    executor = SingleThreadedExecutor(context=stranger.context)
    executor.add_node(stranger)
    events = []
    try:
        node.trigger_configure()
        stranger.create_subscription(TransitionEvent, "/managed/transition_event", events.append, 10)
        heard_by = node.count_subscribers
        wait_for(lambda: executor.spin_once(timeout_sec=0.05) or heard_by("/managed/transition_event"))
        node.trigger_activate()
        wait_for(lambda: executor.spin_once(timeout_sec=0.05) or len(events) > 1)
    finally:
        node.destroy_node()
    assert [(event.goal_state.label, event.timestamp) for event in events] == [
        ("activating", 0),
        ("active", 0),
    ]
