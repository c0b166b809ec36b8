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

from pam_orthosis.bag.topics import PLANT, RECORDER, Topics
from pam_orthosis.model.machines import KNEE
from speed.relay import AGES, REALTIME
from speed.rows import Row, alternating, row
from speed.stepping import watched

TABLE = Topics(KNEE)

RATES_HZ = (200, 500)
SECONDS = 4.0
FIGURES = (("median", "ms"), ("99th percentile", "ms"), ("answers later than a period", "%"))


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: median, 99th percentile and late answers for each rate and layout."""
    for rate in RATES_HZ:
        for composed in (False, True):
            layout = "one process" if composed else "processes"
            ours, floor = alternating(
                repeats, lambda r=rate, c=composed: answered(r, c), lambda r=rate, c=composed: relayed(r, c)
            )
            for index, (figure, unit) in enumerate(FIGURES):
                what = f"latency at {rate} Hz, {layout}: {figure}"
                mine, theirs = ([each[index] for each in side] for side in (ours, floor))
                yield row("latency", what, unit, mine, theirs if min(theirs) > 0 else None)


def answered(rate: int, composed: bool) -> tuple[float, float, float]:
    """Return median and 99th percentile, ms, and late answers, %, of a run in real time."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--realtime", "--json"]
        command += ["--duration", str(SECONDS), "--param", f"scenario.control_period={1 / rate}"]
        command += ["--out", str(Path(folder) / "bag"), *(["--composed"] if composed else [])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    timing = json.loads(done.stdout)["timing"]
    late = 100 * timing["missed_deadlines"] / timing["periods"]
    return timing["latency_median_ms"], timing["latency_p99_ms"], late


def relayed(rate: int, composed: bool) -> tuple[float, float, float]:
    """Return the same of relays."""
    roles, period_ns = (RECORDER, *TABLE.nodes[1:-1], PLANT), round(1e9 / rate)
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-bench-") as folder:
        base = [sys.executable, "-m", "speed.relay", str(period_ns), folder, REALTIME]
        commands = {"relays": [*base, *roles]} if composed else {role: [*base, role] for role in roles}
        watched(lambda _work: commands, period_ns, round(SECONDS * rate))
        ages = np.array(json.loads((Path(folder) / AGES).read_text()))
    median, high = np.percentile(ages[len(ages) // 5 :], [50, 99]) / 1e6  # of a run that goes
    return float(median), float(high), 100 * float(np.mean(ages > period_ns))
