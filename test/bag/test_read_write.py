# SPDX-License-Identifier: Apache-2.0
"""Bags go through our writer, and through rosbags and mcap as independent readers; and back."""

import json

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer

from bags import PERIOD_NS, STORE, joint_state, reference, write, write_tracking_bag
from pam_orthosis.bag import record
from pam_orthosis.bag.read import Series, aligned, read_bag, run_record
from pam_orthosis.bag.record import RIG_EFFECTS, BagWriter, run_metadata
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

STAMPS = np.arange(400, dtype=np.int64) * PERIOD_NS
ANGLE = np.linspace(0.0, 1.0, 400)
NEEDED = ("angle", "reference_angle")


@pytest.fixture
def bag(tmp_path):
    return write_tracking_bag(tmp_path / "walk", STAMPS, ANGLE + 0.01, ANGLE, {"scenario.seed": 7})


def test_values_and_stamps_come_back_exactly(bag):
    read = read_bag(bag, NEEDED)
    np.testing.assert_array_equal(read["angle"].stamp_ns, STAMPS)
    np.testing.assert_array_equal(read["angle"].value, ANGLE)
    np.testing.assert_array_equal(read["reference_angle"].value, ANGLE + 0.01)
    assert read.parameters == {"scenario.seed": 7}
    assert read.run["scenario"] == "test"


def test_what_the_knee_follows_is_the_wanted_motion_or_that_of_a_plan(bag, tmp_path):
    read = read_bag(bag, ["reference_angle", "followed_angle"])
    np.testing.assert_array_equal(read["followed_angle"].value, read["reference_angle"].value)
    with BagWriter(tmp_path / "planned", {}) as writer:
        for topic, angle in (("reference", 0.5), ("planned_reference", 0.4)):
            writer.add_topic(f"/{topic}", "trajectory_msgs/msg/JointTrajectory")
            for stamp_ns in STAMPS.tolist():
                write(writer, topic, stamp_ns, reference(stamp_ns, (angle, 0.0)))
    planned = read_bag(tmp_path / "planned", ["reference_angle", "followed_angle"])
    assert set(planned["reference_angle"].value) == {0.5}
    assert set(planned["followed_angle"].value) == {0.4}


def test_rosbags_reads_it_with_metadata(bag):
    with AnyReader([bag]) as reader:
        assert reader.message_count == 800
        assert {c.topic: c.msgcount for c in reader.connections} == {
            "/joint_states": 400,
            "/reference": 400,
        }
        times = [time for c, time, _ in reader.messages() if c.topic == "/joint_states"]
    assert times == STAMPS.tolist()


def test_mcap_reads_it_with_schemas_and_records(bag):
    with open(bag / "walk_0.mcap", "rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        positions = [
            (message.log_time, message.publish_time, decoded.position[0])
            for _, _, message, decoded in reader.iter_decoded_messages(topics=["/joint_states"])
        ]
        names = {record.name for record in reader.iter_metadata()}
        channel = next(iter(reader.get_summary().channels.values()))
    assert positions == list(zip(STAMPS, STAMPS, ANGLE, strict=True))
    assert names == {"pam_orthosis", "rosbag2"}
    assert set(channel.metadata) == {"offered_qos_profiles", "topic_type_hash"}


def test_metadata_file_is_version_9_without_aliases(bag):
    text = (bag / "metadata.yaml").read_text()
    information = yaml.safe_load(text)["rosbag2_bagfile_information"]
    assert "&id" not in text
    assert information["version"] == 9
    assert information["message_count"] == 800
    assert information["duration"]["nanoseconds"] == STAMPS[-1]
    assert information["relative_file_paths"] == ["walk_0.mcap"]
    assert information["custom_data"] == {"scenario": "test"}


