# SPDX-License-Identifier: Apache-2.0
"""A bag whose recorder was killed is closed where it is, at the cost of its last chunk."""

import errno
import os
import resource
import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer
from rosbags.rosbag2 import Reader

import bags
from pam_orthosis.bag import close, record, unclosed
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.recover import recover, recover_in_place
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError

STAMPS = np.arange(3000, dtype=np.int64) * bags.PERIOD_NS


class Killed(BagWriter):
    """A writer whose process ends when all has been written out."""

    def close(self):
        self.flush()
        self._stream.close()


class Closed(BagWriter):
    """The same, but it lives on."""

    def close(self):
        self.flush()
        super().close()


def _write(folder, writer, monkeypatch, files_of=5):
    monkeypatch.setattr(record, "FILE_NS", files_of * SECOND_NS)
    monkeypatch.setattr(bags, "BagWriter", writer)
    return bags.write_tracking_bag(folder / "bag", STAMPS, STAMPS * 1e-10, STAMPS * 1e-10, {"a": 1.0})


@pytest.fixture
def killed(tmp_path, monkeypatch):
    return _write(tmp_path / "killed", Killed, monkeypatch)


def _contents(bag):
    return {one.name: one.read_bytes() for one in bag.iterdir()}


def _messages(bag):
    """Return all messages as `mcap` reads them by its index, and the number that `rosbags` reads."""
    told = []
    for file in sorted(bag.glob("*.mcap")):
        with open(file, "rb") as stream:
            reader = make_reader(stream, validate_crcs=True)
            told += [(c.topic, m.log_time, m.data) for _, c, m in reader.iter_messages()]
    with Reader(bag) as reader:
        assert reader.message_count == sum(1 for _ in reader.messages()) == len(told)
    return told


@pytest.mark.parametrize("files_of", [5, 600], ids=["three files", "one file"])
def test_a_closed_bag_is_the_same_to_the_byte_as_if_its_writer_had_closed_it(tmp_path, monkeypatch, files_of):
    whole = _write(tmp_path / "closed", Closed, monkeypatch, files_of)
    bag = _write(tmp_path / "killed", Killed, monkeypatch, files_of)
    assert recover_in_place(bag) == 2 * len(STAMPS)
    assert _contents(bag) == _contents(whole)


def test_each_chunk_is_unpacked_once(tmp_path, monkeypatch):
    unpacked = []
    unpack = unclosed.get_chunk_data_stream
    monkeypatch.setattr(
        unclosed, "get_chunk_data_stream", lambda *given, **more: unpacked.append(1) or unpack(*given, **more)
    )
    bag = _write(tmp_path / "bag", Killed, monkeypatch, 600)
    assert recover_in_place(bag) == 2 * len(STAMPS)
    chunks = 0
    for file in bag.glob("*.mcap"):
        with open(file, "rb") as stream:
            chunks += len(make_reader(stream).get_summary().chunk_indexes)
    assert len(unpacked) == chunks


def test_any_cut_is_closed_up_to_its_last_whole_chunk_and_never_twice(killed):
    """Wherever the file is torn: in a chunk, in its index, in the summary that was being written."""
    last = killed / "bag_2.mcap"
    recovered_whole = shutil.copytree(killed, killed.with_name("whole"))
    recover_in_place(recovered_whole)
    whole, messages = (recovered_whole / "bag_2.mcap").read_bytes(), _messages(recovered_whole)
    there = {name: data for name, data in _contents(killed).items() if name != last.name}
    counts = []
    for length in [*range(0, 60, 7), *np.linspace(60, len(whole), 60, dtype=int)]:
        for name, data in {**there, last.name: whole[:length]}.items():
            (killed / name).write_bytes(data)
        (killed / "metadata.yaml").unlink(missing_ok=True)
        counts.append(recover_in_place(killed))
        assert _messages(killed) == messages[: counts[-1]]
        assert {one.name for one in killed.iterdir()} == {*there, last.name, "metadata.yaml"}
        closed = _contents(killed)
        assert recover_in_place(killed) == counts[-1]  # there is nothing to do
        assert _contents(killed) == closed
    assert counts == sorted(counts)
    assert counts[-1] == len(messages)
    assert read_bag(killed, ["angle"]).parameters == {"a": 1.0}


