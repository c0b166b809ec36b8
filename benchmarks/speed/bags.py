# SPDX-License-Identifier: Apache-2.0
"""Bags: writing, reading, size, and what recording costs the graph."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.highlevel import AnyReader

from pam_orthosis.bag.cdr import canonical, store
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.record import CHUNK_BYTES, BagWriter
from pam_orthosis.bag.topics import Topics, resolve
from pam_orthosis.model.machines import KNEE
from speed.graph import stepped
from speed.rows import NO_GOAL, Row, alternating, row

TABLE = Topics(KNEE)

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"
NAMES = {resolve(topic.name): topic.type for topic in TABLE.recorded}


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows, on the reference bag of the repository."""
    messages, seconds = recorded()
    ours, bare = alternating(repeats, lambda: written(messages), lambda: written_bare(messages))
    yield row("bags", "writing a message, beside the bare MCAP writer", "us", ours, bare)
    ours, theirs = alternating(repeats, lambda: read(len(messages)), lambda: read_by_rosbags(len(messages)))
    yield row("bags", "reading a message into arrays, beside rosbags' reader", "us", ours, theirs)
    plain = sum(len(data) for _, _, data in messages)
    size = sum(file.stat().st_size for file in WALK.iterdir())
    minute = 60 / seconds / 1e6
    yield row("bags", "a simulated minute at 200 Hz, beside the bare messages", "MB",
              [size * minute], [plain * minute])  # fmt: skip
    try:
        import rclpy  # noqa: F401
    except ModuleNotFoundError:
        return
    whole, without = alternating(repeats, lambda: stepped(True, True), lambda: stepped(True, False))
    for index, what in enumerate(("time", "processor time")):
        figures = [[each[index] for each in side] for side in (whole, without)]
        yield row("bags", f"{what} of a step with a recorder, beside one without", "us", *figures, NO_GOAL)


def recorded() -> tuple[list[tuple[str, int, bytes]], float]:
    """Return the messages of the reference bag that nodes publish, and its duration in s."""
    with open(next(WALK.glob("*.mcap")), "rb") as stream:
        found = [
            (channel.topic, message.log_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages(topics=list(NAMES))
        ]
    return found, (found[-1][1] - found[0][1]) / 1e9


def written(messages: list[tuple[str, int, bytes]]) -> float:
    """Return how long a message takes through what the recorder does with it, us."""

    def write(folder: Path) -> None:
        with BagWriter(folder / "bag") as writer:
            for name, kind in NAMES.items():
                writer.add_topic(name, kind)
            writer.write_all(
                (name, stamp_ns, canonical(data, NAMES[name])) for name, stamp_ns, data in messages
            )

    return _timed(write, len(messages))


def written_bare(messages: list[tuple[str, int, bytes]]) -> float:
    """Return how long a message takes through the MCAP writer, with chunks of the same size, us."""

    def write(folder: Path) -> None:
        file = str(folder / "bare.mcap")
        writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("none", "ros2msg", b"")
        channels = {name: writer.register_channel(name, "cdr", schema) for name in NAMES}
        for name, stamp_ns, data in messages:
            writer.add_message(channels[name], stamp_ns, data, stamp_ns)
        writer.finish()

    return _timed(write, len(messages))


def read(count: int) -> float:
    """Return how long a message takes to be read into the arrays of all signals, us."""
    return _timed(lambda _folder: read_bag(WALK, list(TABLE.signals)), count)


def read_by_rosbags(count: int) -> float:
    """Return how long a message takes to be read and deserialised by rosbags alone, us."""

    def read_all(_folder: Path) -> None:
        with AnyReader([WALK], default_typestore=store()) as reader:
            wanted = [connection for connection in reader.connections if connection.topic in NAMES]
            for connection, _, data in reader.messages(connections=wanted):
                reader.deserialize(data, connection.msgtype)

    return _timed(read_all, count)


def _timed(act: Callable[[Path], object], count: int) -> float:
    """Return the processor time of this thread for one of so many messages, us."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        began = time.thread_time()
        act(Path(folder))
        return 1e6 * (time.thread_time() - began) / count
