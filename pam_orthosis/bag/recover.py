# SPDX-License-Identifier: Apache-2.0
"""Make a readable bag of one that is damaged, or whose recorder was killed."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml
from mcap.records import Channel, Message, Metadata, Schema
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.record import METADATA_FILE, RUN_RECORD, BagWriter
from pam_orthosis.bag.salvage import Loss, Salvage
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import write_text

ENCODINGS = ("cdr", "ros2msg")  # of the messages and of the schemas of ROS topics


@dataclass(frozen=True)
class Recovered:
    """What came of a bag: messages that were copied, those of no ROS topic that were not, what was lost."""

    messages: int
    left_out: int
    lost: tuple[Loss, ...]


def recover(bag: Path, out: Path) -> Recovered:
    """Copy all whole messages of a damaged MCAP bag into a new, closed bag.

    A chunk of messages is whole if its checksum is right; those behind a damaged one are copied too.

    Args:
        bag: folder with `.mcap` files, or a file.
        out: folder of the new bag.

    Raises:
        OrthosisError: no MCAP file there, nothing readable in it, or `out` holds a bag.
    """
    files = _sources(Path(bag))
    sources = [Salvage(file) for file in files]
    known = _Known(sources)
    if not known.messages:
        raise OrthosisError(f"{files[0]} holds no readable message")
    if not known.copied:
        raise OrthosisError(f"{files[0]} holds no message of a ROS topic")
    with BagWriter(out, known.run) as writer:
        for source, topics in zip(sources, known.topics, strict=True):
            _copy(source, topics, writer)
    _check_readable(out)
    lost = tuple(loss for source in sources for loss in source.lost)
    return Recovered(known.copied, known.messages - known.copied, lost)


def recover_in_place(bag: Path) -> int:
    """Close the unfinished bag of a folder, keeping its name; return the number of messages."""
    sources = _sources(Path(bag))
    rescue = bag / "recovered"
    count = recover(bag, rescue).messages
    text = (rescue / METADATA_FILE).read_text()
    rescued = sorted(rescue.glob("*.mcap"), key=_number)
    names = [source.name for source in sources]
    names += [f"{bag.name}_{number}.mcap" for number in range(len(sources), len(rescued))]
    for file, name in zip(rescued, names, strict=False):
        text = text.replace(file.name, name)
        file.replace(bag / name)
    for source in sources[len(rescued) :]:  # what it held is in those before
        source.unlink()
    write_text(bag / METADATA_FILE, text)
    (rescue / METADATA_FILE).unlink()
    rescue.rmdir()
    return count


def _sources(bag: Path) -> list[Path]:
    """Return the files of a bag in the order in which they were written."""
    files = [bag] if bag.is_file() else sorted(bag.glob("*.mcap"), key=_number)
    if not files:
        raise OrthosisError(f"{bag}: expected .mcap files to recover, found none")
    return files


def _number(file: Path) -> tuple[int, str]:
    """Return the number behind the last underscore of a file's name, and the name."""
    digits = file.stem.rpartition("_")[2]
    return int(digits) if digits.isdecimal() else 0, file.name


class _Known:
    """What is found in a first pass: run metadata, topics by channel of each file, numbers of messages.

    Channels may be told behind their messages, in the summary at the end of a file, if the chunk that told
    them is lost.
    """

    def __init__(self, sources: Sequence[Salvage]):
        self.run: dict[str, str] = {}
        self.topics: list[dict[int, tuple[Channel, Schema]]] = []
        self.messages = self.copied = 0
        for source in sources:
            self._look_through(source)

    def _look_through(self, source: Salvage) -> None:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        counts: dict[int, int] = {}
        for record in source.records():
            if isinstance(record, Message):
                counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
            elif isinstance(record, Schema):
                schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                channels.setdefault(record.id, record)
            elif isinstance(record, Metadata) and record.name == RUN_RECORD:
                self.run = self.run or dict(record.metadata)
        told = {
            number: (one, schemas[one.schema_id])
            for number, one in channels.items()
            if one.schema_id in schemas
        }
        self.topics.append({number: one for number, one in told.items() if _of_ros(*one)})
        self.messages += sum(counts.values())
        self.copied += sum(count for number, count in counts.items() if number in self.topics[-1])


def _of_ros(channel: Channel, schema: Schema) -> bool:
    return (channel.message_encoding, schema.encoding) == ENCODINGS


def _copy(source: Salvage, topics: dict[int, tuple[Channel, Schema]], writer: BagWriter) -> None:
    for channel, schema in topics.values():
        writer.add_channel(channel.topic, schema.name, schema.data, _metadata(channel))
    for record in source.records():
        if isinstance(record, Message) and record.channel_id in topics:
            writer.write(topics[record.channel_id][0].topic, record.log_time, record.data)


def _metadata(channel: Channel) -> dict[str, str]:
    """Return a channel's metadata, without qualities of service that cannot be read."""
    metadata = dict(channel.metadata)
    try:
        readable = isinstance(yaml.safe_load(metadata.get("offered_qos_profiles", "[]")), list)
    except yaml.YAMLError:
        readable = False
    return metadata if readable else {**metadata, "offered_qos_profiles": "[]"}


def _check_readable(bag: Path) -> None:
    """Let nothing remain that readers refuse: names and types have no checksum of their own."""
    try:
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            unseen = {connection.topic for connection in reader.connections if connection.msgcount}
            for connection, _, data in reader.messages():  # one of each: a long bag would take minutes
                if connection.topic in unseen:
                    reader.deserialize(data, connection.msgtype)
                    unseen.discard(connection.topic)
                if not unseen:
                    break
    except Exception as error:
        shutil.rmtree(bag)
        raise OrthosisError(
            f"what is left of the bag cannot be read ({error}); nothing was recovered"
        ) from error
