# SPDX-License-Identifier: Apache-2.0
"""How long a step of a graph takes, by the heartbeats of its processes."""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from pam_orthosis.nodes import launch
from pam_orthosis.nodes.supervisor import supervise
from speed.machine import HERTZ

HERE = Path(__file__).resolve().parents[1]
WARM_STEPS = 100
LEAST_SECONDS = 2.0  # heartbeats come each tenth of a second


class _Enough(Exception):
    """The graph has been watched for long enough."""


class Pace:
    """Watches the simulated time of a run; raises when it has seen enough steps after the warm-up."""

    def __init__(self, period_ns: int, steps: int):
        self._period_ns = period_ns
        self._from_ns, self._steps = WARM_STEPS * period_ns, steps
        self._first: tuple[float, float, int] | None = None
        self.began = time.monotonic()
        self.first_step_seconds = self.first_step_processor_seconds = float("nan")
        self.seconds_per_step = self.processor_seconds_per_step = float("nan")

    def __call__(self, time_ns: int) -> None:
        """Take the simulated time that the graph has reached."""
        now = time.monotonic()
        if time_ns > 0 and math.isnan(self.first_step_seconds):
            self.first_step_seconds = now - self.began
            self.first_step_processor_seconds = _processor_seconds()
        if time_ns < self._from_ns:
            return
        if self._first is None:
            self._first = now, _processor_seconds(), time_ns
        passed = (time_ns - self._first[2]) // self._period_ns
        if passed >= self._steps and now - self._first[0] >= LEAST_SECONDS:
            self.seconds_per_step = (now - self._first[0]) / passed
            self.processor_seconds_per_step = (_processor_seconds() - self._first[1]) / passed
            raise _Enough


def _processor_seconds() -> float:
    """Return what the processes below this one, those that run, have used of the processors."""
    ticks = 0
    for pid in _below(os.getpid()):
        with suppress(OSError):  # it has just ended
            words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            ticks += int(words[11]) + int(words[12])
    return ticks / HERTZ


def _below(pid: int) -> list[int]:
    """Return the children of a process, of all its threads, and theirs."""
    children: list[int] = []
    for told in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):  # threads come and go
            children += map(int, told.read_text().split())
    return [*children, *(each for child in children for each in _below(child))]


def watched(make_commands: Callable[[Path], Mapping[str, Sequence[str]]], period_ns: int, steps: int) -> Pace:
    """Start a graph, whose commands are made for a folder, on a domain of its own; watch it, end it."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder, launch.free_domain() as domain:
        work = Path(folder)
        environment = launch.environment(work, domain)
        environment["PYTHONPATH"] = os.pathsep.join([str(HERE), os.environ.get("PYTHONPATH", "")])
        commands = make_commands(work)
        pace = Pace(period_ns, steps)
        try:
            supervise(commands, environment, work, pace)
        except _Enough:
            return pace
        raise RuntimeError("the graph ended before it was watched for long enough")
