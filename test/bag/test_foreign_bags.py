# SPDX-License-Identifier: Apache-2.0
"""Bags as `ros2 bag record` writes them: other stores, compressed, split, other quality of service."""

from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.read import raw_messages, read_bag
from pam_orthosis.bag.record import message_definition
from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.main import main

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"
OFFSET_NS = 1_700_000_000_123_456_789  # the recorder's clock, which is not that of the stamps
STORE = get_typestore(Stores.ROS2_JAZZY)
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
BEST_EFFORT = yaml.safe_dump(
    [
        {
            "history": 1,
            "depth": 5,
            "reliability": 2,
            "durability": 2,
            "deadline": _FOREVER,
            "lifespan": _FOREVER,
            "liveliness": 1,
            "liveliness_lease_duration": _FOREVER,
            "avoid_ros_namespace_conventions": False,
        }
    ]
)


def _messages():
    with AnyReader([WALK], default_typestore=STORE) as reader:
        yield from ((one.topic, one.msgtype, stamp_ns, data) for one, stamp_ns, data in reader.messages())


def _by_rosbags(folder, storage, mode=CompressionMode.NONE):
    writer = Writer(folder, version=8, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for topic, kind, stamp_ns, data in _messages():
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], OFFSET_NS + stamp_ns, data)
    return folder


def sqlite(folder):
    return _by_rosbags(folder, StoragePlugin.SQLITE3)


def sqlite_with_compressed_messages(folder):
    return _by_rosbags(folder, StoragePlugin.SQLITE3, CompressionMode.MESSAGE)


def mcap(folder):
    return _by_rosbags(folder, StoragePlugin.MCAP)


def split_mcap(folder, files=3, compression=CompressionType.ZSTD):
    """Three files, the messages not in the order of their stamps, chunks with zstd."""
    folder.mkdir()
    messages = list(_messages())
    messages[100:140] = messages[100:140][::-1]
    arrived = [
        (topic, kind, OFFSET_NS + n * 70_000, data) for n, (topic, kind, _, data) in enumerate(messages)
    ]
    parts = np.array_split(np.arange(len(arrived)), files)
    names = [f"{folder.name}_{number}.mcap" for number in range(files)]
    for name, part in zip(names, parts, strict=True):
        _write_mcap(folder / name, [arrived[index] for index in part], compression)
    _write_metadata(folder, names, messages)
    return folder


def split_and_compressed_files(folder):
    """As with `--compression-mode file`: each file is packed when it is full."""
    split_mcap(folder, compression=CompressionType.NONE)
    for file in folder.glob("*.mcap"):
        packed = zstandard.ZstdCompressor().compress(file.read_bytes())
        file.with_name(f"{file.name}.zstd").write_bytes(packed)
        file.unlink()
    path = folder / "metadata.yaml"
    metadata = yaml.safe_load(path.read_text())
    bag = metadata["rosbag2_bagfile_information"]
    bag |= {"compression_format": "zstd", "compression_mode": "FILE"}
    bag["relative_file_paths"] = [f"{name}.zstd" for name in bag["relative_file_paths"]]
    for file in bag["files"]:
        file["path"] += ".zstd"
    path.write_text(yaml.safe_dump(metadata))
    return folder


def _write_mcap(file, messages, compression):
    with open(file, "wb") as stream:
        writer = McapWriter(stream, chunk_size=100_000, compression=compression)
        writer.start(profile="ros2", library="libmcap 1.3.0")
        schemas, channels = {}, {}
        for topic, kind, time_ns, data in messages:
            if kind not in schemas:
                text = message_definition(kind)[0]
                schemas[kind] = writer.register_schema(kind, "ros2msg", text.encode())
            if topic not in channels:
                quality = {"offered_qos_profiles": BEST_EFFORT}
                channels[topic] = writer.register_channel(topic, "cdr", schemas[kind], quality)
            writer.add_message(channels[topic], time_ns, bytes(data), time_ns)
        writer.finish()


def _write_metadata(folder, names, messages):
    topics = {topic: kind for topic, kind, *_ in messages}
    span = {
        "duration": {"nanoseconds": 7_000_000_000},
        "starting_time": {"nanoseconds_since_epoch": OFFSET_NS},
        "message_count": len(messages),
    }
    counts = [
        {
            "topic_metadata": {
                "name": topic,
                "type": kind,
                "serialization_format": "cdr",
                "offered_qos_profiles": BEST_EFFORT,
            },
            "message_count": sum(one[0] == topic for one in messages),
        }
        for topic, kind in topics.items()
    ]
    bag = {
        "version": 8,
        "storage_identifier": "mcap",
        **span,
        "topics_with_message_count": counts,
        "compression_format": "",
        "compression_mode": "",
        "relative_file_paths": names,
        "files": [{"path": name, **span} for name in names],
        "custom_data": None,
        "ros_distro": "jazzy",
    }
    (folder / "metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": bag}))


WRITERS = [sqlite, sqlite_with_compressed_messages, mcap, split_mcap, split_and_compressed_files]


@pytest.mark.parametrize("write", WRITERS, ids=lambda write: write.__name__)
def test_a_foreign_bag_holds_the_same_numbers_and_gets_the_same_verdict(write, tmp_path):
    bag = write(tmp_path / "foreign")
    ours, theirs = read_bag(WALK, ["angle", "truth_torque"]), read_bag(bag, ["angle", "truth_torque"])
    for name, series in ours.series.items():
        np.testing.assert_array_equal(theirs[name].stamp_ns, series.stamp_ns)
        np.testing.assert_array_equal(theirs[name].value, series.value)
    assert raw_messages(bag, ["estimate"]) == raw_messages(WALK, ["estimate"])
    assert not theirs.parameters
    assert judge(bag).max_abs_error == judge(WALK).max_abs_error
    assert main(["check", str(bag)]) == 0


def test_the_page_of_a_foreign_bag(tmp_path):
    bag = split_mcap(tmp_path / "foreign")
    assert main(["report", str(bag), "--only", "picture", "--out", str(tmp_path / "out")]) == 0
    assert any((tmp_path / "out").iterdir())
