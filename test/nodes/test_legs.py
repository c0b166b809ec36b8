# SPDX-License-Identifier: Apache-2.0
"""Two legs: the graph of one leg twice, half a cycle apart, in one bag."""

import json

import numpy as np
import pytest
from live_runs import QUICK
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import read_bag, run_record
from pam_orthosis.bag.topics import Topics, resolve
from pam_orthosis.cli.main import main
from pam_orthosis.control.legs import differences
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.nodes.supervisor import supervise

TABLE = Topics(KNEE)

PARTS = ("extensor_muscle", "flexor_muscle", "extensor_port", "flexor_port", "knee")
LATE = """
import sys
from pam_orthosis.nodes import barrier, composed
barrier.PEER_POLL_SECONDS = 3.0
sys.exit(composed.main())
"""


@pytest.fixture(scope="module")
def two_legs(run_graph):
    """One second of two legs, each leg in a process of its own."""
    return run_graph("--duration", "1", "--composed", "--legs", "2", "--json")


def _content(bag, prefix=""):
    """Return the messages under a prefix, without it; health is told by both legs' recorder."""
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [
            (channel.topic.removeprefix(prefix), message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
            if channel.topic.startswith(prefix)
        ]


def _overrides():
    return {key: float(value) for key, value in (text.split("=") for text in QUICK[1::2])}


def test_the_right_leg_is_half_a_cycle_ahead_and_begins_where_its_shape_does():
    parameters = load()
    right = parameters.changed(differences(parameters)["right"])
    later = make_trajectory(right).sample(0)
    hold, ramp, cycle = (getattr(parameters.scenario, n) for n in ("start_hold", "start_ramp", "cycle_time"))
    at = hold + ramp + 3 * cycle
    left, half = make_trajectory(parameters), round((at + cycle / 2) * 1e9)
    moved = make_trajectory(right).sample(round(at * 1e9))
    assert moved.position == pytest.approx(left.sample(half).position)
    assert later.position == right.scenario.start_angle
    assert right.scenario.seed != parameters.scenario.seed


def test_an_experiment_is_the_same_on_both_legs():
    parameters = load({"scenario.trajectory": "triangle"})
    assert set(differences(parameters)["right"]) == {"scenario.seed"}


def test_the_legs_are_the_same_nodes_in_two_namespaces_and_one_recorder(tmp_path):
    legs = {"left": {}, "right": {"scenario.seed": 9}}
    one = launch.commands(tmp_path, load(), tmp_path / "bag", "default", launch.Mode())
    two = launch.commands(tmp_path, load(), tmp_path / "bag", "default", launch.Mode(legs=legs))
    nodes = set(one) - {"bag_recorder"}
    assert set(two) == {"bag_recorder", *(f"{leg}/{node}" for leg in legs for node in nodes)}
    assert "/clock:=/right/clock" in two["right/plant_simulator"]
    assert not any("/clock" in word for word in two["left/plant_simulator"])


def test_both_legs_are_judged(two_legs, capsys):
    done, bag = two_legs
    assert done.returncode == 0, done.stderr
    assert namespaces(bag) == ["/left", "/right"]
    verdict = json.loads(done.stdout)
    assert verdict["passed"]
    assert {leg: one["samples"] for leg, one in verdict["legs"].items()} == {"left": 200, "right": 200}
    worst = max(one["max_abs_error_deg"] for one in verdict["legs"].values())
    best = min(one["max_abs_error_deg"] for one in verdict["legs"].values())
    assert main(["check", str(bag), "--bound-deg", str((worst + best) / 2)]) == 1
    said = capsys.readouterr().out
    assert said.count("PASSED") == said.count("FAILED") == 1
    assert said.index("left leg") < said.index("right leg")


def test_the_left_leg_is_that_of_a_run_with_one_leg_to_the_byte(two_legs, in_processes):
    measured = {resolve(topic.name) for topic in TABLE.recorded} - {"/diagnostics", "/clock"}
    left = [one for one in _content(two_legs[1], "/left") if one[0] in measured]
    alone = [one for one in _content(in_processes[1]) if one[0] in measured]
    assert _without_frames(left) == _without_frames(alone)
    assert {one[0] for one in alone} == measured


def _without_frames(messages):
    """Return topics, stamps and bytes of messages, whose frames have lost their names."""
    store, told = get_typestore(Stores.ROS2_JAZZY), []
    for topic, stamp_ns, data in messages:
        kind = TABLE.by_name[topic.removeprefix("/")].type
        message = store.deserialize_cdr(data, kind)
        message.header.frame_id = ""
        told.append((topic, stamp_ns, bytes(store.serialize_cdr(message, kind))))
    return told


def test_measurements_name_frames_that_there_are(two_legs):
    store, there, named = get_typestore(Stores.ROS2_JAZZY), set(), set()
    for _, _, data in _content(two_legs[1], "/tf"):
        there |= {
            one.child_frame_id for one in store.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms
        }
    for leg in ("left", "right"):
        for topic, _, data in _content(two_legs[1], f"/{leg}"):
            entry = TABLE.by_name.get(topic.removeprefix("/"))
            if entry and entry.type.endswith(("FluidPressure", "Vector3Stamped", "WrenchStamped")):
                named.add(store.deserialize_cdr(data, entry.type).header.frame_id)
    assert named == {f"{leg}/{part}" for leg in ("left", "right") for part in PARTS}
    assert named <= there


def test_both_legs_stand_in_one_tree_of_frames(two_legs):
    store, parents = get_typestore(Stores.ROS2_JAZZY), {}
    for topic, _, data in _content(two_legs[1], "/tf"):
        assert topic in ("", "_static")
        for one in store.deserialize_cdr(data, "tf2_msgs/msg/TFMessage").transforms:
            assert parents.setdefault(one.child_frame_id, one.header.frame_id) == one.header.frame_id
    roots = {parent for parent in parents.values() if parent not in parents}
    assert roots == {"world"}
    assert {"left/shank", "right/shank", "left/flexor_chain"} <= set(parents)


def test_the_right_leg_gives_the_numbers_of_its_own_closed_loop(two_legs):
    parameters = load(_overrides())
    right = parameters.changed(differences(parameters)["right"])
    expected = ClosedLoop(right, right.scenario.seed).run(200)
    recorded = read_bag(two_legs[1], ["angle", "flexor_voltage"], namespace="/right")
    np.testing.assert_array_equal(recorded["angle"].value, expected["angle"])
    np.testing.assert_array_equal(recorded["flexor_voltage"].value, expected["flexor_voltage"])


def test_the_bag_tells_how_the_legs_differ(two_legs):
    legs = json.loads(run_record(two_legs[1])["legs"])
    assert legs == differences(load(_overrides()))
    phases = [read_bag(two_legs[1], ["angle"], namespace=leg).parameters for leg in ("/left", "/right")]
    assert [one["scenario.start_phase"] for one in phases] == [0.0, 0.5]


def test_a_leg_that_is_up_waits_for_one_that_is_not(tmp_path):
    parameters = load(_overrides() | {"scenario.duration": 0.5})
    mode = launch.Mode(composed=True, legs=differences(parameters))
    commands = launch.commands(tmp_path, parameters, tmp_path / "walk", "default", mode)
    impatient = tmp_path / "left_plant_simulator.yaml"
    impatient.write_text(f"{impatient.read_text()}    answer_timeout: 1.0\n")
    python, _, _, _, *words = commands["right/composed"]
    commands["right/composed"] = [python, "-c", LATE, *words]
    with launch.free_domain() as domain:
        supervise(commands, launch.environment(tmp_path, domain), tmp_path, lambda _: None)
    legs = [read_bag(tmp_path / "walk", ["angle"], namespace=leg)["angle"] for leg in ("/left", "/right")]
    assert [leg.stamp_ns[-1] for leg in legs] == [495_000_000, 495_000_000]


def test_two_legs_by_the_wall_clock_are_both_timed(run_graph):
    options = ["--param", "scenario.control_period=0.04", "--param", "scenario.trajectory=hold"]
    options += ["--param", "control.position.c1=5", "--param", "control.position.c2=5"]
    options += ["--param", "control.observer.pole=15", "--param", "control.pressure.gain=8"]
    done, _ = run_graph("--duration", "1", "--composed", "--legs", "2", "--json", "--realtime", *options)
    assert done.returncode in (0, 1), done.stderr
    for verdict in json.loads(done.stdout)["legs"].values():
        assert verdict["timing"]["periods"] > 15
