# SPDX-License-Identifier: Apache-2.0
"""Somebody else speaks on each topic, offers each service, takes a node's name: how do real runs end?

How soon is told, and makes nothing wrong by itself: it depends on the load of the machine.
"""

from __future__ import annotations

import json
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.rosbag2 import ReaderError
from rosbags.typesys import Stores, get_typestore
from zstandard import ZstdError

from pam_orthosis.bag.topics import Topics, in_leg, resolve
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.model.machines import KNEE
from pam_orthosis.nodes import launch

TABLE = Topics(KNEE)

LIMIT_S, END_S = 90.0, 2.0  # of patience; what is promised beside no load
NAME = "stranger"
SPEAKER = [sys.executable, str(Path(__file__).with_name("stranger.py"))]
RUN = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--open", "--duration", "3600"]
QUICK = ["--param", "scenario.start_hold=0.1", "--param", "scenario.start_ramp=0.5"]
MODES = {
    "lockstep": [],
    "composed": ["--composed"],
    "real time": ["--realtime"],
    "composed, real time": ["--composed", "--realtime"],
    "two legs": ["--legs", "2", "--composed"],
}
SERVICES = (
    *(f"trajectory_publisher/{name}" for name in ("start", "stop")),
    *(
        f"{node}/{name}"
        for node in ("inverse_valve_model", "plant_simulator")
        for name in ("emergency_stop", "reset")
    ),
)
LATCHED = ("ready", "configuration")
EARLY = "before the run"


@dataclass(frozen=True)
class Forgery:
    """How the run is made, what is forged (a topic, a service or a node), and whether before the run."""

    mode: str
    kind: str
    name: str
    early: bool = False

    @property
    def legs(self) -> tuple[str, ...]:
        """Namespaces of the run's legs."""
        return ("left", "right") if self.mode == "two legs" else ("",)

    def command(self) -> list[str]:
        """Return what starts the stranger; of two legs it speaks to the second."""
        leg = self.legs[-1]
        if self.kind != "publish":
            return [*SPEAKER, self.kind, f"{leg}/{self.name}" if leg and self.kind == "serve" else self.name]
        topic = _table(self.mode)[self.name]
        lockstep = "real time" not in self.mode and (topic.rate == "step" or self.name == "recorded")
        durability = "latched" if self.name in LATCHED else "kept" if lockstep else "volatile"
        return [*SPEAKER, "publish", in_leg(self.name, leg, self.legs), topic.type, durability]


@dataclass
class Ending:
    """What came of it: exit status, message, s from the first word to the end, and what is wrong about it."""

    forgery: Forgery
    status: int | None
    message: str
    took_s: float
    load: float
    faults: list[str] = field(default_factory=list)


def forgeries(modes: Sequence[str] = tuple(MODES)) -> Iterator[Forgery]:
    """Yield everything that can be forged, in all modes."""
    for mode in modes:
        for name, topic in _table(mode).items():
            if topic.subscribers and not topic.shared:
                yield Forgery(mode, "publish", name)
        yield from (Forgery(mode, "serve", name) for name in SERVICES)
        if mode != "two legs":
            yield Forgery(mode, "call", "position_controller")
        yield from (Forgery(mode, "publish", name, early=True) for name in LATCHED if name in _table(mode))


def campaign(work: Path, count: int, seed: int, rows: Path) -> list[dict]:
    """Forge so much, in an order of the seed; each is kept in a file, whose rows are not done again."""
    chosen = list(forgeries())
    random.Random(seed).shuffle(chosen)
    told = json.loads(rows.read_text()) if rows.exists() else {"seed": seed, "rows": []}
    if told["seed"] != seed:
        raise SystemExit(f"{rows} holds rows of --seed {told['seed']}")
    rows.parent.mkdir(parents=True, exist_ok=True)
    for number, forgery in list(enumerate(chosen))[len(told["rows"]) : count]:
        row = asdict(suffer(forgery, work / f"{number}"))
        row |= row.pop("forgery")
        in_time = row["early"] or row["took_s"] <= END_S  # who was there before has spoken long since
        told["rows"].append(row | {"took_s": round(row["took_s"], 2), "in_time": in_time})
        rows.write_text(json.dumps(told, indent=1) + "\n")
        print(number, *told["rows"][-1].values(), sep=", ", file=sys.stderr, flush=True)
    return told["rows"][:count]


