# SPDX-License-Identifier: Apache-2.0
"""Records and chunks of bags within bounds: what a file says of its sizes is not trusted."""

import io
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import BinaryIO, NamedTuple

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Chunk, Metadata

from pam_orthosis.reading import open_file

MOST_BYTES = 256 << 20  # of a record, of a message, of what a chunk unpacks to
MOST_WINDOW = 128 << 20  # bytes that zstd may look back
MOST_GROWTH = 50  # times its size on the disk that a bag may unpack to, beside MOST_BYTES: noise packs badly
MOST_CHANNELS = 10_000  # of a bag
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of a record: opcode, length of what follows
UNPACKED = struct.Struct("<Q")  # at UNPACKED_AT of a chunk: what it unpacks to, bytes
UNPACKED_AT = 16


class Record(NamedTuple):
    """Where a record of an MCAP file is: its opcode, where its content begins, the content's length."""

    opcode: int
    at: int
    length: int


@dataclass
class Allowance:
    """What is left of what a bag may unpack to, bytes, and of its channels."""

    size: int
    channels: int = MOST_CHANNELS


_ALLOWANCE: ContextVar[Allowance | None] = ContextVar("allowance", default=None)


@contextmanager
def allowed(size: int) -> Iterator[None]:
    """Bound what is unpacked here, all in all, by what a bag takes on the disk, bytes."""
    before = _ALLOWANCE.set(Allowance(MOST_BYTES + MOST_GROWTH * size))
    try:
        yield
    finally:
        _ALLOWANCE.reset(before)


def metadata_records(path: Path) -> Iterator[Metadata]:
    """Yield the metadata records of an MCAP file; OrthosisError if it is none, ValueError if damaged."""
    with Limited(open_file(path)) as stream:
        for record in records_of(stream):
            if record.opcode == Opcode.METADATA:
                stream.seek(record.at)
                yield Metadata.read(ReadDataStream(io.BytesIO(stream.read(record.length))))


def unpacked(chunk: Chunk) -> Chunk:
    """Return a chunk without its compression; ValueError if it is not what it says, or too large."""
    data = unpacked_bytes(chunk.compression, chunk.data, chunk.uncompressed_size)
    return replace(chunk, compression="", data=data)


class Limited(io.BufferedReader):
    """Bytes of a file, of which no more than a record's are read at once."""

    def __init__(self, stream: BinaryIO):
        super().__init__(stream.detach())  # type: ignore[attr-defined]

    def read(self, size: int | None = -1, /) -> bytes:
        """Return bytes; ValueError if they are too many."""
        size = -1 if size is None else size
        if size > MOST_BYTES:
            raise ValueError(f"a record of {_told(size)}; at most {_told(MOST_BYTES)} are read")
        data = super().read(MOST_BYTES + 1 if size < 0 else size)
        if len(data) > MOST_BYTES:
            raise ValueError(f"a record of more than {_told(MOST_BYTES)}")
        return data


def records_of(stream: BinaryIO) -> Iterator[Record]:
    """Yield the records of an MCAP file up to its footer; ValueError if it is damaged or too large."""
    size, at, summary = stream.seek(0, os.SEEK_END), len(MAGIC), 0
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("it does not begin as an MCAP file")
    while True:
        stream.seek(at)
        head = stream.read(HEAD.size)
        if len(head) < HEAD.size:
            raise ValueError("it has no end")
        record = Record(head[0], at + HEAD.size, HEAD.unpack(head)[1])
        _check_record(stream, record, size)
        if record.opcode == Opcode.FOOTER:
            (frame_size,) = UNPACKED.unpack(stream.read(UNPACKED.size))
            if frame_size not in (0, summary):
                raise ValueError("its summary is not where its footer says")
            return
        yield record
        at = record.at + record.length
        summary = at if record.opcode == Opcode.DATA_END else summary


def _check_record(stream: BinaryIO, record: Record, size: int) -> None:
    """Check a record whose content the stream is at."""
    if not record.opcode or record.at + record.length > size:
        raise ValueError(f"no record begins at byte {record.at - HEAD.size}")
    if record.length > MOST_BYTES and record.opcode != Opcode.ATTACHMENT:
        raise ValueError(
            f"a record of {_told(record.length)} at byte {record.at - HEAD.size}; at most {_told(MOST_BYTES)}"
            " are read"
        )
    if record.opcode == Opcode.CHUNK and record.length >= UNPACKED_AT + UNPACKED.size:
        stream.seek(UNPACKED_AT, os.SEEK_CUR)
        _check_unpacked(*UNPACKED.unpack(stream.read(UNPACKED.size)))


def _check_unpacked(size: int) -> None:
    if size > MOST_BYTES:
        raise ValueError(f"a chunk that unpacks to {_told(size)}; at most {_told(MOST_BYTES)} are unpacked")


def unpacked_bytes(compression: str, data: bytes, size: int) -> bytes:
    """Return a chunk's records; ValueError if they are not of the size that it says, or too many."""
    _check_unpacked(size)
    if compression == "zstd":
        with zstandard.ZstdDecompressor(max_window_size=MOST_WINDOW).stream_reader(
            data, read_across_frames=True
        ) as packed:
            raw = packed.read(size + 1)
    elif compression == "lz4":
        raw = LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif not compression:
        raw = data
    else:
        raise ValueError(f"a chunk's compression {compression[:20]!r} is unknown")
    if len(raw) != size:
        raise ValueError("a chunk unpacks to another size than it says")
    take(len(raw) if compression else 0, _channels(raw))
    return raw


def _channels(raw: bytes) -> int:
    """Return the number of channels among a chunk's records; ValueError if these are none, or too many."""
    at = count = channels = 0
    while at < len(raw):
        if at + HEAD.size > len(raw) or not raw[at]:
            raise ValueError("a chunk holds what is no record")
        opcode, length = HEAD.unpack_from(raw, at)
        at += HEAD.size + length
        count += 1
        channels += opcode == Opcode.CHANNEL
        if count > 1_000_000:
            raise ValueError("a chunk of more than 1000000 records")
    return channels


def unpacked_message(data: bytes) -> bytes:
    """Return a message packed by zstd; ValueError if it, or all that was unpacked, is too large."""
    size = zstandard.frame_content_size(data)  # negative if it does not say
    _check_unpacked(size)
    with zstandard.ZstdDecompressor(max_window_size=MOST_WINDOW).stream_reader(data) as packed:
        raw = packed.read((MOST_BYTES if size < 0 else size) + 1)
    _check_unpacked(len(raw))
    take(len(raw))
    return raw


@contextmanager
def unpacked_file(stream: BinaryIO, _mode: str) -> Iterator[SimpleNamespace]:
    """Open a compressed file for reading parts of what it unpacks to."""

    def read(size: int) -> bytes:
        data = packed.read(size)
        take(len(data))
        return data

    decompressor = zstandard.ZstdDecompressor(max_window_size=MOST_WINDOW)
    with decompressor.stream_reader(stream, read_across_frames=True) as packed:
        yield SimpleNamespace(read=read)


def take(size: int, channels: int = 0) -> None:
    """Take from the allowance, if there is one; ValueError if it is used up."""
    if (left := _ALLOWANCE.get()) is None:
        return
    left.size -= size
    left.channels -= channels
    if left.size < 0:
        raise ValueError(f"it unpacks to more than {MOST_GROWTH} times its size")
    if left.channels < 0:
        raise ValueError(f"it has more than {MOST_CHANNELS} channels")


def _told(size: int) -> str:
    return f"{size / (1 << 30):.1f} GiB" if size >= 1 << 30 else f"{size / (1 << 20):.0f} MiB"
