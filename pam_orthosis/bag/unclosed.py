# SPDX-License-Identifier: Apache-2.0
"""What is in a file of a bag whose recorder was killed.

Each chunk is unpacked once: for its checksum, and for what is in it.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, MessageIndex, Metadata, MetadataIndex, Schema
from mcap.stream_reader import get_chunk_data_stream

from pam_orthosis.bag.information import BAG_RECORD, RUN_RECORD, FileContent
from pam_orthosis.bag.salvage import OPCODES, Data, mapped, next_chunk
from pam_orthosis.bag.unpack import HEAD, MAGIC, MOST_BYTES, unpacked
from pam_orthosis.errors import OrthosisError

CHANNEL = struct.Struct("<H")  # with which a message index begins
MESSAGE_HEAD = struct.Struct("<HIQ")  # channel, number in it, log time
CLOSING = (Opcode.DATA_END, Opcode.FOOTER)
FOREVER_NS = 2**63 - 1


class Damaged(OrthosisError):
    """More is missing of a file than its end."""


@dataclass
class BagFile:
    """What a file of a bag holds.

    Attributes:
        end: where its last whole chunk ends, or what comes before the first; None if the file is closed.
        chunks: each with the number of its messages by channel.
        index: of the messages in the last chunk.
    """

    path: Path
    end: int | None = 0
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[tuple[ChunkIndex, dict[int, int]]] = field(default_factory=list)
    index: dict[int, MessageIndex] = field(default_factory=dict)
    metadata: list[MetadataIndex] = field(default_factory=list)
    run: dict[str, str] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    first_ns: int = FOREVER_NS
    last_ns: int = 0

    def content(self) -> FileContent:
        """Return how many messages it holds, and from when to when."""
        return FileContent(self.path.name, self.counts.total(), self.first_ns, self.last_ns)


def look(path: Path) -> BagFile:
    """Return what a file holds, closed or not; Damaged if more is missing than its end."""
    try:
        with mapped(path) as data:
            file = _summed_up(_scanned(path, data))
            if data[-len(MAGIC) :] == MAGIC and len(data) > len(MAGIC):
                file.end = None
            return file
    except OrthosisError:
        raise
    except Exception as error:  # damaged bytes make the readers raise anything
        raise Damaged(f"{path} is damaged ({error})") from error


def without_last_chunk(file: BagFile) -> BagFile:
    """Return what an unclosed file holds if it is cut before its last chunk."""
    file.end = file.chunks.pop()[0].chunk_start_offset
    last, _ = file.chunks[-1]
    begin = last.chunk_start_offset + HEAD.size
    with mapped(file.path) as data:
        content = data[begin : last.chunk_start_offset + last.chunk_length]
    file.index = _indexed(file, Chunk.read(_stream(content)))
    return _summed_up(file)


def _scanned(path: Path, data: Data) -> BagFile:
    """Walk from record to record, up to the torn one or to the end that was being written."""
    file, closing = BagFile(path), False
    if not MAGIC.startswith(data[: len(MAGIC)]):
        raise Damaged(f"{path} does not begin as an MCAP file does")
    for opcode, at, end in _records(data):
        closing = closing or opcode in CLOSING
        if closing:
            continue
        content = data[at + HEAD.size : end]
        if opcode == Opcode.CHUNK:
            _add_chunk(file, Chunk.read(_stream(content)), at, end)
        elif opcode == Opcode.MESSAGE_INDEX:
            chunk, _ = file.chunks[-1]
            chunk.message_index_offsets[CHANNEL.unpack_from(content)[0]] = at
            chunk.message_index_length += end - at
        elif opcode == Opcode.METADATA:
            stored = Metadata.read(_stream(content))
            file.metadata.append(MetadataIndex(at, end - at, stored.name))
            if stored.name == BAG_RECORD:  # being closed, unless more follows (ros2 bag begins with one)
                continue
            file.run = file.run or (dict(stored.metadata) if stored.name == RUN_RECORD else {})
        elif opcode != Opcode.HEADER and not _declares(file, opcode, content):
            raise Damaged(f"{path}: messages outside of chunks, or attachments")
        file.end = end
    return file


def _records(data: Data) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, beginning and end of each whole record."""
    at, size = len(MAGIC), len(data)
    while at + HEAD.size <= size:
        opcode, length = HEAD.unpack_from(data, at)
        end = at + HEAD.size + length
        torn = end > size
        if length > MOST_BYTES or opcode not in OPCODES or (torn and next_chunk(data, size, at + 1) < size):
            raise Damaged(f"no whole record at byte {at}, and more behind it")
        if torn:
            return
        yield opcode, at, end
        at = end


def _add_chunk(file: BagFile, chunk: Chunk, at: int, end: int) -> None:
    file.index = _indexed(file, chunk)
    counts = {channel: len(one.records) for channel, one in file.index.items()}
    if not counts.keys() <= file.channels.keys():
        raise Damaged(f"{file.path}: a channel is nowhere declared")
    there = ChunkIndex(
        chunk_length=end - at, chunk_start_offset=at, compression=chunk.compression,
        compressed_size=len(chunk.data), message_end_time=chunk.message_end_time, message_index_length=0,
        message_index_offsets={}, message_start_time=chunk.message_start_time,
        uncompressed_size=chunk.uncompressed_size,
    )  # fmt: skip
    file.chunks.append((there, counts))


def _indexed(file: BagFile, chunk: Chunk) -> dict[int, MessageIndex]:
    """Check and unpack a chunk; note what it declares, return the index of its messages."""
    stream, size = get_chunk_data_stream(unpacked(chunk), validate_crc=True)
    records, at = stream.read(size), 0
    index: dict[int, MessageIndex] = {}
    while at < size:
        opcode, length = HEAD.unpack_from(records, at)
        content = at + HEAD.size
        if opcode == Opcode.MESSAGE:
            channel, _, log_ns = MESSAGE_HEAD.unpack_from(records, content)
            index.setdefault(channel, MessageIndex(channel, [])).records.append((log_ns, at))
        else:
            _declares(file, opcode, records[content : content + length])
        at = content + length
    return index


def _declares(file: BagFile, opcode: int, content: bytes) -> bool:
    """Return whether a record is a schema or a channel, which are noted."""
    if opcode == Opcode.SCHEMA:
        schema = Schema.read(_stream(content))
        file.schemas.setdefault(schema.id, schema)
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(_stream(content))
        file.channels.setdefault(channel.id, channel)
    return opcode in (Opcode.SCHEMA, Opcode.CHANNEL)


def _summed_up(file: BagFile) -> BagFile:
    """Check what there is, and sum up; the last chunk is indexed anew: its index may be torn."""
    if file.chunks:
        last, _ = file.chunks[-1]
        file.end = last.chunk_start_offset + last.chunk_length
        last.message_index_offsets.clear()
        last.message_index_length = 0
    file.metadata = [one for one in file.metadata if one.offset < (file.end or 0)]
    if any(counts.keys() > chunk.message_index_offsets.keys() for chunk, counts in file.chunks[:-1]):
        raise Damaged(f"{file.path}: messages without an index")
    if any(one.schema_id and one.schema_id not in file.schemas for one in file.channels.values()):
        raise Damaged(f"{file.path}: a channel's schema is missing")
    file.counts = Counter()
    for _, counts in file.chunks:
        file.counts.update(counts)
    filled = [chunk for chunk, counts in file.chunks if counts]
    file.first_ns = min((chunk.message_start_time for chunk in filled), default=FOREVER_NS)
    file.last_ns = max((chunk.message_end_time for chunk in filled), default=0)
    return file


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
