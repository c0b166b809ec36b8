# SPDX-License-Identifier: Apache-2.0
"""A slow position controller in the real graph: numbers of the loop, complete bags, replay to the bit."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from live_runs import QUICK
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from test_graph import SAME
from test_replay import _changed

from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.script import Script
from pam_orthosis.bag.simulated import record_run, recorded_signals
from pam_orthosis.bag.topics import Topics, resolve
from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.recordings.data import from_bag
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.report.run_data import read_run

TABLE = Topics(KNEE)

pytest.importorskip("rclpy")
# three periods of 2 ms: neither the second nor the run is a multiple of it
RATES = {"scenario.control_period": 0.002, "control.position.every": 3, "scenario.duration": 1.3}
EVERY, STEPS, SLOW_STEPS = 3, 650, 217
SLOW_TOPICS = {"reference", "estimate", "disturbance", "controller_state", "extensor/pressure_reference"}
SLOW_TOPICS |= {"flexor/pressure_reference", "/clock"}

FIRST = get_typestore(Stores.ROS2_JAZZY).types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)


def _options(rates):
    return [word for key, value in rates.items() for word in ("--param", f"{key}={value}")]


def _parameters():
    return load({key: float(value) for key, value in (text.split("=") for text in QUICK[1::2])} | RATES)


@pytest.fixture(scope="module")
def slow_position(run_graph):
    """A run in processes whose position controller takes each third step."""
    done, bag = run_graph(*_options(RATES))
    assert done.returncode == 0, done.stderr
    return bag


def _content(bag):
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]


def _counts(bag):
    with AnyReader([bag]) as reader:
        return {connection.topic: connection.msgcount for connection in reader.connections}


def test_the_slow_nodes_say_something_at_their_own_steps_and_nothing_is_missing(slow_position):
    assert {name for name, topic in TABLE.of_run().items() if topic.slow} == SLOW_TOPICS
    counts = _counts(slow_position)
    for topic in TABLE.recorded:
        expected = SLOW_STEPS if topic.name in SLOW_TOPICS else STEPS
        if topic.rate == "1 Hz":
            expected = 2 * len(TABLE.nodes)  # at 0 s, and at the first step of each node from 1 s on
        assert counts[resolve(topic.name)] == expected, topic.name
    stamps = read_bag(slow_position, ["estimate_angle"])["estimate_angle"].stamp_ns
    np.testing.assert_array_equal(stamps, np.arange(SLOW_STEPS) * EVERY * 2_000_000)


def test_each_node_reports_at_its_first_step_of_a_second_that_all_is_well(slow_position):
    store, reported = get_typestore(Stores.ROS2_JAZZY), {}
    with AnyReader([slow_position], default_typestore=store) as reader:
        there = [one for one in reader.connections if one.topic == "/diagnostics"]
        for connection, stamp_ns, data in reader.messages(there):
            (status,) = reader.deserialize(data, connection.msgtype).status
            assert status.message == "ok", status
            reported.setdefault(status.name, []).append(stamp_ns)
    slow = {"position_controller", "trajectory_publisher"}
    expected = {
        f"{name}: loop": [0, 1_002_000_000 if name in slow else 1_000_000_000] for name in TABLE.nodes
    }
    assert reported == expected


def test_the_graph_gives_the_numbers_of_the_loop(slow_position):
    recorded, parameters = read_bag(slow_position, SAME), _parameters()
    expected = ClosedLoop(parameters, parameters.scenario.seed).run(STEPS)
    for name, other in SAME.items():
        step = EVERY if TABLE.signals[name].topic in SLOW_TOPICS else 1
        np.testing.assert_array_equal(recorded[name].value, expected[other][::step], err_msg=name)


def test_one_process_records_the_same_bytes(slow_position, run_graph):
    done, bag = run_graph(*_options(RATES), "--composed")
    assert done.returncode == 0, done.stderr
    assert _content(bag) == _content(slow_position)


def test_every_period_is_what_it_was(in_processes, run_graph):
    done, bag = run_graph("--duration", "1", "--composed", "--param", "control.position.every=1")
    assert done.returncode == 0, done.stderr
    assert _content(bag) == _content(in_processes[1])


@pytest.mark.parametrize("node", [None, "position_controller", "flexor_pressure_controller"])
def test_nodes_answer_as_in_the_record(slow_position, node, capsys):
    assert main(["replay", str(slow_position), "--json", *(["--node", node] if node else [])]) == 0
    (topics,) = json.loads(capsys.readouterr().out)["legs"].values()
    for one in topics:
        expected = SLOW_STEPS if one["topic"] in SLOW_TOPICS else STEPS
        assert (one["compared"], one["equal"], one["alone"]) == (expected, expected, 0), one


def test_a_bag_is_not_replayed_at_other_rates(slow_position, capsys):
    assert main(["replay", str(slow_position), "--param", "control.position.every=1"]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert said == ["pam-orthosis: error: control.position.every: the bag holds inputs for 3 only; run the"
                    " scenario anew"]  # fmt: skip


def test_a_bag_that_begins_later_than_the_run_is_fed_with_what_was_held_then(slow_position, tmp_path):
    """As with a driver, which waits for no recorder: quick samples of the first slow step are not there."""

    def change(topic, message):
        first = topic != "/clock" and hasattr(message, "header") and message.header.stamp == FIRST
        return not (first and topic.lstrip("/") not in SLOW_TOPICS)

    bag = _changed(slow_position, tmp_path / "later", change)
    script = Script(bag, nodes=["extensor_pressure_controller", "trajectory_publisher"], held_ns=6_000_000)
    fed = {i.stamp_ns: ([name for name, _ in i.fed], i.due) for i in script.instants()}
    assert fed[0] == (["/clock", "estimate", "extensor/pressure_reference"], ["reference"])
    assert fed[2_000_000] == (["/clock", "extensor/pressure"], ["extensor/mass_flow"])
    assert fed[6_000_000][1] == ["reference", "extensor/mass_flow"]


def test_all_that_reads_bags_reads_this_one(slow_position, tmp_path):
    """The verdict is that of all samples up to the position controller's last."""
    verdict = judge(slow_position)
    assert STEPS - verdict.samples == STEPS // SLOW_STEPS - 1
    assert verdict.passed
    assert from_bag(slow_position, knee(load())).samples == STEPS
    curves = {curve.name: curve.samples for panel in read_run(slow_position).panels for curve in panel.curves}
    assert (curves["measured"], curves["reference"], curves["error"]) == (STEPS, SLOW_STEPS, SLOW_STEPS)
    record_run(_parameters(), "test", tmp_path / "walked")
    names = recorded_signals(KNEE)
    walked, recorded = (read_bag(bag, names) for bag in (tmp_path / "walked", slow_position))
    for name in names:
        np.testing.assert_array_equal(walked[name].stamp_ns, recorded[name].stamp_ns, err_msg=name)
        np.testing.assert_array_equal(walked[name].value, recorded[name].value, err_msg=name)


