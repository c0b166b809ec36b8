# SPDX-License-Identifier: Apache-2.0
"""Nodes and the driver leave, or are killed, and come again in a graph that nobody supervises.

Nothing is judged by the wall clock: a trial waits until the recorded knee follows again; in lockstep, where
all wait, no sample may be missing. Each row is kept as soon as it is there, and a campaign goes on where it
was broken off.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from itertools import cycle, islice
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Channel, Message
from mcap.stream_reader import StreamReader

from pam_orthosis.bag.cdr import Reader
from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.topics import PLANT, POSITION, RECORDER, TRAJECTORY, VALVE, Topics
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.launch import Mode, commands, environment, free_domain

TABLE = Topics(KNEE)

LIMIT_S = 600.0  # after which a trial counts as hung
DRIVER = "dummy_driver"
LEFT = (POSITION, *TABLE.controllers, VALVE, TRAJECTORY, DRIVER)
BEFORE_S, SETTLED_S = 2.0, 2.0  # of recorded time: until somebody goes, and how long the knee has to follow
RELEASED_RAD, SHARE = 0.35, 0.25  # a released knee is so far away, one that follows has so much of that left
HANGING_RAD = 0.0
BOUND_DEG = 3.0  # within which a knee in lockstep follows
EVEN_S = 1.0e-6  # between steps of the stamps
SLOW = {  # a rate that a busy machine keeps up with, and gains for it
    "scenario.control_period": 0.02, "scenario.trajectory": "hold", "scenario.start_angle": 0.4,
    "scenario.duration": 36000.0,
    "control.position.c1": 12.0, "control.position.c2": 12.0, "control.observer.pole": 35.0,
    "control.pressure.gain": 20.0,
}  # fmt: skip
PATIENT = ["-p", f"sample_timeout:={LIMIT_S}"]  # of the recorder: a driver may take its time
READERS = {
    name: Reader(TABLE.by_name[name].type, [number])
    for name, number in (("joint_states", "position[0]"), ("reference", "points[0].positions[0]"))
}


@dataclass(frozen=True)
class Leaving:
    """Who goes, on which signal, for how long, s, and whether the others wait for it."""

    who: str
    signal: str
    seconds: float
    lockstep: bool = False


@dataclass
class Outcome:
    """What came of it: error of the released knee and error that was left, degrees, and what is wrong."""

    leaving: Leaving
    released_deg: float = np.nan
    left_deg: float = np.nan
    load: float = 0.0
    faults: list[str] = field(default_factory=list)


def leavings() -> Iterator[Leaving]:
    """Yield who leaves how, without end."""
    ways = [(name, seconds) for seconds in (0.5, 4.0, 30.0) for name in ("SIGKILL", "SIGTERM")]
    at_pace = [Leaving(who, *way) for way in ways for who in LEFT]
    waiting = [Leaving(who, *way, lockstep=True) for way in ways for who in LEFT if who != DRIVER]
    return cycle([*at_pace, *waiting])


def _driver(angle: float) -> list[str]:
    told = {"scenario.control_period": SLOW["scenario.control_period"], "scenario.start_angle": angle}
    pairs = [word for name, value in told.items() for word in ("-p", f"{name}:={value}")]
    return [sys.executable, "-m", f"pam_orthosis.nodes.{DRIVER}", "--ros-args", *pairs]


class Graph:
    """Nodes in processes of their own, started one by one as by hand."""

    def __init__(self, folder: Path, mode: Mode):
        folder.mkdir(parents=True, exist_ok=True)
        self._claim = ExitStack()  # of the domain, for as long as the graph is there
        self._environment = environment(folder, self._claim.enter_context(free_domain()))
        self.bag, self._folder = folder / "walk", folder
        self._commands = commands(folder, load(SLOW), self.bag, "default", mode)
        self._commands[RECORDER] += PATIENT
        if not mode.with_plant:
            self._commands[DRIVER] = _driver(SLOW["scenario.start_angle"])
        self._processes: dict[str, subprocess.Popen] = {}
        self._logs: dict[str, Path] = {}
        for name in self._commands:
            self.start(name)

    def start_again(self, name: str) -> None:
        """Start a node that has left; the driver's emulated knee hangs meanwhile."""
        if name == DRIVER:
            self._commands[DRIVER] = _driver(HANGING_RAD)
        self.start(name)

    def start(self, name: str) -> None:
        """Start a node."""
        log = self._logs[name] = self._folder / f"{name}_{time.monotonic_ns()}.log"
        with open(log, "wb") as output:
            self._processes[name] = subprocess.Popen(
                self._commands[name], env=self._environment, stdout=output, stderr=output
            )

    def end(self, name: str, number: int) -> None:
        """Send a node a signal, and wait until it is gone."""
        self._processes[name].send_signal(number)
        self._processes[name].wait(LIMIT_S)

    def gone(self, without: str = "") -> list[str]:
        """Return the nodes, but for one, that have ended, with the last line of each."""
        ended = [name for name, process in self._processes.items() if process.poll() is not None]
        ended = [name for name in ended if name != without]
        return [f"{name} has ended: {self.last_line(name)}" for name in ended]

    def wait(self, condition, without: str = "") -> bool:
        """Wait until a condition holds or a node, but for one, has ended; return whether it holds."""
        until = time.monotonic() + LIMIT_S
        while not (there := condition()) and not self.gone(without) and time.monotonic() < until:
            time.sleep(0.2)
        return there

    def close(self) -> list[str]:
        """End all nodes, the recorder last; return what is wrong about that."""
        for name in sorted(self._processes, key=lambda name: name == RECORDER):
            if self._processes[name].poll() is None:
                self.end(name, signal.SIGTERM)
        self._claim.close()
        ends = {name: process.returncode for name, process in self._processes.items()}
        return [f"{name} ended with {status}" for name, status in ends.items() if status]

    def last_line(self, name: str) -> str:
        """Return what a node said last."""
        lines = self._logs[name].read_text().strip().splitlines()
        return lines[-1] if lines else "nothing said"

    def recorded(self) -> dict[str, np.ndarray]:
        """Return stamps, s, and values of knee angle and reference that are on disk."""
        found: dict[str, list[tuple[float, float]]] = {name: [] for name in READERS}
        names: dict[int, str] = {}
        with suppress(OSError, McapError), open(self.bag / f"{self.bag.name}_0.mcap", "rb") as stream:
            for record in StreamReader(stream).records:
                if isinstance(record, Channel):
                    names[record.id] = record.topic.strip("/")
                elif isinstance(record, Message) and (name := names[record.channel_id]) in READERS:
                    stamp_ns, numbers = READERS[name](record.data)
                    found[name].append((stamp_ns * 1e-9, *numbers))
        return {name: np.array(sorted(rows)).reshape(-1, 2).T for name, rows in found.items()}

    def newest_s(self) -> float:
        """Return the stamp of the newest sample on disk, 0 if there is none."""
        return float(max(self.recorded()["joint_states"][0], default=0.0))

    def errors_since(self, stamp_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return stamps, s, and distances of the knee from its reference, rad."""
        there = self.recorded()
        (time_s, angle), (of_s, reference) = there["joint_states"], there["reference"]
        late = time_s > stamp_s
        if not late.any() or not of_s.size:
            return np.empty(0), np.empty(0)
        return time_s[late], np.abs(np.interp(time_s[late], of_s, reference) - angle[late])


def suffer(leaving: Leaving, folder: Path) -> Outcome:
    """Start a graph, let somebody leave and come again, and wait until the knee follows."""
    outcome = Outcome(leaving)
    graph = Graph(folder, Mode(realtime=not leaving.lockstep, with_plant=leaving.who != DRIVER))
    come_again = _leave_in_lockstep if leaving.lockstep else _leave_and_return
    try:
        if graph.wait(graph.newest_s):
            begun_s = graph.newest_s()
            graph.wait(lambda: graph.newest_s() > begun_s + BEFORE_S)
            come_again(graph, leaving, outcome)
        outcome.faults += graph.gone()
    finally:
        outcome.faults += graph.close()
    outcome.load = round(os.getloadavg()[0], 1)
    outcome.faults += _unreadable(graph)
    return outcome


def _leave_and_return(graph: Graph, leaving: Leaving, outcome: Outcome) -> None:
    left_s = graph.newest_s()
    graph.end(leaving.who, getattr(signal, leaving.signal))
    time.sleep(leaving.seconds)
    graph.start_again(leaving.who)

    def follows() -> bool:
        time_s, error = graph.errors_since(left_s)
        if not error.size:
            return False
        settled = time_s > time_s[-1] - SETTLED_S
        outcome.released_deg, outcome.left_deg = np.rad2deg([error.max(), error[settled].max()])
        released = error[~settled].max(initial=0.0)
        return released > RELEASED_RAD and outcome.left_deg < SHARE * outcome.released_deg

    if not graph.wait(follows):
        outcome.faults.append(
            f"the knee was {outcome.released_deg:.1f} degrees away, and is so still by {outcome.left_deg:.1f}"
        )


def _leave_in_lockstep(graph: Graph, leaving: Leaving, outcome: Outcome) -> None:
    graph.end(leaving.who, getattr(signal, leaving.signal))
    if not graph.wait(lambda: graph.last_line(PLANT).endswith(f"s: {leaving.who} is gone"), leaving.who):
        outcome.faults.append(f"the plant does not say who is gone: {graph.last_line(PLANT)}")
    left_s = graph.newest_s()
    time.sleep(leaving.seconds)
    graph.start_again(leaving.who)

    def follows() -> bool:
        time_s, error = graph.errors_since(left_s)
        if not error.size or time_s[-1] < left_s + SETTLED_S:
            return False
        settled = time_s > time_s[-1] - SETTLED_S
        outcome.released_deg, outcome.left_deg = np.rad2deg([error.max(), error[settled].max()])
        return outcome.left_deg < BOUND_DEG

    if not graph.wait(follows):
        outcome.faults.append(f"the knee is still {outcome.left_deg:.1f} degrees away")
    time_s, _ = graph.errors_since(left_s)
    if time_s.size and np.ptp(np.diff(time_s)) > EVEN_S:
        outcome.faults.append("samples are missing")


def _unreadable(graph: Graph) -> list[str]:
    try:
        read_bag(graph.bag, ["angle", "reference_angle"])
    except OrthosisError as error:
        return [f"bag: {error}"]
    return []


def campaign(work: Path, count: int, rows: Path) -> list[dict]:
    """Let so many leave; return the rows, which are in a file as well and are not done again."""
    done = json.loads(rows.read_text()) if rows.exists() else []
    for number, leaving in enumerate(islice(leavings(), count)):
        if number >= len(done):
            outcome = suffer(leaving, work / f"returns{number:03d}")
            row = asdict(outcome)
            done.append({**row.pop("leaving"), **row})
            rows.write_text(json.dumps(done, indent=1) + "\n")
            print(number, *done[-1].values(), flush=True)
    return done[:count]
