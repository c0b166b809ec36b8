# SPDX-License-Identifier: Apache-2.0
"""Inputs that are small and ask for much, and a command on one of them under limits of memory and work."""

import json
import os
import struct
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.writer import CompressionType, Writer

from pam_orthosis.bag.record import message_definition

GIB, MIB = 1 << 30, 1 << 20
MOST_MEMORY, MOST_WORK_S = GIB, 5
BOMB = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefghijk", "bcdefghijkl", strict=True)
)
JOINT = "sensor_msgs/msg/JointState"
# the entry script, call by call, in a process that cannot take more memory or work than it may
COMMANDS = f"""
import contextlib, io, json, os, resource, sys
resource.setrlimit(resource.RLIMIT_DATA, ({3 * GIB // 2}, {3 * GIB // 2}))
resource.setrlimit(resource.RLIMIT_CPU, (120, 120))
resource.setrlimit(resource.RLIMIT_FSIZE, ({GIB}, {GIB}))
from pam_orthosis.cli.main import main
told = open(3, "w")
for call in json.loads(sys.argv[1]):
    before, said = sum(os.times()[:4]), io.StringIO()
    with contextlib.redirect_stderr(said):
        status = main(call)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    lines = said.getvalue().strip().splitlines()
    print(json.dumps([status, lines, memory, sum(os.times()[:4]) - before]), file=told, flush=True)
"""


class Ended(NamedTuple):
    """What came of a command: exit status, lines on stderr, most memory till then (bytes), work (s)."""

    status: int
    lines: list[str]
    memory: int
    work_s: float


def commands(calls: Iterable[Sequence[object]], stdin: int = subprocess.DEVNULL, cwd=None) -> list[Ended]:
    """Run verbs one after another in one process under limits; one that kills it fails here."""
    texts = [[str(one) for one in call] for call in calls]
    with tempfile.TemporaryFile("w+") as told:
        preexec = partial(os.dup2, told.fileno(), 3)
        done = subprocess.run(
            [sys.executable, "-c", COMMANDS, json.dumps(texts)], stdin=stdin, stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE, cwd=cwd, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, check=False,
            preexec_fn=preexec, close_fds=False, text=True,
        )  # fmt: skip
        told.seek(0)
        ended = [Ended(*json.loads(line)) for line in told]
    assert len(ended) == len(texts), (texts[len(ended)], done.returncode, done.stderr)
    assert not done.stderr, done.stderr
    return ended


def command(*arguments: object, **options) -> Ended:
    """Run one verb under limits."""
    return commands([arguments], **options)[0]


def zeros(size: int) -> bytes:
    """Return so many zeros packed by zstd, made without holding them."""
    packer, part = zstandard.ZstdCompressor().compressobj(size=size), bytes(16 * MIB)
    packed = [packer.compress(part) for _ in range(size // len(part))]
    return b"".join([*packed, packer.compress(part[: size % len(part)]), packer.flush()])


def bag(file: Path, chunk: bytes, unpacked: int, compression: str = "zstd", quality: str = "[]") -> Path:
    """Write an MCAP file with the topics of `check` and one chunk more, of this content."""
    with open(file, "wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="hostile")
        schema = writer.register_schema(JOINT, "ros2msg", message_definition(JOINT)[0].encode())
        for topic in ("/joint_states", "/reference"):
            channel = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": quality})
            writer.add_message(channel, 0, bytes(60), 0)
        writer.finish()
    data = file.read_bytes()
    at = _end_of_data(data)
    name = compression.encode()
    head = struct.pack("<QQQII", 0, 1, unpacked, 0, len(name)) + name + struct.pack("<Q", len(chunk))
    record = struct.pack("<BQ", 6, len(head) + len(chunk)) + head + chunk
    # without a summary: whoever reads it goes through all of its data
    end = struct.pack("<BQI", 0x0F, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + b"\x89MCAP0\r\n"
    file.write_bytes(data[:at] + record + end)
    return file


def _end_of_data(data: bytes) -> int:
    """Return where the record is that ends the data section."""
    at = 8
    while data[at] != 0x0F:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return at
