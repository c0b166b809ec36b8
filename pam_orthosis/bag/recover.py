# SPDX-License-Identifier: Apache-2.0
"""Make a readable bag of one whose recorder was killed."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader

from pam_orthosis.bag.record import METADATA_FILE, RUN_RECORD, BagWriter
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import write_text

_DAMAGE = (McapError, ValueError, struct.error, zstandard.ZstdError, KeyError, MemoryError)


def recover(bag: Path, out: Path) -> int:
    """Copy all whole messages of a damaged MCAP bag into a new, closed bag; return their number.

    Args:
        bag: folder with `.mcap` files, or a file.
        out: folder of the new bag.

    Raises:
        OrthosisError: no MCAP file there, nothing readable in it, or `out` holds a bag.
    """
    sources = _sources(Path(bag))
    if not any(isinstance(record, Message) for source in sources for record in _whole_records(source)):
        raise OrthosisError(f"{sources[0]} holds no readable message")
    with BagWriter(out, _run_record(sources[0])) as writer:
        count = sum(_copy(_whole_records(source), writer) for source in sources)
        if not count:
            raise OrthosisError(f"{sources[0]} holds no message of a ROS topic")
        return count


def recover_in_place(bag: Path) -> int:
    """Close the unfinished bag of a folder, keeping its name; return the number of messages."""
    sources = _sources(Path(bag))
    rescue = bag / "recovered"
    count = recover(bag, rescue)
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


def _whole_records(source: Path) -> Iterator[McapRecord]:
    """Yield the records of a file up to its end or its first damage."""
    try:
        with open(source, "rb") as stream:
            yield from StreamReader(stream, record_size_limit=source.stat().st_size).records
    except _DAMAGE:
        return


def _run_record(source: Path) -> dict[str, str]:
    for record in _whole_records(source):
        if isinstance(record, Metadata) and record.name == RUN_RECORD:
            return dict(record.metadata)
    return {}


def _copy(records: Iterator[McapRecord], writer: BagWriter) -> int:
    """Copy messages; those of a channel without a schema, which MCAP allows, are of no ROS topic."""
    schemas: dict[int, Schema] = {}
    topics: dict[int, str] = {}
    count = 0
    for record in records:
        if isinstance(record, Message) and record.channel_id in topics:
            writer.write(topics[record.channel_id], record.log_time, record.data)
            count += 1
        elif isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in topics and record.schema_id in schemas:
            topics[record.id] = record.topic
            schema = schemas[record.schema_id]
            writer.add_channel(record.topic, schema.name, schema.data, record.metadata)
    return count
