# SPDX-License-Identifier: Apache-2.0
"""What a killed recorder leaves becomes a bag that opens."""

import json
import re
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import Reader

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


EXTRA = {
    "unknown type": ("acme_msgs/msg/Thing", "ros2msg", b"acme_msgs/Other x\n"),
    "no readable definition": ("acme_msgs/msg/Thing", "ros2msg", b"%% ??"),
    "empty definition": ("acme_msgs/msg/Thing", "ros2msg", b""),
    "no encoding": ("acme_msgs/msg/Thing", "", b""),
    "no schema": None,
}


def _mixed(file, schema, encoding="cdr"):
    """Write the reference bag with one more topic."""
    with open(file, "wb") as stream, open(next(WALK.glob("*.mcap")), "rb") as source:
        writer = Writer(stream)
        writer.start("ros2")
        number = writer.register_schema(*schema) if schema else 0
        extra = writer.register_channel("/extra", encoding, number)
        for index in range(3):
            writer.add_message(extra, index, b"\0\1\0\0abc", index + 5, sequence=7)
        _copy_messages(source, writer)
        writer.finish()
    return file


def _all(bag):
    """Return all there is of all messages."""
    with open(bag if bag.is_file() else next(bag.glob("*.mcap")), "rb") as stream:
        return [
            (
                s and (s.name, s.encoding, s.data),
                c.topic,
                c.metadata,
                m.log_time,
                m.publish_time,
                m.sequence,
                m.data,
            )
            for s, c, m in make_reader(stream).iter_messages()
        ]


@pytest.mark.parametrize("what", EXTRA)
def test_a_topic_of_an_unknown_or_empty_schema_is_copied_as_it_is(tmp_path, what):
    mixed = _mixed(tmp_path / "mixed.mcap", EXTRA[what])
    recovered = recover(mixed, tmp_path / "new")
    assert (recovered.left_out, recovered.lost) == ((), ())
    assert _all(tmp_path / "new") == _all(mixed)
    with Reader(tmp_path / "new") as reader:
        read = [(one.topic, data) for one, _, data in reader.messages()]
    assert len(read) == recovered.messages
    assert read.count(("/extra", b"\0\1\0\0abc")) == 3


@pytest.mark.parametrize(
    ("schema", "encoding", "why"),
    [
        (None, "json", "its messages are json, not cdr"),
        (("Thing", "jsonschema", b"{}"), "cdr", "its type is defined in jsonschema, which is not of ROS"),
        (("Thing", "ros2msg", b"\xff"), "cdr", "the definition of its type is no text"),
    ],
)
def test_what_would_keep_readers_from_all_the_rest_is_left_out_and_listed(
    tmp_path, capsys, schema, encoding, why
):
    mixed = _mixed(tmp_path / "mixed.mcap", schema, encoding)
    assert main(["recover", str(mixed), "--out", str(tmp_path / "new")]) == 0
    assert f"left out: 3 messages of /extra: {why}" in capsys.readouterr().out
    assert main(["recover", str(mixed), "--out", str(tmp_path / "again"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["left_out"] == [{"topic": "/extra", "messages": 3, "why": why}]
    rest = _all(mixed)
    assert _all(tmp_path / "new") == [one for one in rest if one[1] != "/extra"]
    with Reader(tmp_path / "new") as reader:
        assert reader.message_count == len(rest) - 3 == told["messages"]


def test_two_types_on_one_topic_keep_apart(tmp_path):
    mixed = tmp_path / "mixed.mcap"
    with open(mixed, "wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        for name in (b"A", b"B"):
            schema = writer.register_schema("acme_msgs/msg/Thing", "ros2msg", b"int32 " + name)
            writer.add_message(writer.register_channel("/same", "cdr", schema), 1, name, 1)
        writer.finish()
    recover(mixed, tmp_path / "new")
    assert _all(tmp_path / "new") == _all(mixed)


@pytest.mark.parametrize("out", [".", "mine", "bad"], ids=["here", "a used folder", "the bag itself"])
def test_nothing_that_is_there_is_removed_even_if_nothing_can_be_recovered(
    tmp_path, monkeypatch, capsys, out
):
    monkeypatch.chdir(tmp_path)
    for name in ("mine", "bad"):
        (tmp_path / name).mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    (tmp_path / "bad" / "bad_0.mcap").write_bytes(next(WALK.glob("*.mcap")).read_bytes()[:200])
    before = sorted(tmp_path.rglob("*"))
    assert main(["recover", "bad", "--out", out]) == 2
    assert "exists and is not an empty folder" in capsys.readouterr().err
    assert main(["recover", "bad", "--out", "new"]) == 2
    assert "holds no readable message" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_without_out_the_new_bag_is_made_here_and_not_beside_the_other(killed, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert main(["recover", str(killed)]) == 0
    _assert_beginning_of_the_run(tmp_path / "here" / "cut-recovered")
    assert {one.name for one in tmp_path.iterdir()} == {"cut", "here"}


def _copy_messages(source, writer):
    channels = {}
    for schema, channel, message in make_reader(source).iter_messages():
        if channel.topic not in channels:
            known = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known, channel.metadata)
        writer.add_message(channels[channel.topic], message.log_time, message.data, message.publish_time)


def _of_another_program(file, profile="", encoding="json", schema=("thing", "jsonschema", b"{}")):
    file.parent.mkdir(exist_ok=True)
    with open(file, "wb") as stream:
        writer = Writer(stream)
        writer.start(profile=profile, library="another program")
        channel = writer.register_channel("/thing", encoding, writer.register_schema(*schema))
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()
    return file


@pytest.mark.parametrize("profile", ["", "ros2"])
@pytest.mark.parametrize("folder", [True, False], ids=["folder", "file"])
@pytest.mark.parametrize("verb", ["check", "gap", "report", "replay"])
def test_a_bag_of_another_program_is_told_as_such_and_nothing_is_advised(
    verb, folder, profile, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    file = _of_another_program(tmp_path / "foreign" / "foreign_0.mcap", profile)
    given = file.parent if folder else file
    assert main([verb, str(given)]) == 2
    said = capsys.readouterr().err.splitlines()
    assert f"{given} is no bag of ROS: /thing: its messages are json, not cdr" in said[-1]
    assert "recover" not in said[-1]


def test_a_profile_of_another_program_is_no_reason_to_close_in_place(tmp_path, capsys):
    bag = tmp_path / "foreign"
    file = _of_another_program(
        bag / "foreign_0.mcap", encoding="cdr", schema=("std_msgs/msg/Empty", "ros2msg", b"")
    )
    for given in (bag, file):
        assert main(["check", str(given)]) == 2
        assert f"`pam-orthosis recover {given}`" in capsys.readouterr().err
    recover(bag, tmp_path / "new")
    with Reader(tmp_path / "new") as reader:
        assert [one.topic for one in reader.connections] == ["/thing"]


def test_a_bag_of_ros_beside_another_program_is_copied_without_it(tmp_path, capsys):
    bag = tmp_path / "mixed"
    shutil.copytree(WALK, bag)
    (bag / "metadata.yaml").unlink()
    assert main(["check", str(bag)]) == 2
    assert f"run `pam-orthosis recover {bag} --in-place`" in capsys.readouterr().err
    _of_another_program(bag / "mixed_1.mcap")
    assert main(["check", str(bag)]) == 2
    assert f"run `pam-orthosis recover {bag}`" in capsys.readouterr().err
    assert main(["recover", str(bag), "--out", str(tmp_path / "new")]) == 0
    assert main(["check", str(tmp_path / "new")]) == 0
