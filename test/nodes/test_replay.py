# SPDX-License-Identifier: Apache-2.0
"""A recorded bag is fed to real nodes again: the same answers to the bit, or which topic differs."""

import json

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.script import Script
from pam_orthosis.cli.main import main
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes import supervisor

pytest.importorskip("rclpy")
STEPS = 200
ANSWERED = 19  # topics on which nodes answer at each step, the plant's included
OF_POSITION = [
    "estimate", "disturbance", "controller_state",
    "extensor/pressure_reference", "flexor/pressure_reference",
]  # fmt: skip


def _replayed(capsys, *arguments):
    """Return exit status and the comparison by topic."""
    status = main(["replay", *map(str, arguments), "--json"])
    said = capsys.readouterr()
    assert said.out, said.err
    told = json.loads(said.out)
    return status, told, {one["topic"]: one for one in told["legs"][""]}


def _changed(bag, out, change):
    """Copy a bag; `change(topic, message)` alters messages or returns False to leave one out."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with AnyReader([bag], default_typestore=store) as reader, BagWriter(out) as writer:
        for connection in reader.connections:
            writer.add_topic(connection.topic, connection.msgtype)
        for connection, stamp_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if change(connection.topic, message) is not False:
                again = store.serialize_cdr(message, connection.msgtype)
                writer.write(connection.topic, stamp_ns, bytes(again))
    return out


def test_every_node_answers_as_in_the_record_to_the_bit(in_processes, capsys):
    status, told, topics = _replayed(capsys, in_processes[1])
    assert status == 0
    assert told["identical"]
    assert len(topics) == ANSWERED
    assert all(one["equal"] == one["compared"] == STEPS for one in topics.values())


def test_long_periods_are_replayed_too(run_graph, capsys):
    """The plant waits for the player, which stands in for the recorder."""
    slow = ["scenario.control_period=0.02", "scenario.trajectory=hold", "control.observer.pole=15"]
    slow += ["control.position.c1=5", "control.position.c2=5", "control.pressure.gain=8"]
    options = [word for one in slow for word in ("--param", one)]
    done, bag = run_graph("--duration", "1", "--composed", *options)
    assert done.returncode in (0, 1), done.stderr
    status, _, topics = _replayed(capsys, bag, "--node", "plant_simulator")
    assert status == 0
    assert topics["joint_states"]["equal"] == 50


def test_one_wrong_answer_in_the_record_is_named_with_its_size(in_processes, tmp_path, capsys):
    def change(topic, message):
        if topic == "/extensor/mass_flow" and message.header.stamp.nanosec == 500_000_000:
            message.vector.x += 1e-4

    bag = _changed(in_processes[1], tmp_path / "wrong", change)
    options = ["--node", "extensor_pressure_controller", "--out", tmp_path / "new"]
    status, _, topics = _replayed(capsys, bag, *options)
    assert status == 1
    (one,) = topics.values()
    assert (one["compared"], one["equal"]) == (STEPS, STEPS - 1)
    assert one["differences"] == {"extensor_mass_flow": pytest.approx(1e-4)}
    assert main(["replay", str(bag), "--out", str(tmp_path / "new")]) == 2


@pytest.mark.parametrize(
    ("field", "ulps", "same"), [("vector", 1, True), ("vector", 10**7, False), ("frame", 1, False)]
)
def test_what_another_processor_rounds_otherwise_is_the_same_and_said(
    in_processes, tmp_path, capsys, field, ulps, same
):
    def change(topic, message):
        if topic == "/extensor/mass_flow" and message.header.stamp.nanosec == 500_000_000:
            message.vector.x += ulps * np.spacing(message.vector.x)
            if field == "frame":
                message.header.frame_id += "x"

    bag = _changed(in_processes[1], tmp_path / "other", change)
    options = ["replay", str(bag), "--node", "extensor_pressure_controller"]
    assert main(options) == (0 if same else 1)
    said = capsys.readouterr().out.splitlines()[-1]
    if same:
        assert said.startswith("IDENTICAL but for rounding, by at most ")
        assert "in extensor/mass_flow" in said
    else:
        assert said == "DIFFERENT"
    _, told, topics = _replayed(capsys, *options[1:])
    assert (told["identical"], told["same"]) == (False, same)
    assert (topics["extensor/mass_flow"]["equal"], topics["extensor/mass_flow"]["rounded"]) == (
        STEPS - 1,
        same,
    )


def test_another_gain_shows_in_what_it_acts_on_and_nowhere_else(in_processes, capsys):
    options = ["--node", "position_controller", "--param", "control.position.c1=30"]
    status, _, topics = _replayed(capsys, in_processes[1], *options)
    assert status == 1
    assert list(topics) == OF_POSITION
    assert [name for name, one in topics.items() if one["identical"]] == ["estimate", "disturbance"]
    assert topics["extensor/pressure_reference"]["differences"]["extensor_pressure_reference"] > 1.0


def test_a_node_is_given_only_what_it_answered(in_processes, tmp_path):
    """As in real time, where a node that is behind skips samples."""

    def change(topic, message):
        late = message.header.stamp.nanosec == 500_000_000 if hasattr(message, "header") else False
        return not (late and topic.lstrip("/") in OF_POSITION)

    script = Script(_changed(in_processes[1], tmp_path / "gap", change), nodes=["position_controller"])
    fed = {instant.stamp_ns: [name for name, _ in instant.fed] for instant in script.instants()}
    assert fed[500_000_000] == []
    assert fed[505_000_000] == ["joint_states", "extensor/pressure", "flexor/pressure", "reference"]


def test_what_a_bag_has_not_is_said(in_processes, tmp_path, capsys):
    bag = _changed(in_processes[1], tmp_path / "less", lambda topic, _: "mass_flow" not in topic)
    assert main(["replay", str(bag), "--node", "inverse_valve_model"]) == 2
    assert "extensor/mass_flow is missing" in capsys.readouterr().err
    assert main(["replay", str(bag), "--node", "nobody"]) == 2
    assert "plant_simulator" in capsys.readouterr().err


def test_of_a_folder_without_a_bag_nothing_else_is_said(tmp_path, capsys):
    assert main(["replay", str(tmp_path)]) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert "holds no bag" in said


def test_a_topic_that_is_missing_stops_those_that_need_it_and_no_others(in_processes, tmp_path, capsys):
    bag = _changed(in_processes[1], tmp_path / "less", lambda topic, _: topic != "/extensor/pressure")
    _, _, topics = _replayed(capsys, bag)
    identical = {name for name, one in topics.items() if one["identical"]}
    assert "extensor/pressure" not in topics
    assert {one for one in identical if not one.startswith("truth")} == {
        "/clock", "joint_states", "flexor/pressure", "flexor/mass_flow"
    }  # fmt: skip


def test_what_could_mostly_not_be_compared_is_not_identical(in_processes, tmp_path, capsys):
    def change(topic, message):
        stamp = message.header.stamp if hasattr(message, "header") else None
        return topic != "/joint_states" or (stamp.sec == 0 and stamp.nanosec < 300_000_000)

    bag = _changed(in_processes[1], tmp_path / "short", change)
    assert main(["replay", str(bag), "--node", "position_controller"]) == 1
    said = capsys.readouterr().out.splitlines()[-1]
    assert said == f"INCOMPLETE: of estimate 60 of {STEPS} answers could be compared"


def test_samples_of_another_period_are_not_asked_of_a_bag(in_processes, capsys):
    for key, value in (("scenario.control_period", "0.002"), ("control.position.every", "2")):
        assert main(["replay", str(in_processes[1]), "--param", f"{key}={value}"]) == 2
        assert f"{key}: the bag holds inputs for" in capsys.readouterr().err


def test_answers_of_a_replay_that_is_cut_short_can_be_read(in_processes, tmp_path, capsys, monkeypatch):
    out = tmp_path / "answers"

    def killed(*_arguments):
        writer = BagWriter(out)
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        with AnyReader([in_processes[1]]) as reader:
            of_knee = [one for one in reader.connections if one.topic == "/joint_states"]
            for connection, stamp_ns, data in reader.messages(of_knee):
                writer.write(connection.topic, stamp_ns, bytes(data))
        writer.flush()
        del writer  # who is killed has no file open
        raise RunFailed("node bag_player was killed by SIGKILL")

    monkeypatch.setattr(supervisor, "supervise", killed)
    assert main(["replay", str(in_processes[1]), "--node", "plant_simulator", "--out", str(out)]) == 3
    assert f"was killed by SIGKILL; the bag {out} holds the run up to there" in capsys.readouterr().err
    assert len(read_bag(out, ["angle"])["angle"].value) == STEPS
