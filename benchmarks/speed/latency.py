# SPDX-License-Identifier: Apache-2.0
"""How old a sample is when its answer leaves, in real time, against relays of the same messages."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from speed.graph import DEVICE, ONE
from speed.relay import AGES, REALTIME
from speed.rows import NO_GOAL, Goal, Row, alternating, row
from speed.stepping import watched
from speed.tables import nodes

SECONDS = 60.0  # of each figure, over all repeats
DEVICE_LATE = Goal("at most 0.5 %", at_most=0.5)
FIGURES = (("median", "ms"), ("99th percentile", "ms"), ("answers later than a period", "%"))
LEGS = ("left", "right")
TIMER_HZ = 200

Latency = tuple[float, float, float]


class Timed(NamedTuple):
    """What is timed: samples in a second, one process (a leg) or many, of which machine, so many times."""

    rate: int
    composed: bool
    graph: str = ONE
    legs: int = 1

    @property
    def words(self) -> str:
        """Return what it is called in a row."""
        where = ("one process" + " a leg" * (self.legs > 1)) if self.composed else "processes"
        of = f" of the {self.graph}" if self.graph != ONE else ""
        return f"latency{of} at {self.rate} Hz, {where}{', two legs' * (self.legs > 1)}"


TIMED = (
    *(Timed(rate, composed) for rate in (200, 500) for composed in (False, True)),
    *(Timed(200, composed, legs=len(LEGS)) for composed in (False, True)),
)


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: median, 99th percentile and late answers of each; and what the machine is like."""
    for one in TIMED:
        yield from rows_of(one, repeats)
    what = f"a bare timer at {TIMER_HZ} Hz: wakes later than half a period"
    yield row("latency", what, "%", [woken_late(SECONDS / repeats) for _ in range(repeats)])


def rows_of(timed: Timed, repeats: int, group: str = "latency") -> Iterator[Row]:
    """Yield the rows of one; late answers of a device have a goal."""
    given = timed, SECONDS / repeats
    ours, floor = alternating(repeats, lambda: answered(*given), lambda: relayed(*given))
    for index, (figure, unit) in enumerate(FIGURES):
        mine, theirs = ([each[index] for each in side] for side in (ours, floor))
        goal = DEVICE_LATE if timed.graph == DEVICE and unit == "%" else NO_GOAL
        judged = None if goal.words or min(theirs) == 0 else theirs  # a goal is for the figure itself
        yield row(group, f"{timed.words}: {figure}", unit, mine, judged, goal)
        if goal.words:
            yield row(group, f"{timed.words}: {figure}, relays", unit, theirs)


def woken_late(seconds: float) -> float:
    """Return how many wakes, %, of a process that only sleeps until its next period come too late."""
    began, late, count = time.monotonic(), 0, round(seconds * TIMER_HZ)
    for due in (began + k / TIMER_HZ for k in range(1, count + 1)):
        time.sleep(max(0.0, due - time.monotonic()))
        late += time.monotonic() - due > 0.5 / TIMER_HZ
    return 100 * late / count


def answered(timed: Timed, seconds: float) -> Latency:
    """Return median and 99th percentile, ms, and late answers, %, in real time, of the slowest joint."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--realtime", "--json"]
        command += ["--duration", str(seconds), "--param", f"scenario.control_period={1 / timed.rate}"]
        command += ["--machine", timed.graph] if timed.graph != ONE else ["--legs", str(timed.legs)]
        command += ["--out", str(Path(folder) / "bag"), *(["--composed"] if timed.composed else [])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    verdict = json.loads(done.stdout)
    return _slowest([_of_joint(one["timing"]) for one in verdict.get("legs", {"": verdict}).values()])


def _of_joint(timing: dict[str, float]) -> Latency:
    late = 100 * timing["missed_deadlines"] / timing["periods"]
    return timing["latency_median_ms"], timing["latency_p99_ms"], late


def _slowest(joints: Sequence[Latency]) -> Latency:
    median, high, late = zip(*joints, strict=True)
    return max(median), max(high), max(late)


def relayed(timed: Timed, seconds: float) -> Latency:
    """Return the same of relays."""
    period_ns = round(1e9 / timed.rate)
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        commands = _relays(timed, period_ns, Path(folder))
        watched(lambda _work: commands, period_ns, round(seconds * timed.rate))
        return _slowest([_aged(file, period_ns) for file in Path(folder).rglob(f"*{AGES}")])


def _relays(timed: Timed, period_ns: int, folder: Path) -> dict[str, list[str]]:
    """Return the commands; of several legs each is a graph of its own, with its recorder apart."""
    recorder, *others = nodes(timed.graph)
    base = [sys.executable, "-m", "speed.relay", f"{timed.graph}:{period_ns}"]
    alone = {role: [role] for role in (recorder, *others)}
    if timed.legs == 1:
        groups = {"relays": [recorder, *others]} if timed.composed else alone
        return {name: [*base, str(folder), REALTIME, *roles] for name, roles in groups.items()}
    groups = {recorder: [recorder], "leg": others} if timed.composed else alone
    return {
        f"{leg}_{name}": [
            *(*base, str(folder / leg), REALTIME, *roles),
            *("--ros-args", "-r", f"__ns:=/{leg}", "-r", f"/clock:=/{leg}/clock"),
        ]
        for leg in LEGS
        for name, roles in groups.items()
    }


def _aged(file: Path, period_ns: int) -> Latency:
    ages = np.array(json.loads(file.read_text()))
    median, high = np.percentile(ages[len(ages) // 5 :], [50, 99]) / 1e6  # of a run that goes
    return float(median), float(high), 100 * float(np.mean(ages > period_ns))