def test_a_closed_bag_with_a_damaged_chunk_is_refused_in_place(killed, capsys):
    bag = killed
    recover_in_place(bag)
    file = sorted(bag.glob("*.mcap"))[0]
    with open(file, "rb") as stream:
        chunk = make_reader(stream).get_summary().chunk_indexes[1]
    data = bytearray(file.read_bytes())
    data[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 0xFF
    file.write_bytes(data)
    before = _contents(bag)
    assert main(["recover", str(bag), "--in-place"]) == 2
    assert "is damaged" in capsys.readouterr().err
    assert _contents(bag) == before


@pytest.mark.parametrize(
    "where", ["an earlier chunk's length", "the last chunk", "the beginning", "zeros at the end"]
)
def test_what_is_damaged_elsewhere_is_left_as_it_is_and_can_be_copied(killed, tmp_path, where, capsys):
    last = killed / "bag_2.mcap"
    data = bytearray(last.read_bytes())
    chunks = [chunk.chunk_start_offset for chunk, _ in unclosed.look(last).chunks]
    if where == "zeros at the end":  # of a power cut
        data += bytes(5000)
    else:
        places = {
            "an earlier chunk's length": chunks[3] + 6,
            "the last chunk": chunks[-1] + 90,
            "the beginning": 3,
        }
        data[places[where]] ^= 0xFF
    last.write_bytes(data)
    before = _contents(killed)
    assert main(["recover", str(killed), "--in-place"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "leave --in-place out" in said
    assert _contents(killed) == before
    assert recover(killed, tmp_path / "new").messages > 0.9 * 2 * len(STAMPS)
    assert _contents(killed) == before


def test_a_link_to_a_file_elsewhere_is_not_followed(killed, tmp_path, capsys):
    last, elsewhere = killed / "bag_2.mcap", tmp_path / "theirs.mcap"
    last.rename(elsewhere)
    last.symlink_to(elsewhere)
    before = elsewhere.read_bytes()
    assert main(["recover", str(killed), "--in-place"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "it is a link" in said
    assert elsewhere.read_bytes() == before
    assert not (killed / "metadata.yaml").exists()


def test_channels_that_are_declared_late_are_found(tmp_path):
    with Killed(tmp_path / "bag") as writer:
        for number in range(40):
            topic = f"/topic_{number // 10}"
            if number % 10 == 0:
                writer.add_topic(topic, bags.ANGLE_TYPE)
            writer.write(topic, number * 100_000_000, bags.serialised_angle(number, 0.1))
    assert recover_in_place(tmp_path / "bag") == 40
    assert {topic for topic, _, _ in _messages(tmp_path / "bag")} == {f"/topic_{n}" for n in range(4)}


def test_a_bag_without_a_message_is_told_and_left(tmp_path):
    BagWriter(tmp_path / "bag", {"scenario": "x"})
    before = _contents(tmp_path / "bag")
    with pytest.raises(OrthosisError, match="holds no readable message"):
        recover_in_place(tmp_path / "bag")
    assert _contents(tmp_path / "bag") == before


@contextmanager
def _disk_of(monkeypatch, size):
    """Let a file system have so many bytes for what is written from now on; cutting makes room."""
    room = [size]
    really_open, really_truncate = open, os.ftruncate

    class Stream:
        def __init__(self, stream):
            self.stream, self.name = stream, stream.name

        def __getattr__(self, name):
            return getattr(self.stream, name)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self.stream.close()

        def truncate(self, size):
            room[0] += os.fstat(self.stream.fileno()).st_size - size
            really_truncate(self.stream.fileno(), size)

        def write(self, data):
            if room[0] <= 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            fits = bytes(data)[: room[0]]
            room[0] -= len(fits)
            self.stream.write(fits)
            return len(fits)

    monkeypatch.setattr(
        close, "open", lambda *given, **more: Stream(really_open(*given, **more)), raising=False
    )
    yield room
    monkeypatch.undo()


@pytest.mark.parametrize("torn", [20_000, 3_000, 500, 0])
def test_on_a_full_disk_the_torn_end_makes_room(killed, monkeypatch, torn):
    """A file system with not a byte left but what is cut off."""
    last = killed / "bag_2.mcap"
    whole = unclosed.look(last)
    size = whole.chunks[-1][0].chunk_start_offset
    after = last.stat().st_size - size
    if torn:
        data = last.read_bytes()
        fake_chunk = bytes([6]) + (10**6).to_bytes(8, "little") + bytes(torn)
        last.write_bytes(data + fake_chunk)
    written = close.write_text

    def writes_metadata(path, text):
        if room[0] < len(text):
            raise OrthosisError("full") from OSError(errno.ENOSPC, "No space left on device")
        room[0] -= len(text)
        written(path, text)

    with _disk_of(monkeypatch, 0) as room:
        monkeypatch.setattr(close, "write_text", writes_metadata)
        count = recover_in_place(killed)
        assert room[0] >= 0
    messages = _messages(killed)
    assert len(messages) == count
    lost = 2 * len(STAMPS) - count
    assert lost == 0 if torn > 10_000 else lost <= 3 * 2 * record.FLUSH_NS // bags.PERIOD_NS
    assert after > 0


def test_where_files_may_not_grow_the_bag_is_closed_without_a_summary(killed):
    """A limit of the system in place of a full disk: what is cut off is all the room there is."""
    last = killed / "bag_2.mcap"
    last.write_bytes(last.read_bytes()[:-3000])
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (last.stat().st_size, before[1]))
    try:
        count = recover_in_place(killed)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(_messages(killed)) == count > 0.95 * 2 * len(STAMPS)


def _foreign(path: Path, **options) -> int:
    """Write an unclosed file as `ros2 bag record` does, beginning with its metadata; return its messages."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=4096, **options)
        writer.start(profile="ros2")
        writer.add_metadata("rosbag2", {"serialized_metadata": "version: 9"})
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data\n")
        channel = writer.register_channel("/said", "cdr", schema)
        for number in range(1000):
            writer.add_message(channel, number, b"\0\1\0\0\1\0\0\0\0", number)
        writer.flush()
    return 1000


def test_a_file_that_begins_with_the_metadata_of_an_open_bag_keeps_its_messages(tmp_path):
    """ros2 bag writes them when it opens a file, and again when it closes it."""
    bag = tmp_path / "bag"
    bag.mkdir()
    count = sum(_foreign(bag / f"bag_{number}.mcap") for number in range(2))
    recover_in_place(shutil.copytree(bag, tmp_path / "other"))
    (tmp_path / "other/bag_0.mcap").replace(bag / "bag_0.mcap")  # closed, as of a bag that was split
    before = (bag / "bag_1.mcap").read_bytes()
    assert recover_in_place(bag) == count == len(_messages(bag))
    assert (bag / "bag_1.mcap").read_bytes().startswith(before[: unclosed.HEAD.size])


def test_chunks_without_an_index_are_not_closed_without_their_messages(tmp_path):
    count = _foreign(tmp_path / "bag_0.mcap", index_types=IndexType.ALL & ~IndexType.MESSAGE)
    before = _contents(tmp_path)
    with pytest.raises(unclosed.Damaged, match="without an index"):
        recover_in_place(tmp_path)
    assert _contents(tmp_path) == before
    assert recover(tmp_path, tmp_path / "new").messages == count


def test_a_bag_that_is_being_written_is_left_alone(killed, capsys, monkeypatch):
    monkeypatch.setattr(close, "WRITER_SECONDS", 0.1)
    before = _contents(killed)
    with open(killed / "bag_2.mcap", "ab"):
        assert main(["recover", str(killed), "--in-place"]) == 2
    assert "bag_2.mcap is being written; wait" in capsys.readouterr().err
    assert _contents(killed) == before
    assert main(["recover", str(killed), "--in-place"]) == 0


def test_room_that_cannot_be_made_costs_no_more_than_what_is_added_needs(killed, monkeypatch):
    """Somebody else takes what is cut off: this must not go on until nothing is left."""
    last = killed / "bag_2.mcap"
    end = unclosed.look(last).end
    full = OSError(errno.ENOSPC, "No space left on device")

    def no_room(*_):
        raise full

    monkeypatch.setattr(close.os, "fsync", no_room)
    monkeypatch.setattr(close, "_brief_end", lambda: b"\x0f")  # torn, so that it can be looked at
    monkeypatch.setattr(close, "_end", lambda *_: b"\x0f")
    with pytest.raises(OrthosisError, match="No space left"):
        recover_in_place(killed)
    cut = end - unclosed.look(last).end
    assert 0 < cut < 25_000 < end / 2  # metadata, a block each for file and folder, a chunk


def test_without_room_for_another_file_nothing_is_cut(killed, monkeypatch):
    """A file system has a number of files, too; no cutting helps then."""
    before = _contents(killed)

    def none_left(**_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(close, "TemporaryFile", none_left)
    with pytest.raises(OrthosisError, match="No space left"):
        recover_in_place(killed)
    assert _contents(killed) == before


def test_a_limit_of_files_that_no_cutting_meets_costs_no_message(killed):
    last = killed / "bag_2.mcap"
    count = unclosed.look(last).counts.total()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        with pytest.raises(OrthosisError, match="File too large"):
            recover_in_place(killed)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert unclosed.look(last).counts.total() == count


def test_the_command_closes_in_place_and_says_so(killed, capsys):
    assert main(["recover", str(killed), "--in-place"]) == 0
    assert capsys.readouterr().out == f"{2 * len(STAMPS)} messages recovered into {killed}\n"
    assert main(["recover", str(killed), "--in-place", "--out", "x"]) == 2
    assert main(["recover", str(Path(killed) / "bag_0.mcap"), "--in-place"]) == 2
