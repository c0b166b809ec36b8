# SPDX-License-Identifier: Apache-2.0
"""Two legs with knees, ankles and shoes in one process with a recorder, against relays of their messages."""

from __future__ import annotations

from collections.abc import Iterator

from speed.graph import DEVICE, RATE_HZ, REAL_TIME, real_time, relayed, stepped, steps
from speed.latency import Timed, rows_of
from speed.rows import Row, alternating

GROUP, CLOCKED_HZ = "device", 200


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: a step in lockstep, simulated time, and latency in real time."""
    import rclpy  # noqa: F401  without it there is nothing to measure

    ours, floor = alternating(
        repeats, lambda: stepped(True, True, graph=DEVICE), lambda: relayed(True, True, graph=DEVICE)
    )
    where = f"{RATE_HZ} Hz, the device"
    yield from steps(where, ours, floor, " at", GROUP)
    yield from real_time(where, REAL_TIME[False], ours, floor, GROUP)
    yield from rows_of(Timed(CLOCKED_HZ, True, DEVICE), repeats, GROUP)
