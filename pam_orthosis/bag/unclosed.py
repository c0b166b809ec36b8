# SPDX-License-Identifier: Apache-2.0
"""What is in a file of a bag whose recorder was killed.

Each whole chunk is followed by an index of its messages, which counts those of each channel: chunks are
unpacked for their checksums alone.
"""

import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
)
from mcap.stream_reader import get_chunk_data_stream

from pam_orthosis.bag.information import BAG_RECORD, RUN_RECORD, FileContent
from pam_orthosis.bag.salvage import OPCODES, Data, mapped, next_chunk
from pam_orthosis.bag.unpack import HEAD, MAGIC, MOST_BYTES, unpacked
from pam_orthosis.errors import OrthosisError

CHUNK_HEAD = struct.Struct("<QQQII")  # first and last log time, unpacked size, checksum, length of a name
INDEX_HEAD = struct.Struct("<HI")  # of a chunk's message index: channel, bytes of its entries
ENTRY_BYTES = 16  # of a message in it
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
            _check_chunks(data)
            if data[-len(MAGIC) :] == MAGIC and len(data) > len(MAGIC):
                return _closed(path)
            return _settled(_scanned(path, data), data)
    except OrthosisError:
        raise
    except Exception as error:  # damaged bytes make the readers raise anything
        raise Damaged(f"{path} is damaged ({error})") from error


def without_last_chunk(file: BagFile) -> BagFile:
    """Return what an unclosed file holds if it is cut before its last chunk."""
    with mapped(file.path) as data:
        last, _ = file.chunks.pop()
        file.end = last.chunk_start_offset
        return _settled(file, data)


def _closed(path: Path) -> BagFile:
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise Damaged(f"{path} has no summary")
        runs = [one.metadata for one in reader.iter_metadata() if one.name == RUN_RECORD]
    stored = summary.statistics
    return BagFile(
        path, None, summary.schemas, summary.channels, run=dict(*runs[:1]),
        counts=Counter(stored.channel_message_counts),
        first_ns=stored.message_start_time if stored.message_count else FOREVER_NS,
        last_ns=stored.message_end_time,
    )  # fmt: skip


def _scanned(path: Path, data: Data) -> BagFile:
    """Walk from record to record, up to the torn one or to the end that was being written."""
    file = BagFile(path)
    if not MAGIC.startswith(data[: len(MAGIC)]):
        raise Damaged(f"{path} does not begin as an MCAP file does")
    for opcode, at, end in _records(data):
        body = at + HEAD.size
        if opcode == Opcode.MESSAGE_INDEX:
            chunk, counts = file.chunks[-1]
            channel, size = INDEX_HEAD.unpack_from(data, body)
            chunk.message_index_offsets[channel] = at
            chunk.message_index_length += end - at
            counts[channel] = size // ENTRY_BYTES
        elif opcode == Opcode.CHUNK:
            file.chunks.append((_chunk_index(data, at, end), {}))
        elif opcode == Opcode.METADATA:
            stored = Metadata.read(_stream(data[body:end]))
            file.metadata.append(MetadataIndex(at, end - at, stored.name))
            file.run = file.run or (dict(stored.metadata) if stored.name == RUN_RECORD else {})
            if stored.name == BAG_RECORD:  # being closed, unless more follows (ros2 bag begins with one)
                continue
        elif opcode == Opcode.SCHEMA:
            _declare(file, Schema.read(_stream(data[body:end])))
        elif opcode == Opcode.CHANNEL:
            _declare(file, Channel.read(_stream(data[body:end])))
        elif opcode in CLOSING:
            break
        elif opcode != Opcode.HEADER:
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


def _check_chunks(data: Data) -> None:
    """Raise if the checksum of a whole chunk is wrong."""
    for opcode, at, end in _records(data):
        if opcode == Opcode.CHUNK:
            chunk = unpacked(Chunk.read(_stream(data[at + HEAD.size : end])))
            get_chunk_data_stream(chunk, validate_crc=True)


def _chunk_index(data: Data, at: int, end: int) -> ChunkIndex:
    first_ns, last_ns, unpacked, _, name_length = CHUNK_HEAD.unpack_from(data, at + HEAD.size)
    name_at = at + HEAD.size + CHUNK_HEAD.size
    name = bytes(data[name_at : name_at + name_length]).decode()
    packed = end - name_at - name_length - 8
    return ChunkIndex(end - at, at, name, packed, last_ns, 0, {}, first_ns, unpacked)


def _settled(file: BagFile, data: Data) -> BagFile:
    """Check the last chunk, index it anew (its index may be torn), sum up."""
    if file.chunks:
        _unpack(file, data, 0)
        chunk, counts = file.chunks[-1]
        file.index = _unpack(file, data, -1)
        file.end = chunk.chunk_start_offset + chunk.chunk_length
        chunk.message_index_offsets.clear()
        chunk.message_index_length = 0
        counts.clear()
        counts |= {channel: len(one.records) for channel, one in file.index.items()}
    file.metadata = [one for one in file.metadata if one.offset < (file.end or 0)]
    file.counts = Counter()
    for number, (_, counts) in enumerate(file.chunks):
        if not counts and _unpack(file, data, number):
            raise Damaged(f"{file.path}: messages without an index")
        file.counts.update(counts)
        _find_declared(file, data, number)
    if any(one.schema_id and one.schema_id not in file.schemas for one in file.channels.values()):
        raise Damaged(f"{file.path}: a channel's schema is missing")
    filled = [chunk for chunk, counts in file.chunks if counts]
    file.first_ns = min((chunk.message_start_time for chunk in filled), default=FOREVER_NS)
    file.last_ns = max((chunk.message_end_time for chunk in filled), default=0)
    return file


def _find_declared(file: BagFile, data: Data, number: int) -> None:
    """Look for channels that a chunk has messages of: they are declared in it or before."""
    for earlier in range(number, -1, -1):
        if file.chunks[number][1].keys() <= file.channels.keys():
            return
        _unpack(file, data, earlier)
    raise Damaged(f"{file.path}: a channel is nowhere declared")


def _unpack(file: BagFile, data: Data, number: int) -> dict[int, MessageIndex]:
    """Check and unpack a chunk; note what it declares, return the index of its messages."""
    there = file.chunks[number][0]
    begin = there.chunk_start_offset + HEAD.size
    chunk = unpacked(Chunk.read(_stream(data[begin : there.chunk_start_offset + there.chunk_length])))
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    index: dict[int, MessageIndex] = {}
    while stream.count < size:
        at = stream.count
        opcode, length = HEAD.unpack(stream.read(HEAD.size))
        if opcode == Opcode.MESSAGE:
            message = Message.read(stream, length)
            one = index.setdefault(message.channel_id, MessageIndex(message.channel_id, []))
            one.records.append((message.log_time, at))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _declare(file, (Schema if opcode == Opcode.SCHEMA else Channel).read(stream))
        else:
            stream.read(length)
    return index


def _declare(file: BagFile, record: Schema | Channel) -> None:
    if isinstance(record, Schema):
        file.schemas.setdefault(record.id, record)
    else:
        file.channels.setdefault(record.id, record)


def _stream(data: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(data))
