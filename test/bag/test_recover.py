# SPDX-License-Identifier: Apache-2.0
"""What a killed recorder leaves becomes a bag that opens."""

from contextlib import suppress

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from bags import PERIOD_NS, write_tracking_bag
from pam_orthosis.bag import record
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.recover import recover, recover_in_place
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError

COUNT = 3000
STAMPS = np.arange(COUNT, dtype=np.int64) * PERIOD_NS


@pytest.fixture
def killed(tmp_path):
    """A bag cut in the middle, without metadata.yaml."""
    bag = write_tracking_bag(tmp_path / "cut", STAMPS, STAMPS * 1e-9, STAMPS * 1e-9, {"a": 1.0})
    file = bag / "cut_0.mcap"
    data = file.read_bytes()
    file.write_bytes(data[: len(data) // 2])
    (bag / "metadata.yaml").unlink()
    return bag


def _assert_beginning_of_the_run(bag):
    read = read_bag(bag, ["angle"])
    count = len(read["angle"].value)
    assert 0.3 * COUNT < count < COUNT
    np.testing.assert_array_equal(read["angle"].stamp_ns, STAMPS[:count])
    np.testing.assert_array_equal(read["angle"].value, STAMPS[:count] * 1e-9)
    assert read.parameters == {"a": 1.0}


def test_whole_messages_are_copied_with_the_run_metadata(killed, tmp_path):
    count = recover(killed, tmp_path / "new")
    _assert_beginning_of_the_run(tmp_path / "new")
    assert count >= 2 * len(read_bag(tmp_path / "new", ["angle"])["angle"].value)


def test_in_place_keeps_name_and_leaves_no_debris(killed):
    recover_in_place(killed)
    _assert_beginning_of_the_run(killed)
    assert {file.name for file in killed.iterdir()} == {"cut_0.mcap", "metadata.yaml"}


def test_any_cut_is_recovered_or_refused(killed, tmp_path):
    file = killed / "cut_0.mcap"
    data = file.read_bytes()
    counts = []
    for number, length in enumerate(np.linspace(0, len(data), 25, dtype=int)):
        file.write_bytes(data[:length])
        out = tmp_path / f"out{number}"
        with suppress(OrthosisError):
            counts.append(recover(killed, out))
        assert out.exists() == (len(counts) > 0)
    assert counts == sorted(counts)
    assert counts[-1] > 0.6 * COUNT


def test_a_corrupt_chunk_ends_the_copy(killed, tmp_path):
    file = killed / "cut_0.mcap"
    data = bytearray(file.read_bytes())
    middle = len(data) // 2
    data[middle : middle + 2000] = b"\xff" * 2000
    file.write_bytes(data)
    assert recover(killed, tmp_path / "new") > 0
    assert len(read_bag(tmp_path / "new", ["angle"])["angle"].value) > 0


@pytest.fixture
def killed_in_its_third_file(tmp_path, monkeypatch):
    monkeypatch.setattr(record, "FILE_NS", 5 * SECOND_NS)
    bag = write_tracking_bag(tmp_path / "long", STAMPS, STAMPS * 1e-10, STAMPS * 1e-10, {"a": 1.0})
    last = bag / "long_2.mcap"
    data = last.read_bytes()
    last.write_bytes(data[: len(data) // 2])
    (bag / "metadata.yaml").unlink()
    return bag


def test_a_long_bag_is_recovered_with_all_its_files(killed_in_its_third_file, tmp_path):
    recover(killed_in_its_third_file, tmp_path / "new")
    recover_in_place(killed_in_its_third_file)
    for bag in (tmp_path / "new", killed_in_its_third_file):
        stamps = read_bag(bag, ["angle"])["angle"].stamp_ns
        assert 10 * SECOND_NS < len(stamps) * PERIOD_NS < 15 * SECOND_NS
        np.testing.assert_array_equal(stamps, STAMPS[: len(stamps)])
        files = {f"{bag.name}_{number}.mcap" for number in range(3)}
        assert {one.name for one in bag.iterdir()} == {*files, "metadata.yaml"}


def test_a_folder_without_a_file_is_refused(tmp_path):
    with pytest.raises(OrthosisError, match=r"expected \.mcap files"):
        recover(tmp_path, tmp_path / "new")


def test_a_channel_without_a_schema_is_left_out(tmp_path):
    """It is legal in MCAP, and no ROS topic."""
    bag = write_tracking_bag(tmp_path / "own", STAMPS[:100], STAMPS[:100] * 1e-9, STAMPS[:100] * 1e-9)
    mixed = tmp_path / "mixed.mcap"
    with open(mixed, "wb") as stream, open(bag / "own_0.mcap", "rb") as source:
        writer = Writer(stream)
        writer.start("ros2")
        bare = writer.register_channel("/bare", "json", 0)
        writer.add_message(bare, 0, b"{}", 0)
        _copy_messages(source, writer)
        writer.finish()
    assert recover(mixed, tmp_path / "new") == 200
    assert len(read_bag(tmp_path / "new", ["angle"])["angle"].value) == 100


def _copy_messages(source, writer):
    channels = {}
    for schema, channel, message in make_reader(source).iter_messages():
        if channel.topic not in channels:
            known = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known, channel.metadata)
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
