# SPDX-License-Identifier: Apache-2.0
"""What a killed recorder leaves becomes a bag that opens."""

import re
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from bags import PERIOD_NS, write_tracking_bag
from pam_orthosis.bag import record
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.recover import recover, recover_in_place
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError

WALK = Path(__file__).parents[2] / "bags" / "walk"
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
    count = recover(killed, tmp_path / "new").messages
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
            counts.append(recover(killed, out).messages)
        assert out.exists() == (len(counts) > 0)
    assert counts == sorted(counts)
    assert counts[-1] > 0.6 * COUNT


def _spoilt(bag, out, change):
    """Copy a bag; `change` alters the bytes of its file."""
    out.mkdir()
    data = bytearray(next(bag.glob("*.mcap")).read_bytes())
    change(data)
    (out / "spoilt_0.mcap").write_bytes(data)
    return out


def _messages(bag):
    """Return topic, stamp and bytes of all messages."""
    with open(next(bag.glob("*.mcap")), "rb") as stream:
        return [(c.topic, m.log_time, m.data) for _, c, m in make_reader(stream).iter_messages()]


def test_behind_a_corrupt_chunk_the_copy_goes_on_and_tells_what_is_lost(tmp_path, capsys):
    whole = _messages(WALK)

    def overwrite(data):
        at = data.find(b"zstd", len(data) // 3) + 100  # within a chunk
        data[at : at + 60] = b"\xff" * 60

    bag = _spoilt(WALK, tmp_path / "bad", overwrite)
    assert main(["recover", str(bag), "--out", str(tmp_path / "new")]) == 0
    said = capsys.readouterr().out.splitlines()
    copied = _messages(tmp_path / "new")
    assert said[0].startswith(f"{len(copied)} messages recovered")
    assert 0.9 * len(whole) < len(copied) < len(whole)
    assert set(copied) <= set(whole)
    assert copied[-1] == whole[-1]
    (first, last), *more = [re.findall(r"[0-9.]+(?= to | s$)", line) for line in said[1:]]
    assert not more
    missing = [stamp for topic, stamp, data in set(whole) - set(copied)]
    assert (float(first), float(last)) == pytest.approx((min(missing) / 1e9, max(missing) / 1e9), abs=1e-3)


@pytest.mark.parametrize("seed", range(12))
def test_no_altered_message_is_taken_for_whole(tmp_path, seed):
    rng, whole = np.random.default_rng(seed), set(_messages(WALK))

    def flip(data):
        data[int(rng.integers(8, len(data)))] ^= 1 << int(rng.integers(8))

    bag = _spoilt(WALK, tmp_path / "bad", flip)
    with suppress(OrthosisError):
        recovered = recover(bag, tmp_path / "new")
        copied = set(_messages(tmp_path / "new"))
        assert copied <= whole
        assert len(whole) - len(copied) < 600 or recovered.lost
        assert len(copied) > 0.9 * len(whole)


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
    recovered = recover(mixed, tmp_path / "new")
    assert (recovered.messages, recovered.left_out) == (200, 1)
    assert len(read_bag(tmp_path / "new", ["angle"])["angle"].value) == 100


def _copy_messages(source, writer):
    channels = {}
    for schema, channel, message in make_reader(source).iter_messages():
        if channel.topic not in channels:
            known = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known, channel.metadata)
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)
