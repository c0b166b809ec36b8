# SPDX-License-Identifier: Apache-2.0
"""How long commands and the graph take until they do something."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence

from pam_orthosis.cli.main import VERBS
from speed.graph import commands_of, relays
from speed.rows import Goal, Row, alternating, row
from speed.stepping import watched

HELP = Goal("below 0.3 s", at_most=0.3)
FIRST_STEP = Goal("below 3 s", at_most=3.0)
PERIOD_NS = 2_000_000
INTERPRETER = [sys.executable, "-c", "import argparse"]


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows: processor time of each command's help, time to the first step of the graph."""
    import rclpy  # noqa: F401  without it there is nothing to measure

    commands = {verb: [sys.executable, "-m", "pam_orthosis.cli.main", verb, "--help"] for verb in VERBS}
    asked = [INTERPRETER, *commands.values()]
    bare, *taken = alternating(repeats, *(lambda c=command: processor_seconds(c) for command in asked))
    yield row("start", "processor time of the bare interpreter", "s", bare)
    for verb, figures in zip(commands, taken, strict=True):
        yield row("start", f"processor time of `{verb} --help`", "s", figures, goal=HELP)
    for composed in (False, True):
        layout = "one process" if composed else "processes"
        ours, floor = alternating(
            repeats, lambda c=composed: first_step(c), lambda c=composed: first_step(c, relayed=True)
        )
        for index, what in enumerate(("time", "processor time")):
            name = f"{what} to the first step, {layout}"
            figures = [each[index] for each in ours]
            yield row("start", name, "s", figures, goal=FIRST_STEP)
            beside = [each[index] for each in floor]
            yield row("start", f"{name}, beside that of the relays", "s", figures, beside)


def processor_seconds(command: Sequence[str]) -> float:
    """Return the processor time of a command: what it takes on an idle machine, whatever the load is."""
    before = _children_seconds()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return _children_seconds() - before


def _children_seconds() -> float:
    times = os.times()
    return times.children_user + times.children_system


def first_step(composed: bool, relayed: bool = False) -> tuple[float, float]:
    """Return time and processor time from the start of the processes until the graph steps."""
    make = relays(composed, True) if relayed else commands_of(composed, True)
    pace = watched(make, PERIOD_NS, 1)
    return pace.first_step_seconds, pace.first_step_processor_seconds
