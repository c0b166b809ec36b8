# SPDX-License-Identifier: Apache-2.0
"""Campaigns of faults: each adds what it found to benchmarks/results/faults.json.

python benchmarks/faults.py all
python benchmarks/faults.py input|signals|guards|kills|returns|strangers|soak [--count N] [--seed N]
python benchmarks/faults.py kills --count 120 --seed 26 --load 8 --out benchmarks/results/kills-load8.json

Kills, returns and input keep each as a row in a file of their own (`--out`) and go on behind the last.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from fault_campaign import inputs, kills, returns, signals, soak, strangers

ROOT = Path(__file__).resolve().parents[1]
WALK, ROWS = ROOT / "bags" / "walk", ROOT / "benchmarks" / "results"
RESULTS = ROWS / "faults.json"


def run_input(work: Path, count: int, seed: int, rows: Path | None = None) -> dict:
    """Mutated bags, YAML, tables, options, folders, for every verb that reads a file."""
    (work / "base").mkdir(parents=True)
    rows = inputs.campaign(work, WALK, count, seed, rows or ROWS / f"input-seed{seed}.json")
    told, verbs = inputs.summary(rows), inputs.summary(rows, by="verb")
    print(inputs.table(told), inputs.table(verbs), sep="\n\n")
    return {"kinds": told, "verbs": verbs, "wrong": sum(bool(row["faults"]) for row in rows)}


def run_signals(_work: Path, count: int, seed: int) -> dict:
    """Sensors, commands, valves and supply that misbehave, each at so many instants."""
    faults = signals.summary(signals.campaign(count, seed))
    return {"faults": faults, "wrong": sum(len(each["wrong"]) for each in faults.values())}


def run_guards(_work: Path, count: int, seed: int) -> dict:
    """Guards that are taken out on purpose; wrong is what the campaign of signals does not find."""
    told = {}
    for name, only in signals.REMOVED.items():
        with signals.without(name):
            faults = signals.summary(signals.campaign(count, seed, only))
        told[name] = {fault: {key: each[key] for key in ("tried", "wrong")} for fault, each in faults.items()}
    unseen = [name for name, faults in told.items() if not any(each["wrong"] for each in faults.values())]
    return {"removed": told, "wrong": len(unseen)}


def run_kills(work: Path, count: int, seed: int, load: int = 0, rows: Path | None = None) -> dict:
    """Nodes, recorder, bag writer and entry script that die or stop at random instants, beside a load."""
    rows = rows or ROWS / f"kills-seed{seed}.json"
    done = kills.campaign(work, count, seed, load, rows)
    told = kills.summary(done)
    print(kills.table(told))
    return {"kills": told, "wrong": sum(bool(row["faults"]) or not row["in_time"] for row in done)}


def run_returns(work: Path, count: int, _seed: int, rows: Path | None = None) -> dict:
    """Nodes and the driver that leave, or are killed, and come again while the others go on."""
    done = returns.campaign(work, count, rows or ROWS / "returns.json")
    return {"returns": done, "wrong": sum(bool(row["faults"]) for row in done)}


def run_strangers(work: Path, count: int, seed: int) -> dict:
    """Messages, services and names of nodes, forged by somebody else in the ROS domain of a run."""
    done = strangers.campaign(work, count, seed, ROWS / f"strangers-seed{seed}.json")
    return {
        "strangers": strangers.summary(done),
        "wrong": sum(bool(row["faults"]) or not row["in_time"] for row in done),
    }


def run_soak(work: Path, count: int, seed: int) -> dict:
    """So many seconds of walking, then all is killed."""
    told = soak.soak(work / "soak", float(count), ["--composed", "--seed", str(seed)])
    return told | {"wrong": int(soak.wrong(told))}


class Campaign(NamedTuple):
    """A campaign and how much of it is done if nothing is said."""

    run: Callable[[Path, int, int], dict]
    count: int


CAMPAIGNS = {
    "input": Campaign(run_input, 600),
    "signals": Campaign(run_signals, 3),
    "guards": Campaign(run_guards, 1),
    "kills": Campaign(run_kills, 63),
    "returns": Campaign(run_returns, 66),
    "strangers": Campaign(run_strangers, 200),
    "soak": Campaign(run_soak, 3600),
}


def carry_out(name: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Run a campaign and keep what it found; return it."""
    count = arguments.count or CAMPAIGNS[name].count
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-faults-") as folder:
        told = CAMPAIGNS[name].run(arguments.work or Path(folder), count, arguments.seed)
    told = {"count": count, "seed": arguments.seed, "load_average": round(os.getloadavg()[1], 1), **told}
    results = json.loads(arguments.out.read_text()) if arguments.out.exists() else {}
    arguments.out.write_text(json.dumps(results | {name: told}, indent=1) + "\n")
    return told


def count_kills(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the campaign of kills beside a load, with a file of rows of its own."""
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-faults-") as folder:
        count = arguments.count or CAMPAIGNS["kills"].count
        work = arguments.work or Path(folder)
        return run_kills(work, count, arguments.seed, arguments.load, arguments.out)


def main() -> int:
    """Run campaigns; return 0 if they found nothing wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("campaign", choices=[*CAMPAIGNS, "all"])
    parser.add_argument("--count", type=int, help="inputs, instants of each fault, kills, or seconds")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=Path, help="keep what the campaign works with here")
    parser.add_argument("--load", type=int, default=0, help="of kills: processes that want the processor")
    parser.add_argument("--out", type=Path, help="file of results, of kills, returns and input: of rows")
    arguments = parser.parse_args()
    if arguments.campaign in ("input", "returns") and arguments.out:
        campaign = CAMPAIGNS[arguments.campaign]
        with tempfile.TemporaryDirectory(prefix="pam-orthosis-faults-") as folder:
            count, work = arguments.count or campaign.count, arguments.work or Path(folder)
            return 1 if campaign.run(work, count, arguments.seed, arguments.out)["wrong"] else 0
    if arguments.campaign == "kills" and arguments.out:
        return 1 if count_kills(arguments)["wrong"] else 0
    arguments.out = arguments.out or RESULTS
    names = list(CAMPAIGNS) if arguments.campaign == "all" else [arguments.campaign]
    told = {name: carry_out(name, arguments) for name in names}
    print(json.dumps(told, indent=1))
    return 1 if any(each["wrong"] for each in told.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
