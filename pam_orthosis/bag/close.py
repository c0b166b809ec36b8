# SPDX-License-Identifier: Apache-2.0
"""Close a bag whose recorder was killed, where it is: cut behind the last whole chunk, add what is missing.

No message is copied, so it is quick, and needs next to no room. On a full disk the torn end
makes room; if that is too little the file gets no summary (readers go through it then), and if that is
too little, too, its last chunk makes room: never more than what is added needs.
"""

import errno
import fcntl
import os
import struct
import time
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, BinaryIO

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import DataEnd, Footer, Header, Metadata, MetadataIndex, Statistics, SummaryOffset

from pam_orthosis import __version__
from pam_orthosis.bag.information import (
    BAG_RECORD,
    METADATA_FILE,
    NO_TYPE,
    information,
    metadata_text,
    serialised,
    topic_row,
)
from pam_orthosis.bag.unclosed import BagFile, Damaged, look, without_last_chunk
from pam_orthosis.bag.unpack import MAGIC
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import write_text, writing
from pam_orthosis.reading import open_file

FOOTER_HEAD = struct.Struct("<BQQQ")  # opcode, length, where summary and its offsets begin
NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
WRITER_SECONDS = 5.0  # for a bag writer whose recorder was killed


def close_bag(folder: Path, paths: Sequence[Path]) -> int:
    """Close the unfinished bag of a folder, of files in the order of their writing; return its messages.

    Raises:
        Damaged: more is missing than the end of files; nothing was changed.
        OrthosisError: it holds nothing or cannot be written.
    """
    for path in paths:
        _check_at_rest(path)
    files = [look(path) for path in paths]
    if (folder / METADATA_FILE).exists():
        if any(file.end is not None for file in files):
            raise Damaged(f"{folder} was closed, and a file of it has no end")
        return sum(file.counts.total() for file in files)
    if not any(file.counts for file in files):
        raise OrthosisError(f"{paths[0]} holds no readable message")
    with writing(folder), TemporaryFile(dir=folder):  # before anything is cut
        pass
    if not _written_at_all(folder, files):
        _make_room(folder, files)
    return sum(file.counts.total() for file in files)


def _check_at_rest(path: Path) -> None:
    """Wait for a writer that is left behind to end; OrthosisError if the file is still being written."""
    until = time.monotonic() + WRITER_SECONDS
    with open_file(path) as stream:
        while _being_written(stream):
            if time.monotonic() > until:
                raise OrthosisError(f"{path} is being written; wait until its recorder has ended")
            time.sleep(0.05)


def _being_written(stream: BinaryIO) -> bool:
    """Return whether a process has a file open for writing: a lease is refused then."""
    try:
        fcntl.fcntl(stream, fcntl.F_SETLEASE, fcntl.F_RDLCK)
        fcntl.fcntl(stream, fcntl.F_SETLEASE, fcntl.F_UNLCK)
    except BlockingIOError:
        return True
    except OSError:  # on a file system without leases
        return False
    return False


def _written_at_all(folder: Path, files: Sequence[BagFile]) -> bool:
    return _written(folder, files, brief=False) or _written(folder, files, brief=True)


def _make_room(folder: Path, files: Sequence[BagFile]) -> None:
    """Cut off as many chunks as the end needs room; OrthosisError if it has none even then."""
    last = next((file for file in reversed(files) if file.end is not None), None)
    missing = len(metadata_text(_information(files))) + 2 * 4096  # blocks of a file and its folder
    while last and missing > 0 and len(last.chunks) > 1:
        missing -= (last.end or 0) - last.chunks[-1][0].chunk_start_offset
        without_last_chunk(last)
        if _written_at_all(folder, files):
            return
    raise OrthosisError(f"cannot write {folder}: No space left on device")


def _written(folder: Path, files: Sequence[BagFile], brief: bool) -> bool:
    """Write the ends of files and `metadata.yaml`; return whether there was room."""
    about = _information(files)
    try:
        for file in files:
            if file.end is not None:
                _put_end(file, about, brief)
        write_text(folder / METADATA_FILE, metadata_text(about))
    except OrthosisError as error:
        number = getattr(error.__cause__, "errno", None)
        if number in NO_ROOM or (number == errno.EFBIG and not brief):
            return False
        raise
    return True


