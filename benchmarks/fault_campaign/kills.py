# SPDX-License-Identifier: Apache-2.0
"""Faults of processes at random instants of real runs: how soon and how well does the run end, what is lost?

Nodes, recorder, bag writer and entry script; each row is kept as soon as it is there, and a campaign goes on
where it was broken off. How soon a run ends is judged by the limit for the load that the campaign makes.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader

from pam_orthosis.bag.read import read_bag
from pam_orthosis.bag.record import METADATA_FILE
from pam_orthosis.bag.topics import PLANT, RECORDER, VALVE, Topics
from pam_orthosis.bag.writer_process import NAME as WRITER
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load

TABLE = Topics(KNEE)

LIMIT_S = 300.0  # after which a run counts as hung
END_S, END_BESIDE_LOAD_S, LOST_MS = 2.0, 4.0, 500.0  # what is promised
SECONDS = 2.0  # of simulated walking at least, within which the fault comes
INJECTED = Path(__file__).parent / "injected"
CLI = [sys.executable, "-m", "pam_orthosis.cli.main"]
HEED = ["env", "--default-signal=HUP,INT,TERM"]  # also if this is started in the background or by `nohup`
RUN = [*HEED, *CLI, "run", "--duration", "3600"]
QUICK = ["--param", "scenario.start_hold=0.1", "--param", "scenario.start_ramp=0.5"]
COMPOSED, TWO_LEGS = "composed", "two legs"
LEGS = "left", "right"
MODES = {
    "lockstep": [],
    COMPOSED: ["--composed"],
    "real time": ["--realtime"],
    "composed, real time": ["--composed", "--realtime"],
    TWO_LEGS: ["--legs", "2"],
    "two legs, composed": ["--legs", "2", "--composed"],
}
OF_NODES = ("SIGKILL", "SIGSTOP", "SIGSTOP, then SIGKILL", "exit", "exception", "hang")
OF_PARENT = "entry script SIGKILL"
ASKED = ("entry script SIGTERM", "entry script SIGHUP", "entry script SIGINT, five times")
OF_BOTH = "entry script and recorder SIGKILL"


@dataclass(frozen=True)
class Kill:
    """A fault: how the run is made, which node, what happens to it, after how many ns, of which leg."""

    mode: str
    node: str
    act: str
    after_ns: int | None
    leg: str = ""

    @property
    def process(self) -> str:
        """The process that the message has to name."""
        inside = COMPOSED in self.mode and self.node != WRITER
        in_leg = self.leg and self.node != RECORDER
        name = COMPOSED if inside and (in_leg or not self.leg) else self.node
        return f"{self.leg}/{name}" if in_leg else name

    @property
    def kills_its_recorder(self) -> bool:
        """Whether who records cannot record the vent."""
        together = COMPOSED in self.mode and not self.leg and self.act != "exception" and self.node != WRITER
        return self.act not in (OF_PARENT, *ASKED) and (self.node == RECORDER or together)


@dataclass
class Ending:
    """What came of it: exit status, message, time to the end, data lost, and what is wrong about it."""

    kill: Kill
    status: int | None
    message: str
    took_s: float = np.nan
    lost_ms: float = np.nan
    vented: bool | None = None
    recovered: bool = False
    orphans: int = 0
    load: float = 0.0
    faults: list[str] = field(default_factory=list)


def kills(seed: int) -> Iterator[Kill]:
    """Yield faults without end: each mode with each act in random order; nodes and instants at random."""
    rng = np.random.default_rng(seed)
    kinds = [(mode, "", act) for mode in MODES for act in (*OF_NODES, OF_PARENT, *ASKED, OF_BOTH)]
    kinds += [(mode, WRITER, act) for mode in MODES if mode.startswith(COMPOSED) for act in OF_NODES]
    while True:
        for mode, node, act in rng.permutation(kinds):
            victim = str(node) or (RECORDER if act == OF_BOTH else str(rng.choice(TABLE.nodes)))
            started = rng.random() > 0.15 or act not in OF_NODES or victim == WRITER
            leg = str(rng.choice(LEGS)) if TWO_LEGS in mode else ""
            after_ns = int(rng.uniform(0.0, SECONDS) * 1e9)
            yield Kill(str(mode), victim, str(act), after_ns if started else None, leg)


def suffer(kill: Kill, folder: Path) -> Ending:
    """Start a run, let the fault happen in it, and look at what is left."""
    notes, bag = folder / "notes", folder / "bag"
    notes.mkdir(parents=True)
    fault = {**asdict(kill), "notes": str(notes)}
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
    ending = Ending(kill, status, lines[-1] if lines else "", load=os.getloadavg()[0])
    ending.orphans = _end_orphans(notes)
    _judge(ending, ended, notes, bag)
    return ending


def _awaited(process: subprocess.Popen, notes: Path) -> tuple[int | None, float]:
    """Wait for the entry script and all its processes; return its status and when the last was gone."""
    deadline = time.monotonic() + LIMIT_S
    while process.poll() is None or any(map(_alive, _pids(notes))):
        if time.monotonic() > deadline and process.poll() is None:
            process.terminate()
            process.wait()
            return None, time.time()
        if time.monotonic() > deadline:
            break
        time.sleep(0.01)
    return process.returncode, time.time()


def _pids(notes: Path) -> list[int]:
    return [int(note.name[4:]) for note in notes.glob("pid-*")]


def _alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def _end_orphans(notes: Path) -> int:
    """Kill what is left of the run; return how many processes that were."""
    left = [pid for pid in _pids(notes) if _alive(pid)]
    for pid in left:
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return len(left)


def _judge(ending: Ending, ended: float, notes: Path, bag: Path) -> None:
    kill, happened = ending.kill, notes / "fault"
    if not happened.exists():
        ending.faults = ["the fault did not happen"]
        return
    ending.took_s = ended - json.loads(happened.read_text())["wall"]
    recording = kill.after_ns is not None
    if recording:
        ending.recovered = _recover(bag)
        ending.lost_ms, ending.vented = _left(kill, bag, notes)
        ending.faults += _unreadable(bag)
    ending.faults += _faults(ending, recording)


def _recover(bag: Path) -> bool:
    """Call the verb `recover` if the bag is not closed; return whether that made it one."""
    if (bag / METADATA_FILE).exists() or not any(bag.glob("*.mcap")):
        return False
    recovered = bag.with_name("recovered")
    command = [*CLI, "recover", str(bag), "--out", str(recovered)]
    done = subprocess.run(command, capture_output=True, check=False)
    if done.returncode != 0:
        return False
    bag.rename(bag.with_name("damaged"))
    recovered.rename(bag)
    return True


def _unreadable(bag: Path) -> list[str]:
    """Return what readers that are not of this project have against a bag; none if nothing is in it."""
    if not (bag / METADATA_FILE).exists() and not any(map(_holds_messages, bag.glob("*.mcap"))):
        return []
    try:
        with AnyReader([bag]) as reader:
            of_rosbags = sum(1 for _ in reader.messages())
        of_mcap = 0
        for file in bag.glob("*.mcap"):
            with open(file, "rb") as stream:
                of_mcap += sum(1 for _ in make_reader(stream).iter_messages())
    except Exception as error:  # readers raise what they like
        return [f"unreadable: {type(error).__name__}: {error}"]
    return [] if of_rosbags == of_mcap else [f"rosbags reads {of_rosbags} messages, mcap {of_mcap}"]


def _holds_messages(file: Path) -> bool:
    with open(file, "rb") as stream, suppress(McapError):
        return any(isinstance(record, Message) for record in StreamReader(stream).records)
    return False


def _left(kill: Kill, bag: Path, notes: Path) -> tuple[float, bool | None]:
    """Return data lost, ms, and whether the last commands or the last pressures are those of the vent.

    Whoever is dead cannot vent: nothing is asked of a bag that was recorded by the process that died.
    """
    lost_ms = []
    for note in notes.glob("reached-*"):
        reached_ns, leg = int(note.read_text() or 0), note.name.partition("-")[2]
        try:
            stamps = read_bag(bag, ["angle"], namespace=f"/{leg}" if leg else "")["angle"].stamp_ns
        except OrthosisError:  # at the very beginning nothing is on the disk yet
            return kill.after_ns / 1e6, None
        lost_ms.append(max(0.0, (reached_ns - int(stamps[-1])) / 1e6))
    vented = None if kill.kills_its_recorder or kill.act == OF_BOTH else _vented(bag, kill)
    return max(lost_ms), vented


def _vented(bag: Path, kill: Kill) -> bool:
    p, namespace = load(), f"/{kill.leg}" if kill.leg else ""
    names = [f"{muscle}_voltage" for muscle in ("extensor", "flexor")]
    pressures = [f"truth_{muscle}_pressure" for muscle in ("extensor", "flexor")]
    recorded = read_bag(bag, names + pressures, namespace=namespace)
    commanded = all(recorded[name].value[-1] == p.valve.minimum_voltage for name in names)
    let_out = all(recorded[name].value[-1] < 1.5 * p.valve.ambient_pressure for name in pressures)
    if kill.process.endswith(COMPOSED) and kill.act not in (OF_PARENT, *ASKED, "exception"):
        return True  # plant and valves died together
    of_node = {VALVE: let_out, PLANT: commanded} if kill.act in OF_NODES else {}
    return of_node.get(kill.node, commanded and let_out)


def _faults(ending: Ending, recording: bool) -> Iterator[str]:
    kill = ending.kill
    if ending.status is None:
        yield "no end"
    if ending.orphans:
        yield f"{ending.orphans} orphans"
    if "Traceback" in ending.message or "unforeseen" in ending.message:
        yield f"traceback: {ending.message}"
    if kill.act in ASKED and (ending.status != 3 or "interrupted" not in ending.message):
        yield f"exit status {ending.status}: {ending.message}"
    if kill.act in OF_NODES:
        if ending.status != 3:
            yield f"exit status {ending.status}"
        if kill.process not in ending.message and kill.node not in ending.message:
            yield f"{kill.process} not named: {ending.message}"
    if recording and not ending.lost_ms <= LOST_MS:
        yield f"lost {ending.lost_ms:.0f} ms"
    if ending.vented is False:
        yield "the valves do not vent"


@contextmanager
def burners(count: int) -> Iterator[None]:
    """Let so many processes want the processor all the time, for as long as this one lives."""
    burn = f"import os\nwhile os.getppid() == {os.getpid()}: pass"
    started = [subprocess.Popen([sys.executable, "-S", "-c", burn]) for _ in range(count)]
    try:
        yield
    finally:
        for process in started:
            process.kill()
            process.wait()


def campaign(work: Path, count: int, seed: int, load: int, rows: Path) -> list[dict]:
    """Let so many faults happen beside a load; each is kept in a file, whose rows are not done again."""
    told = {"seed": seed, "load": load, "rows": []}
    if rows.exists():
        told = json.loads(rows.read_text())
        if (told["seed"], told["load"]) != (seed, load):
            raise SystemExit(f"{rows} holds rows of --seed {told['seed']} --load {told['load']}")
    rows.parent.mkdir(parents=True, exist_ok=True)
    with burners(load):
        for number, kill in enumerate(islice(kills(seed), count)):
            if number < len(told["rows"]):
                continue
            told["rows"].append(_row(suffer(kill, work / f"{number}"), load))
            rows.write_text(json.dumps(told, indent=1) + "\n")
            print(_line(number, told["rows"][-1]), file=sys.stderr, flush=True)
    return told["rows"][:count]


def _row(ending: Ending, load: int) -> dict:
    row = asdict(ending)
    row |= row.pop("kill")
    numbers = {key: None if np.isnan(row[key]) else round(row[key], 3) for key in ("took_s", "lost_ms")}
    return row | numbers | {"in_time": bool(ending.took_s <= limit_s(load)), "load": round(ending.load, 1)}


def limit_s(load: int) -> float:
    """Return within which time a run has to end."""
    return END_BESIDE_LOAD_S if load else END_S


def _line(number: int, row: dict) -> str:
    at = "start" if row["after_ns"] is None else f"{row['after_ns'] / 1e9:.2f} s"
    faults = "; ".join(row["faults"]) or ("good" if row["in_time"] else "late")
    return (
        f"{number} {row['mode']}, {row['act']} of {row['leg']} {row['node']} at {at}: {row['took_s']} s, lost"
        f" {row['lost_ms']} ms, vented {row['vented']}, load average {row['load']}: {faults}"
    )


def summary(rows: list[dict]) -> dict:
    """Return, by mode and act: tried, wrong, time to the end (median, longest), largest loss, vented."""
    told = {}
    for key in dict.fromkeys((row["mode"], _victim(row), row["act"]) for row in rows):
        mine = [row for row in rows if (row["mode"], _victim(row), row["act"]) == key]
        took = [row["took_s"] for row in mine if row["took_s"] is not None] or [np.nan]
        told[": ".join((key[0], " ".join(key[1:]).strip()))] = {
            "tried": len(mine),
            "in_time": sum(row["in_time"] for row in mine),
            "median_s": round(float(np.median(took)), 2),
            "longest_s": round(max(took), 2),
            "lost_ms": max((row["lost_ms"] for row in mine if row["lost_ms"] is not None), default=0.0),
            "vented": sum(row["vented"] is True for row in mine),
            "asked_to_vent": sum(row["vented"] is not None for row in mine),
            "recovered": sum(row["recovered"] for row in mine),
            "orphans": sum(row["orphans"] for row in mine),
            "wrong": [f"{row['node']}: {fault}" for row in mine for fault in row["faults"]],
        }
    return told


def _victim(row: dict) -> str:
    return "bag writer" if row["node"] == WRITER else ""


def table(told: dict) -> str:
    """Return a summary as lines of text, all kills together last."""
    lines = [f"{'fault':62s} {'tried':>5s} {'in time':>7s} {'longest':>7s} {'lost':>7s} {'vented':>7s} wrong"]
    for name, each in sorted(told.items()):
        vented = f"{each['vented']}/{each['asked_to_vent']}"
        lines.append(
            f"{name:62s} {each['tried']:5d} {each['in_time']:7d} {each['longest_s']:5.2f} s"
            f" {each['lost_ms']:4.0f} ms {vented:>7s} {'; '.join(each['wrong']) or '-'}"
        )
    total = {key: sum(each[key] for each in told.values()) for key in ("tried", "in_time", "orphans")}
    wrong = sum(bool(each["wrong"]) for each in told.values())
    last = f"{total['tried']} tried, {total['in_time']} in time, {total['orphans']} orphans"
    return "\n".join([*lines, f"{last}, {wrong} kinds with anything wrong"])