def test_a_long_bag_is_split_into_files_that_each_hold_their_index(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "FILE_NS", 100 * PERIOD_NS)
    parts = write_tracking_bag(tmp_path / "long", STAMPS, ANGLE + 0.01, ANGLE, {"scenario.seed": 7})
    information = yaml.safe_load((parts / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    names = information["relative_file_paths"]
    assert names == [f"long_{number}.mcap" for number in range(len(names))]
    assert 3 <= len(names) <= 4
    assert information["message_count"] == sum(one["message_count"] for one in information["files"]) == 800
    assert run_record(parts / names[-1])["scenario"] == "test"
    read = read_bag(parts, NEEDED)
    np.testing.assert_array_equal(read["angle"].stamp_ns, STAMPS)
    np.testing.assert_array_equal(read["angle"].value, ANGLE)
    with AnyReader([parts]) as reader:
        assert reader.message_count == 800
        assert sum(1 for _ in reader.messages()) == 800
    for name, file in zip(names, information["files"], strict=True):
        with open(parts / name, "rb") as stream:
            summary = make_reader(stream).get_summary()
        assert summary.statistics.message_count == file["message_count"]
        assert summary.statistics.message_start_time == file["starting_time"]["nanoseconds_since_epoch"]


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_bags_of_other_recorders_are_read(tmp_path, plugin):
    """Other arrival order, wall-clock log times, duplicates, other joints: only stamps count."""
    path = tmp_path / "foreign"
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        kind = "sensor_msgs/msg/JointState"
        connection = writer.add_connection("/joint_states", kind, typestore=STORE)
        for arrival, k in enumerate([2, 0, 0, 1]):
            message = joint_state(k * PERIOD_NS, "knee", [0.1 * k])
            message.name.insert(0, "hip")
            message.position = np.array([9.0, 0.1 * k])
            writer.write(connection, 10**18 + arrival, STORE.serialize_cdr(message, kind))
    read = read_bag(path, ["angle"])
    assert read["angle"].stamp_ns.tolist() == [0, PERIOD_NS, 2 * PERIOD_NS]
    np.testing.assert_allclose(read["angle"].value, [0.0, 0.1, 0.2])
    assert read.run == {}


def test_aligned_keeps_common_stamps():
    left = Series(np.array([1, 2, 4, 7]), np.array([10.0, 20, 40, 70]))
    right = Series(np.array([2, 3, 7]), np.array([-2.0, -3, -7]))
    stamps, (a, b) = aligned(left, right)
    assert stamps.tolist() == [2, 7]
    assert a.tolist() == [20, 70]
    assert b.tolist() == [-2, -7]


def test_no_bag_is_overwritten(bag):
    with pytest.raises(OrthosisError, match="holds a bag already"):
        BagWriter(bag)


def test_missing_and_unclosed_bags_are_refused(tmp_path, bag):
    with pytest.raises(OrthosisError, match="no bag at"):
        read_bag(tmp_path / "nothing", NEEDED)
    (tmp_path / "empty").mkdir()
    with pytest.raises(OrthosisError, match="holds no bag"):
        read_bag(tmp_path / "empty", NEEDED)
    (table := tmp_path / "table.csv").write_text("time,angle\n0,1\n")
    with pytest.raises(
        OrthosisError, match=r"csv is no bag: give a bag's folder, or its .mcap or .db3 file$"
    ):
        read_bag(table, NEEDED)
    (bag / "metadata.yaml").unlink()
    with pytest.raises(OrthosisError, match=r"never closed.*recover"):
        read_bag(bag, NEEDED)


def test_missing_topic_and_wrong_type_are_named(tmp_path, bag):
    with pytest.raises(OrthosisError, match="no topic /estimate"):
        read_bag(bag, ["estimate_velocity"])
    assert "estimate_velocity" not in read_bag(bag, NEEDED, ["estimate_velocity"]).series
    with BagWriter(tmp_path / "odd") as writer:
        writer.add_topic("/joint_states", "std_msgs/msg/String")
    with pytest.raises(OrthosisError, match=r"std_msgs/msg/String, not sensor_msgs/msg/JointState"):
        read_bag(tmp_path / "odd", ["angle"])


def test_empty_topic_is_refused(tmp_path):
    with BagWriter(tmp_path / "empty") as writer:
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
    with pytest.raises(OrthosisError, match="joint_states is empty"):
        read_bag(tmp_path / "empty", ["angle"])


@pytest.mark.parametrize("position", [[np.nan], [np.inf], []])
def test_values_that_are_not_finite_or_missing_are_refused(tmp_path, position):
    with BagWriter(tmp_path / "nan") as writer:
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        write(writer, "joint_states", 0, joint_state(0, "knee", [0.1]))
        write(writer, "joint_states", 10**9, joint_state(10**9, "knee", position))
    with pytest.raises(OrthosisError, match=r"angle .* not finite at 1\.000 s"):
        read_bag(tmp_path / "nan", ["angle"])


def test_a_damaged_file_is_one_error_wherever_it_is_cut(bag):
    file = bag / "walk_0.mcap"
    whole = file.read_bytes()
    for length in range(0, len(whole), len(whole) // 60):
        file.write_bytes(whole[:length])
        with pytest.raises(OrthosisError):
            read_bag(bag, NEEDED)


def test_a_run_tells_the_effects_of_what_it_ran_only():
    p = load(
        {"plant.effects.creep.enabled": True, "effects.backlash.enabled": True, "scenario.plan.enabled": True}
    )
    knee = json.loads(run_metadata(p, "default")["effects"])
    assert {"plant.effects.creep", "effects.backlash"} <= set(knee)
    assert all(name.startswith(("plant.effects.", "effects.")) for name in knee)
    assert json.loads(run_metadata(p, "rig", branches=RIG_EFFECTS)["effects"]) == [
        "plant.rig.effects.carriage_friction"
    ]


def test_run_record_survives_in_the_file_itself(bag):
    assert json.loads(run_record(bag / "walk_0.mcap")["parameters"]) == {"scenario.seed": 7}
