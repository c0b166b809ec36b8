# SPDX-License-Identifier: Apache-2.0
"""Is there memory for a search? Asked before it begins: what runs out of memory is killed without a word."""

from collections.abc import Sequence
from pathlib import Path

from pam_orthosis.discrepancy.data import Recording
from pam_orthosis.errors import OrthosisError

BYTES_A_ROW, OF_EACH_PROCESS = 6_000, 4_000  # measured: of all recordings, and again in each process
MEMORY, CONTAINER = Path("/proc/meminfo"), Path("/sys/fs/cgroup")
# files with a container's limit, what it uses, and how much of that can be dropped: version 2 and 1
GROUPS = (
    ("memory.max", "memory.current", "memory.stat", "inactive_file"),
    (
        "memory/memory.limit_in_bytes",
        "memory/memory.usage_in_bytes",
        "memory/memory.stat",
        "total_inactive_file",
    ),
)


def check_room(recordings: Sequence[Recording], processes: int) -> None:
    """Check that there is memory for a search of recordings in so many processes.

    Raises:
        OrthosisError: there is not.
    """
    rows, free = sum(one.samples for one in recordings), available()
    needed, alone = (rows * (BYTES_A_ROW + OF_EACH_PROCESS * count) for count in (processes, 1))
    if free is not None and needed > free:
        fewer = ", or --jobs 1" if alone <= free else ""
        raise OrthosisError(
            f"a search in {rows:,} rows needs about {needed / 1e9:.1f} GB of memory, and {free / 1e9:.1f} GB"
            f" are free: give shorter recordings, or every other row{fewer}"
        )


def available() -> int | None:
    """Return how many bytes of memory are free, of the machine and its container; None where none says."""
    known = [_of_machine(), *(_of_container(*group) for group in GROUPS)]
    return min((free for free in known if free is not None), default=None)


def _of_machine() -> int | None:
    free = _said(MEMORY, "MemAvailable:")
    return None if free is None else free * 1024


def _of_container(limit: str, used: str, statistics: str, dropped: str) -> int | None:
    try:
        most, now = (int((CONTAINER / name).read_text(encoding="ascii")) for name in (limit, used))
    except (OSError, ValueError):  # no such group, or no limit
        return None
    return most - now + (_said(CONTAINER / statistics, dropped) or 0)


def _said(path: Path, key: str) -> int | None:
    """Return the number behind a word at the start of a line."""
    try:
        lines = path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return None
    found = [line.split()[1] for line in lines if line.split()[:1] == [key]]
    return int(found[0]) if found else None