def _put_end(file: BagFile, about: Mapping[str, Any], brief: bool) -> None:
    begin = b"" if file.end else MAGIC + _header()
    end = begin + (_brief_end() if brief else _end(file, len(begin), about))
    with writing(file.path), open(file.path, "r+b", buffering=0, opener=_no_link) as stream:
        stream.truncate(file.end)
        stream.seek(0, os.SEEK_END)
        while end:
            end = end[stream.write(end) :]
        os.fsync(stream.fileno())


def _no_link(name: str, flags: int) -> int:
    return os.open(name, flags | os.O_NOFOLLOW)


def _header() -> bytes:
    builder = RecordBuilder()
    Header("ros2", f"pam_orthosis {__version__}").write(builder)
    return bytes(builder.end())


def _brief_end() -> bytes:
    builder = RecordBuilder()
    DataEnd(0).write(builder)
    Footer(0, 0, 0).write(builder)
    return bytes(builder.end()) + MAGIC


def _end(file: BagFile, shift: int, about: Mapping[str, Any]) -> bytes:
    """Return what the writer of an MCAP file would add behind its last chunk."""
    builder, begin = RecordBuilder(), (file.end or 0) + shift
    for channel, index in file.index.items():
        chunk = file.chunks[-1][0]
        chunk.message_index_offsets[channel] = begin + builder.count
        index.write(builder)
        chunk.message_index_length = builder.count
    bag_record = begin + builder.count
    Metadata(BAG_RECORD, serialised(about)).write(builder)
    metadata = [*file.metadata, MetadataIndex(bag_record, begin + builder.count - bag_record, BAG_RECORD)]
    DataEnd(0).write(builder)
    data = bytes(builder.end())
    return data + _summary(file, metadata, begin + len(data))


def _summary(file: BagFile, metadata: Sequence[MetadataIndex], begin: int) -> bytes:
    """Return summary and footer, the former beginning at a byte of the file."""
    statistics = Statistics(
        attachment_count=0, channel_count=len(file.channels), channel_message_counts=file.counts,
        chunk_count=len(file.chunks), message_count=file.counts.total(), message_end_time=file.last_ns,
        message_start_time=file.first_ns if file.counts else 0, metadata_count=len(metadata),
        schema_count=len(file.schemas),
    )  # fmt: skip
    groups = {
        Opcode.SCHEMA: file.schemas.values(),
        Opcode.CHANNEL: file.channels.values(),
        Opcode.STATISTICS: [statistics],
        Opcode.CHUNK_INDEX: [chunk for chunk, _ in file.chunks],
        Opcode.ATTACHMENT_INDEX: [],
        Opcode.METADATA_INDEX: metadata,
    }
    builder, offsets = RecordBuilder(), []
    for opcode, records in groups.items():
        group = builder.count
        for record in records:
            record.write(builder)
        offsets.append(SummaryOffset(opcode, begin + group, builder.count - group))
    offsets_begin = begin + builder.count
    for offset in offsets:
        offset.write(builder)
    summary = bytes(builder.end())
    head = FOOTER_HEAD.pack(Opcode.FOOTER, 20, begin, offsets_begin)
    Footer(begin, offsets_begin, zlib.crc32(head, zlib.crc32(summary))).write(builder)
    return summary + bytes(builder.end()) + MAGIC


def _information(files: Sequence[BagFile]) -> dict[str, Any]:
    """Return what `metadata.yaml` holds; a topic has one row in all files."""
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    counts: Counter[tuple[str, str]] = Counter()
    for file in files:
        for channel in file.channels.values():
            msgtype = file.schemas[channel.schema_id].name if channel.schema_id else NO_TYPE
            key = channel.topic, msgtype
            rows.setdefault(key, topic_row(*key, channel.metadata))
            counts[key] += file.counts[channel.id]
    run = next((file.run for file in files if file.run), {})
    content = [file.content() for file in files]
    return information(content, [(row, counts[key]) for key, row in rows.items()], run)
