# SPDX-License-Identifier: Apache-2.0
"""Is there memory for a search? Asked before it begins: what runs out of memory is killed without a word."""

from collections.abc import Sequence
from pathlib import Path

from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.errors import OrthosisError

BYTES_A_ROW, OF_EACH_PROCESS = 6_000, 4_000  # measured: of all recordings, and again in each process
MEMORY, OWN, CONTAINER = Path("/proc/meminfo"), Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# of containers, version 2 and 1: mark of the line in `OWN`, folder, limit, use, what of it can be dropped
GROUPS = (
    ("0::", "", "memory.max", "memory.current", ("inactive_file", "active_file", "slab_reclaimable")),
    (":memory:", "memory", "memory.limit_in_bytes", "memory.usage_in_bytes",
     ("total_inactive_file", "total_active_file")),
)  # fmt: skip


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
    """Return how many bytes of memory are free, of the machine and its containers; None where none says."""
    machine = _said(MEMORY, "MemAvailable:")
    known = [None if machine is None else machine * 1024]
    for own, folder, limit, used, dropped in GROUPS:
        groups = (CONTAINER / folder / group for group in _groups(own))
        known += [_of_container(group, limit, used, dropped) for group in groups]
    return min((free for free in known if free is not None), default=None)


def _groups(own: str) -> list[Path]:
    """Return the groups that this process is in, the outermost last: limits of all hold."""
    found = [line.split(own, 1)[1].strip() for line in _lines(OWN) if own in line]
    return [each.relative_to("/") for path in (*found, "/") for each in (Path(path), *Path(path).parents)]


def _of_container(group: Path, limit: str, used: str, dropped: Sequence[str]) -> int | None:
    try:
        most, now = (int((group / name).read_text(encoding="ascii")) for name in (limit, used))
    except (OSError, ValueError):  # no such group, or no limit
        return None
    spare = sum(_said(group / "memory.stat", key) or 0 for key in dropped)
    return max(0, most - now + spare)


def _said(path: Path, key: str) -> int | None:
    """Return the number behind a word at the start of a line."""
    found = [line.split()[1] for line in _lines(path) if line.split()[:1] == [key]]
    return int(found[0]) if found else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return []
