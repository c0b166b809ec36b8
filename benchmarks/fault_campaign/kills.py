# SPDX-License-Identifier: Apache-2.0
"""Faults of nodes at random instants of real runs: how soon and how well does the run end, what is lost?

How soon it ends is told, and makes nothing wrong by itself: it depends on the load of the machine.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from pam_orthosis.bag.read import METADATA_FILE, read_bag
from pam_orthosis.bag.recover import recover_in_place
from pam_orthosis.bag.topics import NODES, PLANT, RECORDER, VALVE
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

LIMIT_S = 90.0
END_S, LOST_MS = 2.0, 500.0  # what is promised
SECONDS = 2.0  # of simulated walking at least, within which the fault comes
INJECTED = Path(__file__).parent / "injected"
RUN = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--duration", "3600"]
QUICK = ["--param", "scenario.start_hold=0.1", "--param", "scenario.start_ramp=0.5"]
MODES = {"lockstep": [], "composed": ["--composed"], "real time": ["--realtime"]}
OF_NODES = ("SIGKILL", "SIGSTOP", "exit", "exception", "hang")
OF_PARENT = "entry script SIGKILL"
OF_BOTH = "entry script and recorder SIGKILL"


@dataclass(frozen=True)
class Kill:
    """A fault: how the run is made, which node, what happens to it, after how many ns of the run."""

    mode: str
    node: str
    act: str
    after_ns: int | None

    @property
    def process(self) -> str:
        """The process that the message has to name."""
        return "composed" if self.mode == "composed" else self.node


@dataclass
class Ending:
    """What came of it: exit status, message, time to the end, data lost, and what is wrong about it."""

    kill: Kill
    status: int | None
    message: str
    took_s: float
    lost_ms: float
    vented: bool | None
    recovered: bool
    load: float
    faults: list[str] = field(default_factory=list)


def kills(seed: int) -> Iterator[Kill]:
    """Yield faults without end: modes, acts and nodes by turns, instants at random."""
    rng = np.random.default_rng(seed)
    while True:
        for mode in MODES:
            for act in (*OF_NODES, OF_PARENT, OF_BOTH):
                node = RECORDER if act == OF_BOTH else str(rng.choice(NODES))
                started = rng.random() > 0.15 or act in (OF_PARENT, OF_BOTH)
                yield Kill(mode, node, act, int(rng.uniform(0.0, SECONDS) * 1e9) if started else None)


def suffer(kill: Kill, folder: Path) -> Ending:
    """Start a run, let the fault happen in it, and look at what is left."""
    notes, bag = folder / "notes", folder / "bag"
    notes.mkdir(parents=True)
    fault = {"node": kill.node, "act": kill.act, "after_ns": kill.after_ns, "notes": str(notes)}
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join([str(INJECTED), os.environ.get("PYTHONPATH", "")]),
        "PAM_ORTHOSIS_FAULT": json.dumps(fault),
        "TMPDIR": str(folder),
    }
    with open(folder / "said", "w+") as said:
        command = [*RUN, "--out", str(bag), *QUICK, *MODES[kill.mode]]
        process = subprocess.Popen(command, env=environment, stdout=said, stderr=said)
        status, ended = _awaited(process, notes)
        said.seek(0)
        lines = said.read().strip().splitlines()
    return _judged(kill, status, ended, lines[-1] if lines else "", notes, bag)


def _awaited(process: subprocess.Popen, notes: Path) -> tuple[int | None, float]:
    """Wait for the entry script and all its nodes; return its status and when the last of them was gone."""
    deadline = time.monotonic() + LIMIT_S
    while process.poll() is None or any(_alive(int(note.name[4:])) for note in notes.glob("pid-*")):
        if time.monotonic() > deadline:
            process.terminate()
            process.wait()
            return None, time.time()
        time.sleep(0.01)
    return process.returncode, time.time()


def _alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def _judged(kill: Kill, status: int | None, ended: float, said: str, notes: Path, bag: Path) -> Ending:
    happened = json.loads((notes / "fault").read_text()) if (notes / "fault").exists() else None
    if happened is None:
        return Ending(kill, status, said, np.nan, np.nan, None, False, _load(), ["the fault did not happen"])
    recovered = _recover(bag) if kill.act == OF_BOTH else False
    ending = Ending(
        kill, status, said, ended - happened["wall"], np.nan, None, recovered, _load()
    )  # fmt: skip
    recording = kill.after_ns is not None
    if recording:
        ending.lost_ms, ending.vented = _left(kill, bag, notes)
    ending.faults = list(_faults(ending, recording))
    return ending


def _recover(bag: Path) -> bool:
    """Do what the verb `recover` does."""
    if (bag / METADATA_FILE).exists():
        return False
    try:
        return recover_in_place(bag) > 0
    except OrthosisError:  # nothing is in it
        return False


def _left(kill: Kill, bag: Path, notes: Path) -> tuple[float, bool | None]:
    """Return data lost, ms, and whether the last commands or the last pressures are those of the vent.

    Whoever is dead cannot vent: nothing is asked of a bag that was recorded by the process that died.
    """
    text = (notes / "reached").read_text()
    reached_ns = int(text) if text else 0
    try:
        stamps = read_bag(bag, ["angle"])["angle"].stamp_ns
        lost_ms = max(0.0, (reached_ns - int(stamps[-1])) / 1e6)
    except OrthosisError:  # at the very beginning nothing is on the disk yet
        return kill.after_ns / 1e6, None
    unheard = kill.node == RECORDER or (kill.mode == "composed" and kill.act != "exception")
    if kill.act != OF_PARENT and unheard:
        return lost_ms, None
    return lost_ms, _vented(bag, kill.node)


def _vented(bag: Path, node: str) -> bool:
    p = load()
    names = [f"{muscle}_voltage" for muscle in ("extensor", "flexor")]
    pressures = [f"truth_{muscle}_pressure" for muscle in ("extensor", "flexor")]
    recorded = read_bag(bag, names + pressures)
    commanded = all(recorded[name].value[-1] == p.valve.minimum_voltage for name in names)
    let_out = all(recorded[name].value[-1] < 1.5 * p.valve.ambient_pressure for name in pressures)
    return {VALVE: let_out, PLANT: commanded}.get(node, commanded and let_out)


def _faults(ending: Ending, recording: bool) -> Iterator[str]:
    kill = ending.kill
    if ending.status is None:
        yield "no end"
    if kill.act not in (OF_PARENT, OF_BOTH):
        if ending.status == 0:
            yield "exit status 0"
        if kill.process not in ending.message and kill.node not in ending.message:
            yield f"{kill.process} not named: {ending.message}"
    if recording and not ending.lost_ms <= LOST_MS:
        yield f"lost {ending.lost_ms:.0f} ms"
    if ending.vented is False:
        yield "the valves do not vent"


def _load() -> float:
    return os.getloadavg()[0]


def campaign(work: Path, count: int, seed: int) -> list[Ending]:
    """Let so many faults happen; tell of each as it is over."""
    endings = []
    for number, kill in enumerate(islice(kills(seed), count)):
        ending = suffer(kill, work / f"{number}")
        endings.append(ending)
        at = "start" if kill.after_ns is None else f"{kill.after_ns / 1e9:.2f} s"
        print(
            f"{number} {kill.mode}, {kill.act} of {kill.node} at {at}: {ending.took_s:.2f} s,"
            f" lost {ending.lost_ms:.0f} ms, vented {ending.vented}, load {ending.load:.1f}"
            f": {'; '.join(ending.faults) or 'good'}",
            file=sys.stderr,
            flush=True,
        )
    return endings


def summary(endings: list[Ending]) -> dict:
    """Return, by mode and act: tried, wrong, time to the end (median, longest), largest loss, vented."""
    told = {}
    for key in dict.fromkeys((each.kill.mode, each.kill.act) for each in endings):
        mine = [each for each in endings if (each.kill.mode, each.kill.act) == key]
        took = [each.took_s for each in mine]
        lost = [each.lost_ms for each in mine if np.isfinite(each.lost_ms)]
        told[", ".join(key)] = {
            "tried": len(mine),
            "in_time": sum(t <= END_S for t in took),
            "took_s": sorted(round(t, 2) for t in took),
            "median_s": round(float(np.median(took)), 2),
            "longest_s": round(max(took), 2),
            "lost_ms": round(max(lost, default=0.0), 1),
            "vented": sum(each.vented is True for each in mine),
            "asked_to_vent": sum(each.vented is not None for each in mine),
            "recovered": sum(each.recovered for each in mine),
            "wrong": [f"{each.kill.node}: {fault}" for each in mine for fault in each.faults],
        }
    return told
