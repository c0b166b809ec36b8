# SPDX-License-Identifier: Apache-2.0
"""The real graph: it walks, records and judges; layouts agree to the bit; topics are the table's."""

import json
from xml.etree import ElementTree

import numpy as np
import pytest
from live_runs import QUICK, wait_for
from mcap.reader import make_reader
from own_domain import own_domain
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import RECORDER, SECOND_NS, Topics, resolve
from pam_orthosis.cli.main import main
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import launch
from pam_orthosis.scene.messages import LATCHED, PERIOD_NS, TYPES

TABLE = Topics(KNEE)

# signal of the bag -> signal of the closed loop without ROS
SAME = {
    "angle": "angle",
    "extensor_pressure": "extensor_pressure",
    "reference_angle": "reference_angle",
    "reference_acceleration": "reference_acceleration",
    "estimate_angle": "estimate_angle",
    "estimate_velocity": "estimate_velocity",
    "disturbance": "disturbance",
    "flexor_pressure_reference": "flexor_pressure_reference",
    "extensor_mass_flow": "extensor_mass_flow",
    "extensor_voltage": "extensor_voltage",
    "flexor_voltage": "flexor_voltage",
    "truth_angle": "true_angle",
    "truth_velocity": "true_velocity",
}


def _content(bag):
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages()
        ]


def _overrides():
    return {key: float(value) for key, value in (text.split("=") for text in QUICK[1::2])}


def test_nodes_in_processes_record_a_bag_that_passes(in_processes, capsys):
    done, bag = in_processes
    assert done.returncode == 0, done.stderr
    assert "PASSED" in done.stdout
    assert main(["check", str(bag), "--json"]) == 0
    verdict = json.loads(capsys.readouterr().out)
    assert verdict["passed"]
    assert verdict["samples"] == round(1.0 / load().scenario.control_period)