def test_two_legs_have_it_too(run_graph, slow_position):
    done, bag = run_graph(*_options(RATES), "--composed", "--legs", "2")
    assert done.returncode == 0, done.stderr
    assert namespaces(bag) == ["/left", "/right"]
    counts = _counts(bag)
    for leg in ("left", "right"):
        assert counts[f"/{leg}/estimate"] == SLOW_STEPS
        assert counts[f"/{leg}/flexor/mass_flow"] == STEPS
    names = ("estimate_angle", "flexor_voltage")
    left, alone = read_bag(bag, names, namespace="/left"), read_bag(slow_position, names)
    for name in names:
        np.testing.assert_array_equal(left[name].value, alone[name].value)


def test_by_the_wall_clock_it_keeps_its_instants_and_is_replayed(run_graph, capsys):
    rates = {"scenario.control_period": 0.02, "control.position.every": 2, "scenario.trajectory": "hold"}
    rates |= {"control.position.c1": 5, "control.position.c2": 5, "control.observer.pole": 15}
    rates |= {"control.pressure.gain": 8}
    done, bag = run_graph("--realtime", "--composed", "--duration", "2", *_options(rates))
    assert done.returncode in (0, 1), done.stderr  # tracking depends on the machine's load
    recorded = read_bag(bag, ["angle", "estimate_angle", "extensor_voltage"])
    slow = recorded["estimate_angle"].stamp_ns
    assert len(slow) > 10
    assert not np.any(np.diff(slow) % 40_000_000)
    for stamp in recorded["extensor_voltage"].stamp_ns[:-1]:  # the last may be those of the vent
        assert np.any((slow <= stamp) & (slow > stamp - 40_000_000))
    assert main(["replay", str(bag), "--json"]) == 0, capsys.readouterr()
    (topics,) = json.loads(capsys.readouterr().out)["legs"].values()
    assert all(one["compared"] > 10 for one in topics)


@pytest.mark.parametrize(
    ("value", "reason"),
    [("0", "outside 1 .. 10"), ("11", "outside 1 .. 10"), ("1.5", "whole number"), ("often", "number")],
)
def test_values_that_make_no_sense_are_refused_in_a_line(value, reason, tmp_path, capsys):
    assert main(["run", "--out", str(tmp_path / "no"), "--param", f"control.position.every={value}"]) == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert "control.position.every" in said
    assert reason in said


def test_a_position_controller_as_slow_as_no_control_period_may_be_is_refused(tmp_path, capsys):
    rates = ["--param", "control.position.every=6", "--param", "scenario.control_period=0.01"]
    assert main(["run", "--out", str(tmp_path / "no"), *rates]) == 2
    (said,) = capsys.readouterr().err.strip().splitlines()
    assert "control.position.every = 6 times scenario.control_period = 0.01 s must be at most 0.05 s" in said


class Ticked:
    """What a tick of the trajectory publisher needs of its node."""

    def __init__(self, every):
        self.every, self.control_ns, self.period_ns = every, 10, 10 * every
        self._next_ns, self._first_ns = None, 0
        self.published, self.done = [], []
        self._publish, self.step_done = self.published.append, self.done.append

    def is_lockstep(self):
        return True

    def tick(self, now_ns):
        """Hear of a sample."""
        from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

        TrajectoryPublisher._tick(self, now_ns)


def test_references_are_of_each_nth_instant_and_one_step_ahead():
    node = Ticked(3)
    for now in range(100, 200, 10):
        node.tick(now)
        assert node.published[-1] >= now
    assert node.published == [100, 130, 160, 190, 220]
    assert node.done == [100, 130, 160, 190]


def test_after_skipped_samples_the_references_keep_to_their_instants():
    node = Ticked(3)
    for now in (100, 250, 260, 400):
        node.tick(now)
    assert node.published == [100, 130, 250, 280, 400, 430]
    node = Ticked(3)
    for now in (100, 270):  # the step of 250 may still be waiting for its reference
        node.tick(now)
    assert node.published == [100, 130, 250, 280]


def test_without_a_slow_node_skipped_samples_get_no_reference():
    node = Ticked(1)
    for now in (100, 150, 160):
        node.tick(now)
    assert node.published == [100, 110, 150, 160, 170]


def test_a_slow_node_counts_its_own_periods():
    from pam_orthosis.nodes.graph import GraphNode

    node = SimpleNamespace(_origin_ns=0, time_ns=0, period_ns=6_000_000)
    assert [GraphNode.periods_since(node, stamp) for stamp in (6_000_000, 18_000_000)] == [1, 3]
