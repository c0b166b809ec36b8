# SPDX-License-Identifier: Apache-2.0
"""The whole records of a damaged MCAP file, and what had to be skipped."""

import mmap
import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import breakup_chunk

from pam_orthosis.bag.unpack import HEAD, MAGIC, MOST_BYTES, unpacked
from pam_orthosis.progress import Progress, silent
from pam_orthosis.reading import open_file

TIMES = struct.Struct("<QQ")  # at the beginning of a chunk: first and last log time, ns
LEAST_CHUNK = 40  # bytes; 28 stand before the name of its compression
COMPRESSIONS = (b"", b"lz4", b"zstd")
OPCODES = range(Opcode.HEADER, Opcode.DATA_END + 1)


Data = mmap.mmap | bytes


class Loss(NamedTuple):
    """A part of a file that could not be read: bytes, and log times of its messages, ns, if it holds them."""

    size: int
    first_ns: int | None
    last_ns: int | None


@contextmanager
def mapped(source: Path) -> Iterator[Data]:
    """Yield the bytes of a file, which are read when they are looked at; OSError if that is not possible."""
    with open_file(source) as stream:
        if not os.fstat(stream.fileno()).st_size:  # nothing can be mapped
            yield b""
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            yield data


class Salvage:
    """Reads past damage: a chunk is whole if its checksum is right; behind a bad one the next is looked for.

    `lost` is what was skipped, once the records have been read to their end.
    """

    def __init__(self, source: Path):
        self.source = source
        self.lost: list[Loss] = []

    def records(self, progress: Progress = silent) -> Iterator[McapRecord]:
        """Yield schemas, channels, messages and metadata; OSError if the file cannot be read.

        `progress` is called with each byte at which one is looked for.
        """
        self.lost.clear()
        with mapped(self.source) as data:
            yield from self._records(data, len(data), progress)

    def _records(self, data: Data, size: int, progress: Progress) -> Iterator[McapRecord]:
        at = len(MAGIC)
        while at < size:
            progress("reading", at, size)
            try:
                end, opcode, found = read_record(data, size, at)
            except Exception:  # damaged bytes make the readers raise anything
                end = _behind_too_large(data, size, at) or next_chunk(data, size, at + 1)
                self.lost.append(_loss(data, at, end))
                at = end
                continue
            yield from found
            at = size if opcode == Opcode.FOOTER else end


def read_record(data: Data, size: int, at: int) -> tuple[int, int, list[McapRecord]]:
    """Return the end of a record, its opcode and what is in it; raise if it is not whole."""
    opcode, length = HEAD.unpack_from(data, at)
    begin, end = at + HEAD.size, at + HEAD.size + length
    if opcode not in OPCODES or end > size:
        raise ValueError("no record begins here")
    if length > MOST_BYTES:
        raise ValueError("a record that is too large")
    stream = ReadDataStream(BytesIO(data[begin:end])) if opcode in READERS else None
    return end, opcode, READERS[opcode](stream, length) if stream else []


def _behind_too_large(data: Data, size: int, at: int) -> int:
    """Return the end of a record that is too large to be read but has another behind it, else 0."""
    if at + HEAD.size > size:
        return 0
    opcode, length = HEAD.unpack_from(data, at)
    end = at + HEAD.size + length
    whole = opcode in OPCODES and length > MOST_BYTES and end < size and data[end] in OPCODES
    return end if whole else 0


READERS: dict[Opcode, Callable[[ReadDataStream, int], list[Any]]] = {
    Opcode.SCHEMA: lambda stream, _: [Schema.read(stream)],
    Opcode.CHANNEL: lambda stream, _: [Channel.read(stream)],
    Opcode.MESSAGE: lambda stream, length: [Message.read(stream, length)],
    Opcode.METADATA: lambda stream, _: [Metadata.read(stream)],
    Opcode.CHUNK: lambda stream, _: breakup_chunk(unpacked(Chunk.read(stream)), validate_crc=True),
}


def next_chunk(data: Data, size: int, start: int) -> int:
    """Return where the next whole chunk begins, or the end of the file."""
    at = data.find(bytes([Opcode.CHUNK]), start)
    while at >= 0:
        if _like_a_chunk(data, size, at):
            with suppress(Exception):
                read_record(data, size, at)
                return at
        at = data.find(bytes([Opcode.CHUNK]), at + 1)
    return size


def _like_a_chunk(data: Data, size: int, at: int) -> bool:
    if at + HEAD.size + LEAST_CHUNK > size:
        return False
    _, length = HEAD.unpack_from(data, at)
    name_at = at + HEAD.size + 28
    (name_length,) = struct.unpack_from("<I", data, name_at)
    if length < LEAST_CHUNK or at + HEAD.size + length > size or name_length > max(map(len, COMPRESSIONS)):
        return False
    (content,) = struct.unpack_from("<Q", data, name_at + 4 + name_length)
    whole = content == length - LEAST_CHUNK - name_length
    return whole and data[name_at + 4 : name_at + 4 + name_length] in COMPRESSIONS


def _loss(data: Data, at: int, end: int) -> Loss:
    first_ns = last_ns = None
    if end - at >= HEAD.size + TIMES.size and data[at] == Opcode.CHUNK:
        first_ns, last_ns = TIMES.unpack_from(data, at + HEAD.size)
    return Loss(end - at, first_ns, last_ns)
