# SPDX-License-Identifier: Apache-2.0
"""The machine in words, and how busy others kept it while something was measured."""

from __future__ import annotations

import os
import platform
import time
from pathlib import Path
from statistics import median

HERTZ = os.sysconf("SC_CLK_TCK")
ROUNDS = 300_000


def machine() -> str:
    """Return cores, kind of processor and Python version."""
    cores, python = os.cpu_count(), platform.python_version()
    return f"{cores} cores of {_processor()}, {platform.system()}, Python {python}"


class Load:
    """What others use of the machine's cores from now on, and how fast these are meanwhile.

    A virtual machine does not see the others on its host: its cores are slower then, by half and more.
    """

    def __init__(self) -> None:
        self._before = os.getloadavg()[0]
        self._paces = [pace()]
        self._began, self._busy, self._own = time.monotonic(), _busy_seconds(), _own_seconds()

    def look(self) -> None:
        """Note how fast a core is now."""
        self._paces.append(pace())

    def told(self) -> dict[str, float]:
        """Return the load average before, the cores that others kept busy, and `pace` since then, ms."""
        elapsed = max(time.monotonic() - self._began, 1e-3)
        others = (_busy_seconds() - self._busy) - (_own_seconds() - self._own)
        return {
            "load_average_before": round(self._before, 2),
            "cores_used_by_others": round(max(0.0, others / elapsed), 2),
            "shortest_pace_ms": round(min(self._paces), 1),
            "median_pace_ms": round(median(self._paces), 1),
            "longest_pace_ms": round(max(self._paces), 1),
        }


def pace() -> float:
    """Return the processor time of a loop that is always the same, ms."""
    began, total = time.process_time(), 0
    for i in range(ROUNDS):
        total += i * i
    return (time.process_time() - began) * 1e3


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def _busy_seconds() -> float:
    """Return the time that all cores together were not idle; 0 where that is not told."""
    try:
        words = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]
    except OSError:
        return 0.0
    user, nice, system, _idle, _waiting, interrupts, soft, stolen = map(int, words)
    return (user + nice + system + interrupts + soft + stolen) / HERTZ


def _own_seconds() -> float:
    """Return the processor time of this process and of its children that have ended."""
    return sum(os.times()[:4])