def summary(rows: Sequence[dict]) -> dict[str, dict]:
    """Return, by mode: tried, ended in time, longest time to the end, what was wrong."""
    told = {}
    for mode in dict.fromkeys(row["mode"] for row in rows):
        mine = [row for row in rows if row["mode"] == mode]
        told[mode] = {
            "tried": len(mine),
            "in_time": sum(row["in_time"] for row in mine),
            "longest_s": max((row["took_s"] for row in mine if not row["early"]), default=None),
            "wrong": [f"{row['kind']} {row['name']}: {fault}" for row in mine for fault in row["faults"]],
        }
    return told


def suffer(forgery: Forgery, folder: Path) -> Ending:
    """Start a run and the stranger, who waits for it unless he is early; look at what is left."""
    folder.mkdir(parents=True, exist_ok=True)
    with launch.free_domain() as domain:  # until the end: an open run claims none for itself
        environment = {**launch.environment(folder, domain), "TMPDIR": str(folder)}
        return _suffered(forgery, environment, folder / "bag")


def _suffered(forgery: Forgery, environment: dict[str, str], bag: Path) -> Ending:
    stranger = _spoken(forgery.command(), environment) if forgery.early else None
    word = stranger.stdout.readline() if stranger else ""  # else he may come when the run is there
    command = [*RUN, "--out", str(bag), *QUICK, *MODES[forgery.mode]]
    run = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        if stranger is None:
            _wait(lambda: run.poll() is not None or _holds_messages(bag / "bag_0.mcap"))
            stranger = _spoken(forgery.command(), environment)
        if not (word := word or stranger.stdout.readline()):  # it has ended: its stderr says why
            run.terminate()
            run.communicate()
            return Ending(forgery, run.poll(), "", 0.0, os.getloadavg()[0], ["the stranger was not heard"])
        spoke = float(word.split()[1])
        said = run.communicate(timeout=LIMIT_S)[1].strip().splitlines()
        took_s = time.time() - spoke
    except subprocess.TimeoutExpired:
        run.terminate()
        said, took_s = run.communicate()[1].strip().splitlines(), LIMIT_S
        return Ending(forgery, None, said[-1], took_s, os.getloadavg()[0], ["no end"])
    finally:
        if stranger is not None:
            stranger.kill()
            stranger.wait()
    ending = Ending(forgery, run.returncode, said[-1] if said else "", took_s, os.getloadavg()[0])
    ending.faults = list(_faults(ending, bag))
    return ending


def _table(mode: str) -> dict:
    return TABLE.of_run(realtime="real time" in mode)


def _spoken(command: Sequence[str], environment: dict[str, str]) -> subprocess.Popen:
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)


def _wait(condition) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not condition() and time.monotonic() < deadline:
        time.sleep(0.02)


def _holds_messages(file: Path) -> bool:
    try:
        with open(file, "rb") as stream:
            return any(isinstance(record, Message) for record in StreamReader(stream).records)
    except (OSError, McapError, ZstdError):  # a chunk may be on disk by half
        return False


def _faults(ending: Ending, bag: Path) -> Iterator[str]:
    forgery = ending.forgery
    if ending.status != (2 if forgery.early else 3):  # refused, or ended
        yield f"exit status {ending.status}"
    culprit = NAME if forgery.kind != "call" else f"another node has the name /{forgery.name}"
    if culprit not in ending.message or forgery.name.lstrip("/") not in ending.message:
        yield f"not named: {ending.message}"
    if forgery.early:
        if _commands(bag, forgery.legs):
            yield "moved before everybody was there"
        return
    last = {name: values[-1] if values else None for name, values in _commands(bag, forgery.legs).items()}
    if set(last.values()) != {VENT}:
        yield f"last commands {last}"


def _commands(bag: Path, legs: Sequence[str]) -> dict[str, list[float]]:
    """Return the recorded commands for each valve, in the order of their stamps; none without a bag."""
    try:
        names = [resolve(f"{m}/valve_command", leg) for leg in legs for m in ("extensor", "flexor")]
        told: dict[str, list[float]] = {name: [] for name in names}
        with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
            chosen = [one for one in reader.connections if one.topic in told]
            for connection, _, data in reader.messages(chosen):
                told[connection.topic].append(reader.deserialize(data, connection.msgtype).position[0])
    except (OSError, AnyReaderError, ReaderError):  # nothing was recorded
        return {}
    return told if any(told.values()) else {}
