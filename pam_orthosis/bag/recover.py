# SPDX-License-Identifier: Apache-2.0
"""Save what is whole of a bag that is damaged, or whose recorder was killed."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from mcap.records import Channel, Message, Metadata, Schema
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import parse_qos

from pam_orthosis.bag.close import close_bag
from pam_orthosis.bag.information import NO_TYPE, RUN_RECORD, refusal
from pam_orthosis.bag.record import BagWriter, Declared
from pam_orthosis.bag.salvage import Loss, Salvage
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import filled
from pam_orthosis.progress import Progress, part, silent
from pam_orthosis.reading import check_file, from_yaml

QOS = "offered_qos_profiles"


class LeftOut(NamedTuple):
    """A topic whose messages were not copied, how many there are, and why."""

    topic: str
    messages: int
    why: str


@dataclass(frozen=True)
class Recovered:
    """What came of a bag: messages that were copied, topics that were not, what is lost."""

    messages: int
    left_out: tuple[LeftOut, ...]
    lost: tuple[Loss, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data for JSON."""
        return {
            "messages": self.messages,
            "left_out": [one._asdict() for one in self.left_out],
            "lost": [one._asdict() for one in self.lost],
        }


def recover(bag: Path, out: Path, progress: Progress = silent) -> Recovered:
    """Copy all whole messages of a damaged MCAP bag, as bytes, into a new, closed bag.

    A chunk of messages is whole if its checksum is right; those behind a damaged one are copied too. A topic
    is left out only if one of it would keep readers from the whole bag. The folder of the new bag is there
    with all of it in the end, or as it was.

    Raises:
        OrthosisError: no MCAP file there, nothing readable in it, or `out` is used.
    """
    sources = [Salvage(file) for file in _sources(bag)]
    with filled(out) as folder:
        recovered = _copied(sources, folder, progress)
        _check_readable(folder)
    return recovered


def _copied(sources: Sequence[Salvage], folder: Path, progress: Progress) -> Recovered:
    looks, copies = _passes(sources, progress)
    found = [_Found(source, look) for source, look in zip(sources, looks, strict=True)]
    left_out = tuple(one for each in found for one in each.left_out())
    messages = sum(each.counts.total() for each in found)
    if not messages:
        raise OrthosisError(f"{sources[0].source} holds no readable message")
    messages -= sum(one.messages for one in left_out)
    if not messages:
        raise OrthosisError(f"{sources[0].source} holds no message of a ROS topic ({left_out[0].why})")
    run = next((each.run for each in found if each.run), {})
    with BagWriter(folder, run) as writer:
        for source, each, report in zip(sources, found, copies, strict=True):
            _copy(source, each, writer, report)
    return Recovered(messages, left_out, tuple(loss for source in sources for loss in source.lost))


def _passes(sources: Sequence[Salvage], progress: Progress) -> tuple[list[Progress], list[Progress]]:
    """Return the progress of each file's reading: first what is in it is looked for, then it is copied."""
    sizes = [source.source.stat().st_size / 1e6 for source in sources]
    whole, begins = sum(sizes), [sum(sizes[:number]) for number in range(len(sizes))]
    places = list(zip(begins, sizes, strict=True))

    def passed(what: str, start: float) -> list[Progress]:
        return [part(progress, what, start + at, size, 2 * whole, " MB") for at, size in places]

    return passed("looking for what is whole", 0.0), passed("copying what is whole", whole)


def recover_in_place(bag: Path) -> int:
    """Close a bag whose recorder was killed, where it is, as `close_bag`; return the number of messages."""
    if not bag.is_dir():
        raise OrthosisError(f"{bag} is no folder of a bag: it cannot be closed in place")
    return close_bag(bag, _sources(bag))


def _sources(bag: Path) -> list[Path]:
    """Return the files of a bag in the order in which they were written."""
    files = [bag] if bag.is_file() else sorted(bag.glob("*.mcap"), key=_number)
    if not files:
        raise OrthosisError(f"{bag}: expected .mcap files to recover, found none")
    for file in files:
        check_file(file)
    return files


def _number(file: Path) -> tuple[int, str]:
    """Return the number behind the last underscore of a file's name, and the name."""
    digits = file.stem.rpartition("_")[2]
    return int(digits) if digits.isdecimal() else 0, file.name


class _Found:
    """What is found in a first pass: run metadata, channels with their schemas, numbers of messages.

    Channels may be described behind their messages, in the summary at the end of a file, if the chunk that
    described them is lost.
    """

    def __init__(self, source: Salvage, progress: Progress):
        self.run: dict[str, str] = {}
        self.counts: Counter[int] = Counter()
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        for record in source.records(progress):
            if isinstance(record, Message):
                self.counts[record.channel_id] += 1
            elif isinstance(record, Schema):
                self._schemas.setdefault(record.id, record)
            elif isinstance(record, Channel):
                self._channels.setdefault(record.id, record)
            elif isinstance(record, Metadata) and record.name == RUN_RECORD:
                self.run = self.run or dict(record.metadata)

    def declared(self) -> dict[int, Declared]:
        """Return the channels that are copied."""
        return {number: self._declared(number) for number in self._channels if not self._refused(number)}

    def left_out(self) -> list[LeftOut]:
        """Return the channels with messages that are not copied."""
        return [
            LeftOut(self._channels[number].topic if number in self._channels else "?", count, why)
            for number, count in self.counts.items()
            if (why := self._refused(number))
        ]

    def _declared(self, number: int) -> Declared:
        channel = self._channels[number]
        metadata = _metadata(channel)
        schema = self._schemas.get(channel.schema_id) if channel.schema_id else None
        if schema is None:
            return Declared(channel.topic, NO_TYPE, None, b"", metadata)
        return Declared(channel.topic, schema.name, schema.encoding, schema.data, metadata)

    def _refused(self, number: int) -> str:
        """Return why messages of a channel cannot be copied; nothing if they can."""
        if number not in self._channels:
            return f"channel {number} is nowhere declared"
        return refusal(self._channels[number], self._schemas)


def _copy(source: Salvage, found: _Found, writer: BagWriter, progress: Progress) -> None:
    channels = found.declared()
    keys = {number: (*one[:-1], *sorted(one.metadata.items())) for number, one in channels.items()}
    for number, one in channels.items():
        writer.add_channel(keys[number], one)
    for record in source.records(progress):
        if isinstance(record, Message) and record.channel_id in channels:
            writer.copy(keys[record.channel_id], record)


def _metadata(channel: Channel) -> dict[str, str]:
    """Return a channel's metadata, without qualities of service that cannot be read."""
    metadata = dict(channel.metadata)
    try:
        text = metadata.get(QOS, "[]")
        readable = isinstance(from_yaml(text, channel.topic), list)
        parse_qos(text)
    except Exception:  # readers raise anything
        readable = False
    return metadata if readable else {**metadata, QOS: "[]"}


def _check_readable(bag: Path) -> None:
    """Let nothing remain that readers refuse."""
    try:
        with Reader(bag) as reader:
            next(reader.messages())
    except Exception as error:
        raise OrthosisError(f"what is left of the bag cannot be read ({error})") from error
