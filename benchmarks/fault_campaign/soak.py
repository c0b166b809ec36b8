# SPDX-License-Identifier: Apache-2.0
"""A long walk whose processes are all killed in the end.

Does memory grow, does a step get lost, does the knee drift away from its reference, how long does it take to
close the bag?
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import yaml
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.bag.recover import recover_in_place
from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

PROGRESS = re.compile(r"ROS domain \d+: ([\d.]+) of")
LEFT_S = 60.0  # of the run when it is killed
MOST_LOST_S, MOST_CLOSE_S = 0.5, 2.0
WINDOW_S = 60.0
SETTLED_SHARE = 0.1  # of the run, in which everything is loaded that ever will be


def walk(bag: Path, seconds: float, options: list[str]) -> dict:
    """Let the knee walk, then kill all at once; return how far it came and the memory of the nodes (MiB)."""
    command = [sys.executable, "-m", "pam_orthosis.cli.main", "run", "--out", str(bag), *options]
    began, memory, reached_s = time.monotonic(), [], 0.0
    with subprocess.Popen(
        [*command, "--duration", f"{seconds + LEFT_S:g}"],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    ) as process:
        for line in process.stderr:
            reached = PROGRESS.search(line)
            used = _resident(process.pid) if reached else 0.0
            if used:
                reached_s = float(reached[1])
                memory.append((reached_s, used))
            if reached_s >= seconds:
                _kill(process.pid)
                break
        process.wait()
    return {
        "status": process.returncode,
        "wall_s": time.monotonic() - began,
        "reached_s": reached_s,
        "memory": np.array(memory).reshape(-1, 2),
    }


def _kill(pid: int) -> None:
    """Kill a process and all that it has started, and wait until they are gone."""
    family = [pid]
    for one in family:
        family += map(int, _text(Path(f"/proc/{one}/task/{one}/children")).split())
    for one in family:
        os.kill(one, signal.SIGKILL)
    while any(_text(Path(f"/proc/{one}/cmdline")) for one in family[1:]):
        time.sleep(0.01)


def _resident(parent: int) -> float:
    """Return the resident memory of all children of a process, MiB."""
    children = Path(f"/proc/{parent}/task/{parent}/children")
    texts = [_text(Path(f"/proc/{pid}/status")) for pid in _text(children).split()]
    return sum(int(found[1]) for text in texts if (found := re.search(r"VmRSS:\s+(\d+) kB", text))) / 1024


def _text(path: Path) -> str:
    try:
        return path.read_text()
    except OSError:  # the process has ended
        return ""


def growth(memory: np.ndarray) -> dict:
    """Return memory after the start and at the end, MiB, and the slope between, MiB per simulated hour."""
    settled = memory[memory[:, 0] >= SETTLED_SHARE * memory[-1, 0]]
    slope = np.polyfit(settled[:, 0] / 3600, settled[:, 1], 1)[0] if len(settled) > 2 else np.nan
    return {
        "memory_start_mib": round(settled[0, 1], 1),
        "memory_end_mib": round(memory[-1, 1], 1),
        "memory_growth_mib_per_hour": round(float(slope), 2),
    }


def closed(bag: Path) -> dict:
    """Close the bag where it is; return how long that takes and whether it can be read."""
    began, busy = time.monotonic(), time.process_time()
    messages = recover_in_place(bag)
    told = {
        "close_s": round(time.monotonic() - began, 2),
        "close_cpu_s": round(time.process_time() - busy, 2),
    }
    with Reader(bag) as reader:
        by_rosbags = reader.message_count
    last = max(bag.glob("*.mcap"), key=lambda file: int(file.stem.rpartition("_")[2]))
    with open(last, "rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        there = sum(1 for _ in reader.iter_messages())
        whole = there == reader.get_summary().statistics.message_count and by_rosbags == messages
    return told | {"messages": messages, "readable": whole}


def lost(bag: Path, period_s: float) -> dict:
    """Return how many messages are missing between others, over all topics that each step has.

    The last step may have been cut in the middle: its topics differ by one message at most.
    """
    told = yaml.safe_load((bag / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    counts = {
        one["topic_metadata"]["name"].lstrip("/"): one["message_count"]
        for one in told["topics_with_message_count"]
    }
    per_step = [topic.name.lstrip("/") for topic in TABLE.recorded if topic.rate == "step"]
    steps = round(told["duration"]["nanoseconds"] * 1e-9 / period_s) + 1  # the bag begins with the first one
    missing = [max(0, steps - 1 - counts[name]) for name in per_step]
    return {"steps": steps, "recorded_s": steps * period_s, "lost_messages": sum(missing)}


def drift(bag: Path, cycle_s: float, after_s: float) -> dict:
    """Return how the gait's fundamental moves against the clock and the knee against it, first to last.

    `reference_drift_us`: of the reference against the stamps. `lag_ms`: of the knee behind the reference
    in the first window; `lag_drift_us`: how far that has moved by the last one.
    """
    recorded = read_bag(bag, ["reference_angle", "angle"])
    stamps, (reference, angle) = aligned(recorded["reference_angle"], recorded["angle"])
    seconds = stamps * 1e-9
    wave = np.exp(-2j * np.pi * seconds / cycle_s)
    window = WINDOW_S if seconds[-1] - after_s > 2 * WINDOW_S else 2 * cycle_s
    first = (seconds >= after_s) & (seconds < after_s + window)
    whole = (seconds[-1] - after_s) // cycle_s * cycle_s  # the last window covers the same phases
    last = (seconds >= after_s + whole - window) & (seconds < after_s + whole)
    phases = {
        name: [np.angle(np.sum(values[part] * wave[part])) for part in (first, last)]
        for name, values in (("reference", reference), ("angle", angle))
    }
    by_phase = cycle_s / (2 * np.pi)
    lags = [by_phase * (phases["reference"][i] - phases["angle"][i]) for i in (0, 1)]
    moved = np.angle(np.exp(1j * (phases["reference"][1] - phases["reference"][0])))
    errors = [np.abs(reference - angle)[part].max() for part in (first, last)]
    return {
        "reference_drift_us": round(by_phase * moved * 1e6, 3),
        "lag_ms": round(lags[0] * 1e3, 3),
        "lag_drift_us": round((lags[1] - lags[0]) * 1e6, 1),
        "largest_error_first_minute_deg": round(float(np.rad2deg(errors[0])), 3),
        "largest_error_last_minute_deg": round(float(np.rad2deg(errors[1])), 3),
    }


def soak(bag: Path, seconds: float, options: list[str]) -> dict:
    """Walk, kill, close, judge."""
    walked = walk(bag, seconds, options)
    told = {"seconds": seconds, "status": walked["status"], "wall_s": round(walked["wall_s"], 1)}
    if walked["reached_s"] < seconds:
        return told
    told |= closed(bag) | growth(walked["memory"])
    parameters = read_bag(bag, ["angle"]).parameters
    period, cycle = parameters["scenario.control_period"], parameters["scenario.cycle_time"]
    settled = parameters["scenario.start_hold"] + parameters["scenario.start_ramp"]
    after = np.ceil(settled / cycle) * cycle
    told |= lost(bag, period)
    told["lost_at_the_end_s"] = round(max(0.0, walked["reached_s"] - told["recorded_s"]), 3)
    return told | drift(bag, cycle, float(after))


def wrong(told: dict) -> bool:
    """Whether the walk ended early, lost something, or its bag could not be closed in time."""
    return (
        told.get("lost_messages") != 0
        or told["lost_at_the_end_s"] > MOST_LOST_S
        or told["close_s"] > MOST_CLOSE_S
        or not told["readable"]
    )