def test_the_bag_holds_every_topic_of_the_table_completely(in_processes):
    _, bag = in_processes
    steps = round(1.0 / load().scenario.control_period)
    with AnyReader([bag]) as reader:
        counts = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
    expected = {
        resolve(topic.name): (topic.type, steps if topic.rate == "step" else len(TABLE.nodes))
        for topic in TABLE.recorded
    }
    for topic, kind in TYPES.items():
        expected[resolve(topic)] = (kind, 1 if topic in LATCHED else SECOND_NS // PERIOD_NS)
    assert counts == expected


def test_the_bag_shows_the_leg_where_it_was_measured(in_processes):
    """A viewer puts the shank of the description where TF says; later ones get what was latched."""
    _, bag = in_processes
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([bag], default_typestore=store) as reader:
        named = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            named.setdefault(connection.topic, []).append(message)
        durable = {
            c.topic
            for c in reader.connections
            if c.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"
        }
    assert durable == set(map(resolve, LATCHED))
    angles = {(m.header.stamp.sec, m.header.stamp.nanosec): m.position[0] for m in named["/joint_states"]}
    for message in named["/tf"]:
        (shank,) = [one for one in message.transforms if one.child_frame_id == "shank"]
        turned = 2 * np.arctan2(shank.transform.rotation.y, shank.transform.rotation.w)
        stamp = shank.header.stamp
        assert turned == pytest.approx(angles[stamp.sec, stamp.nanosec], abs=1e-12)
    (description,) = named["/robot_description"]
    links = {link.get("name") for link in ElementTree.fromstring(description.data).iter("link")}
    assert {
        one.child_frame_id for topic in ("/tf", "/tf_static") for one in named[topic][0].transforms
    } < links


def test_composed_nodes_record_the_same_bytes(in_processes, run_graph):
    done, bag = run_graph("--duration", "1", "--composed")
    assert done.returncode == 0, done.stderr
    assert _content(bag) == _content(in_processes[1])


def test_the_graph_gives_the_numbers_of_the_closed_loop_without_ros(in_processes):
    _, bag = in_processes
    recorded = read_bag(bag, SAME)
    parameters = load(_overrides())
    steps = len(recorded["angle"].value)
    expected = ClosedLoop(parameters, parameters.scenario.seed).run(steps)
    for name, other in SAME.items():
        np.testing.assert_array_equal(recorded[name].value[:steps], expected[other], err_msg=name)


def test_another_seed_gives_another_bag(in_processes, run_graph):
    _, bag = run_graph("--duration", "1", "--composed", "--seed", "2")
    assert _content(bag) != _content(in_processes[1])


def test_a_bad_gain_fails_the_same_check(run_graph):
    weak = ["--param", "control.position.c1=1", "--param", "control.position.c2=1"]
    done, bag = run_graph("--duration", "2", *weak)
    assert done.returncode == 1, done.stderr
    assert "FAILED" in done.stdout
    assert main(["check", str(bag)]) == 1


def test_the_live_graph_is_the_table(live_run, monkeypatch):
    """Who is on every topic, as DDS sees it: truth goes to the recorder only."""
    rclpy = pytest.importorskip("rclpy")
    run = live_run()
    run.wait_until_it_records()
    environment = _environment(run.children()[RECORDER])
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        monkeypatch.setenv(name, environment[name])
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("observer_of_the_test", context=context)
    expected = {t.name: (sorted(t.producers), sorted(t.subscribers)) for t in TABLE.of_run().values()}
    try:
        wait_for(lambda: _all_discovered(_seen(node), expected))
        assert _seen(node) == expected
        assert _seen(node)["truth"][1] == [RECORDER]
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def _seen(node):
    """Return topic -> names of the publishing nodes and of the subscribed nodes."""
    return {
        topic.name: tuple(
            sorted(end.node_name for end in ends(resolve(topic.name)))
            for ends in (node.get_publishers_info_by_topic, node.get_subscriptions_info_by_topic)
        )
        for topic in TABLE.of_run().values()
    }


def _all_discovered(seen, expected):
    named = all("_NODE_NAME_UNKNOWN_" not in names for ends in seen.values() for names in ends)
    return named and all(
        len(there) >= len(due)
        for name, ends in expected.items()
        for there, due in zip(seen[name], ends, strict=True)
    )


def _environment(pid):
    with open(f"/proc/{pid}/environ", "rb") as stream:
        pairs = stream.read().decode(errors="replace").split("\0")
    return dict(pair.split("=", 1) for pair in pairs if "=" in pair)


def test_a_parameter_that_a_node_does_not_have_is_refused(tmp_path, monkeypatch):
    rclpy = pytest.importorskip("rclpy")
    from pam_orthosis.errors import OrthosisError
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    for key, match in (("plant.external_torque", "no parameter plant"), ("leg.lenght", "leg.lenght")):
        rclpy.init(args=["--ros-args", "-p", f"{key}:=1.0"], domain_id=own_domain())
        try:
            with pytest.raises(OrthosisError, match=match):
                TrajectoryPublisher()
        finally:
            rclpy.shutdown()


def test_settings_that_are_refused_together_change_nothing(tmp_path, monkeypatch):
    rclpy = pytest.importorskip("rclpy")
    from pam_orthosis.nodes.position_controller import PositionControllerNode

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    rclpy.init(args=[], domain_id=own_domain())
    try:
        node, key = PositionControllerNode(), "control.position.c1"
        before = node.parameters.control.position.c1
        both = [
            rclpy.parameter.Parameter(key, value=33.0),
            rclpy.parameter.Parameter("control.guard.hold_time", value=0.03),
        ]
        for order in (both, both[::-1]):
            assert not node.set_parameters_atomically(order).successful
            assert node.parameters.control.position.c1 == before == node.get_parameter(key).value
        assert node.set_parameters_atomically(both[:1]).successful
        assert node.parameters.control.position.c1 == 33.0
        node.destroy_node()
    finally:
        rclpy.shutdown()


def test_use_sim_time_moves_the_nodes_clock_and_not_what_it_waits_with(tmp_path, monkeypatch):
    rclpy = pytest.importorskip("rclpy")
    from rclpy.experimental import EventsExecutor
    from rosgraph_msgs.msg import Clock

    from pam_orthosis.nodes import messages
    from pam_orthosis.nodes.trajectory_publisher import TrajectoryPublisher

    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    rclpy.init(args=["--ros-args", "-p", "use_sim_time:=true"], domain_id=own_domain())
    try:
        node, executor, looks = TrajectoryPublisher(), EventsExecutor(), []
        clock = node.create_publisher(Clock, "/clock", 1)
        node.wall_timer(0.01, lambda: looks.append(node.now_ns()))
        executor.add_node(node)
        wait_for(lambda: executor.spin_once(timeout_sec=0.1) or len(looks) > 3)
        assert set(looks) == {0}  # no clock has come

        def told():
            clock.publish(Clock(clock=messages.time(7 * SECOND_NS)))
            executor.spin_once(timeout_sec=0.1)
            return node.now_ns() == 7 * SECOND_NS

        wait_for(told)
        executor.shutdown()
    finally:
        rclpy.shutdown()


def test_nothing_sends_the_discovery_of_a_run_elsewhere(tmp_path, monkeypatch):
    for name in launch.ELSEWHERE:
        monkeypatch.setenv(name, "1")
    private, visible = launch.environment(tmp_path, 5), launch.open_environment(tmp_path)
    assert not set(launch.ELSEWHERE) & private.keys()
    assert set(launch.ELSEWHERE) <= visible.keys()
