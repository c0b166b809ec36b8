# SPDX-License-Identifier: Apache-2.0
"""How old a sample is when its answer leaves, in real time, against relays of the same messages."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from speed.graph import DEVICE, ONE
from speed.relay import AGES, REALTIME
from speed.rows import NO_GOAL, Goal, Row, alternating, row
from speed.stepping import watched
from speed.tables import nodes

RATES_HZ = (200, 500)
SECONDS = 4.0
DEVICE_LATE = Goal("at most 0.5 %", at_most=0.5)
FIGURES = (("median", "ms"), ("99th percentile", "ms"), ("answers later than a period", "%"))


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: median, 99th percentile and late answers for each rate and layout."""
    for rate in RATES_HZ:
        for composed in (False, True):
            layout = "one process" if composed else "processes"
            yield from of_graph(f"latency at {rate} Hz, {layout}", repeats, rate, composed)


def of_graph(
    what: str, repeats: int, rate: int, composed: bool, graph: str = ONE, group: str = "latency"
) -> Iterator[Row]:
    """Yield the rows of a graph at a rate; late answers of a device have a goal."""
    given = rate, composed, graph
    ours, floor = alternating(repeats, lambda: answered(*given), lambda: relayed(*given))
    for index, (figure, unit) in enumerate(FIGURES):
        mine, theirs = ([each[index] for each in side] for side in (ours, floor))
        goal = DEVICE_LATE if graph == DEVICE and unit == "%" else NO_GOAL
        judged = None if goal.words or min(theirs) == 0 else theirs  # a goal is for the figure itself
        yield row(group, f"{what}: {figure}", unit, mine, judged, goal)
        if goal.words:
            yield row(group, f"{what}: {figure}, relays", unit, theirs)


def answered(rate: int, composed: bool, graph: str) -> tuple[float, float, float]:
    """Return median and 99th percentile, ms, and late answers, %, in real time, of the slowest joint."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--realtime", "--json"]
        command += ["--duration", str(SECONDS), "--param", f"scenario.control_period={1 / rate}"]
        command += [*(["--machine", graph] if graph != ONE else [])]
        command += ["--out", str(Path(folder) / "bag"), *(["--composed"] if composed else [])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    verdict = json.loads(done.stdout)
    timings = [one["timing"] for one in verdict.get("legs", {"": verdict}).values()]
    late = max(100 * one["missed_deadlines"] / one["periods"] for one in timings)
    median, high = (max(one[f"latency_{key}_ms"] for one in timings) for key in ("median", "p99"))
    return median, high, late


def relayed(rate: int, composed: bool, graph: str) -> tuple[float, float, float]:
    """Return the same of relays."""
    roles, period_ns = nodes(graph), round(1e9 / rate)
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        base = [sys.executable, "-m", "speed.relay", f"{graph}:{period_ns}", folder, REALTIME]
        commands = {"relays": [*base, *roles]} if composed else {role: [*base, role] for role in roles}
        watched(lambda _work: commands, period_ns, round(SECONDS * rate))
        told = [np.array(json.loads(file.read_text())) for file in Path(folder).glob(f"*{AGES}")]
    of_all = [np.percentile(ages[len(ages) // 5 :], [50, 99]) / 1e6 for ages in told]  # of a run that goes
    late = max(100 * float(np.mean(ages > period_ns)) for ages in told)
    return *map(float, np.max(of_all, axis=0)), late
