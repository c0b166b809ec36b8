# SPDX-License-Identifier: Apache-2.0
"""Is there memory for a search? Asked before it begins: what runs out of memory is killed without a word."""

from collections.abc import Sequence
from pathlib import Path

from pam_orthosis.discrepancy.data import Recording
from pam_orthosis.errors import OrthosisError

BYTES_A_ROW, OF_EACH_PROCESS = 6_000, 4_000  # measured: of all recordings, and again in each process
MEMORY = Path("/proc/meminfo")


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
    """Return how many bytes of memory are free; None where the system does not say."""
    try:
        lines = MEMORY.read_text(encoding="ascii").splitlines()
    except (OSError, ValueError):
        return None
    found = [line.split()[1] for line in lines if line.startswith("MemAvailable:")]
    return int(found[0]) * 1024 if found else None
