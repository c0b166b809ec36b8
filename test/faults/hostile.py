# SPDX-License-Identifier: Apache-2.0
"""Inputs that are small and ask for much, and a command on one of them under limits of memory and work."""

import os
import struct
import subprocess
import sys
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
# the entry script in a process that cannot take more memory or work than it may
COMMAND = f"""
import resource, sys
resource.setrlimit(resource.RLIMIT_DATA, ({3 * GIB // 2}, {3 * GIB // 2}))
resource.setrlimit(resource.RLIMIT_CPU, (60, 60))
resource.setrlimit(resource.RLIMIT_FSIZE, ({GIB}, {GIB}))
from pam_orthosis.cli.main import main
sys.exit(main(sys.argv[1:]))
"""


class Ended(NamedTuple):
    """What came of a command: exit status, lines on stderr, most memory, bytes, processor time, s."""

    status: int
    lines: list[str]
    memory: int
    work_s: float


def command(*arguments, stdin=subprocess.DEVNULL, cwd=None) -> Ended:
    """Run a verb under limits."""
    call = [sys.executable, "-c", COMMAND, *map(str, arguments)]
    with subprocess.Popen(call, stdin=stdin, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=cwd,
                          env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}) as process:  # fmt: skip
        said = process.stderr.read().decode()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    return Ended(
        process.returncode, said.strip().splitlines(), used.ru_maxrss * 1024, used.ru_utime + used.ru_stime
    )


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
