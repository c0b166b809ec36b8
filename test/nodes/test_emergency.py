# SPDX-License-Identifier: Apache-2.0
"""An emergency stop outlives the node that was told of it; a reset at either end ends it."""

from itertools import permutations
from types import SimpleNamespace

import pytest
from live_runs import wait_for

pytest.importorskip("rclpy")
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from own_domain import own_domain
from rclpy.experimental import EventsExecutor

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.nodes import emergency, messages
from pam_orthosis.nodes.emergency import ENDS, EmergencyStop, StopState
from pam_orthosis.nodes.inverse_valve_model import InverseValveModelNode
from pam_orthosis.nodes.plant_simulator import VENT_SAMPLES, PlantSimulator

FOREVER_NS = 10**15  # of the run's time: any stop has lasted for long enough


@pytest.fixture
def until(tmp_path, monkeypatch):
    """Return what lets nodes hear each other until a condition holds; each has an executor of its own."""
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    rclpy.init(args=[], domain_id=own_domain())

    def spun(condition):
        def met():
            for executor in spun.running.values():
                executor.spin_once(timeout_sec=0.02)
            return condition()

        wait_for(met)

    spun.running = {}
    yield spun
    for node in list(spun.running):
        removed(spun, node)
    rclpy.shutdown()


def added(until, kind):
    node, executor = kind(), EventsExecutor()
    executor.add_node(node)
    until.running[node] = executor
    return node


def removed(until, node):
    until.running.pop(node).shutdown()
    node.destroy_node()


def test_a_stop_survives_whoever_is_started_again_and_is_reset_at_either_end(until):
    valve, plant = added(until, InverseValveModelNode), added(until, PlantSimulator)
    assert not plant._stop.step()
    valve._stop.stop()
    until(plant._stop.step)
    removed(until, valve)
    again = added(until, InverseValveModelNode)
    assert not again._stop.active
    until(lambda: again._stop.active)
    assert plant._stop.step()

    plant._stop.reset()
    assert not plant._stop.step()
    again.time_ns += FOREVER_NS
    until(lambda: not again._stop.step())
    left = iter(range(5))
    until(lambda: next(left, None) is None)
    assert not plant._stop.step()
    assert not again._stop.step()
    with pytest.raises(OrthosisError, match="no emergency stop"):
        plant._stop.reset()


def test_a_stop_lasts_for_so_long_at_least_that_the_position_controller_notices(until):
    valve = added(until, InverseValveModelNode)
    valve._stop.stop()
    valve._stop.reset()
    assert valve._stop.step()
    valve.time_ns += round(valve.parameters.control.guard.rest_time * 1e9) - 1
    assert valve._stop.step()
    valve.time_ns += 1
    assert not valve._stop.step()


def test_in_lockstep_by_hand_no_time_passes_for_who_leaves(until):
    """All wait for who comes again; under a supervisor the bag is to show how the valves vent."""
    plant, valve = added(until, PlantSimulator), added(until, InverseValveModelNode)
    samples, commands = [], []
    plant.publish_sample, plant._newest_ns = samples.append, 0
    valve._commands = {"extensor": lambda stamp_ns, spool: commands.append(spool)}
    valve._answered_ns = {"extensor": 0}
    assert not plant.abandon()
    assert not valve.abandon()
    assert (samples, commands) == ([], [])
    plant.supervised = valve.supervised = True
    plant.abandon()
    assert valve.abandon()
    assert (len(samples), commands) == (VENT_SAMPLES, [VENT])


@pytest.mark.parametrize(
    ("shortest_ns", "said"), [(0, "again; the"), (500_000_000, "again, 0.5 s after the stop at")]
)
def test_a_reset_says_how_long_the_stop_lasts_only_if_it_does(shortest_ns, said):
    node = SimpleNamespace(legs=[], offer=lambda *_: None)
    stop = EmergencyStop(node, shortest_ns)
    stop.active = True
    assert said in stop.reset()


def report(stamp_ns, ends_ns=None, level=DiagnosticStatus.OK):
    values = {} if ends_ns is None else {ENDS: ends_ns}
    return messages.diagnostics(stamp_ns, "somebody: emergency stop", level, "", values)


def stop_at(stamp_ns):
    return report(stamp_ns, level=DiagnosticStatus.ERROR)


def test_a_stop_is_over_when_a_later_release_says_so():
    state, heard = StopState(), []
    for one in (
        DiagnosticArray(),
        stop_at(2),
        stop_at(2),
        report(1),
        report(2),
        DiagnosticArray(),
        report(3),
    ):
        heard.append((state.hear(one), state.active))
    assert heard == [
        *[(False, False), (True, True), (False, True), (False, True), (False, True), (False, True)],
        (True, False),
    ]


def test_a_release_leaves_a_stop_that_its_sender_did_not_know_of():
    """A node joins late, or words cross on their way: what counts does not depend on the order."""
    crossing = stop_at(100), report(200, 100), stop_at(690), report(700, 100)
    for order in permutations(crossing):
        state = StopState()
        for one in order:
            state.hear(one)
        assert state.active
        assert state.hear(report(701, 690))
        assert not state.active


class Bus:
    """Nodes that hear at once what any of them says on the latched topic."""

    legs, time_ns = ("",), 0
    machine = SimpleNamespace(names=["extensor"])

    def __init__(self):
        self.heard, self.offer, self.full_role = [], lambda *_: None, lambda: "node"

    def publish_to(self, *_, **__):
        return SimpleNamespace(publish=lambda one: [hear(one) for hear in self.heard])

    def listen_to(self, _topic, hear, **_):
        self.heard.append(hear)


def test_a_stop_counts_and_ends_also_after_the_clock_was_set_back(monkeypatch):
    clock = SimpleNamespace(time_ns=lambda: clock.now)
    monkeypatch.setattr(emergency, "time", clock)
    bus, resets = Bus(), []
    one, other = EmergencyStop(bus), EmergencyStop(bus)
    emergency.hear_reset(bus, lambda: resets.append(clock.now))
    for clock.now in (1000, 500, 700, 600):
        one.stop()
        assert (one.active, other.active) == (True, True)
        other.reset()
        assert not other.step()
        assert not one.step()
    assert resets == [1000, 500, 700, 600]
