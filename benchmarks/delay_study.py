# SPDX-License-Identifier: Apache-2.0
"""The loop with its delay: how the knee follows on the shipped hardware and on worse; resumable.

    python benchmarks/delay_study.py run [--out FILE] [--seeds 10] [--only NAME...] [--jobs 2]
    python benchmarks/delay_study.py table [--out FILE]

Closed loop without ROS, all controllers as configured; one row a run. It says which gains it was made with,
so that a row that is there already is not made again, and a change of the gains makes new ones.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load, scenario_overrides

OUT = Path(__file__).parent / "results" / "delay_study.jsonl"
DURATION = 9.0  # s
WEARERS = {"nobody": "default", "person": "person"}
MUSCLES = ("extensor", "flexor")
LIMIT = 3.0  # deg
FRICTION = {"plant.effects.joint_friction.coulomb": 2.4, "plant.effects.viscous_friction.viscosity": 0.3}
HYSTERESIS = {"plant.effects.muscle_hysteresis.half_width": 36.0}
ENCODER = {"plant.sensor.angle_resolution": math.radians(0.1)}
SUPPLY = {"plant.deviation.supply_pressure": 6.0 / 7.0}
LAG = "plant.effects.valve_lag.natural_frequency"

GAINS = (
    "valve.delay", "control.observer.pole", "control.observer.damping", "control.position.c1",
    "control.position.c2", "control.pressure.gain", "control.pressure.reference_filter",
    "control.inverse_valve.dead_band_smoothing",
)  # fmt: skip
KEYS = ("hardware", "wearer", "seed", "cascade", "gains")
# the controllers as configured, and the paper's cascade: no predictor, with gains of its own by margin
PAPER = {
    "valve.delay": 0.0, "control.observer.pole": 70.0, "control.observer.damping": 0.5,
    "control.position.c1": 22.0, "control.position.c2": 22.0, "control.pressure.gain": 35.0,
}  # fmt: skip
# with a person the scenario has slower gains, for calm; these are the ones of a leg without a person
ONE_SET = {key: value for key, value in load().flat().items() if key in GAINS}
CASCADES: dict[str, dict[str, Any]] = {"predictor": {}, "paper": PAPER, "one gain set": ONE_SET}


def delayed(seconds: float) -> dict[str, Any]:
    """Return the overrides that give the hardware this dead time in all: its valves, beside its sensors."""
    sensor = load().plant.effects.extensor_pressure_delay.delay
    return {
        **{f"plant.delay.{name}": 0.0 for name in ("computing", "converter", "hose_length")},
        "plant.delay.valve": seconds - sensor,
    }


def hardware() -> dict[str, dict[str, Any]]:
    """Return the perturbations of the shipped hardware."""
    assumed = load().valve.delay
    return {
        "as shipped": {},
        "5 ms more than believed": delayed(assumed + 5e-3),
        "5 ms less than believed": delayed(assumed - 5e-3),
        "valve of 30 Hz": {LAG: 30.0},
        "friction x3": FRICTION,
        "hysteresis x3": HYSTERESIS,
        "supply of 6 bar": SUPPLY,
        "encoder of 0.1 deg": ENCODER,
        "control at 100 Hz": {"scenario.control_period": 0.01},
        "together": {**FRICTION, **HYSTERESIS, LAG: 50.0, **ENCODER, **SUPPLY},
    }


def follow(
    scenario: str, overrides: dict[str, Any], seed: int, duration: float = DURATION
) -> dict[str, float]:
    """Return how the knee follows: errors in degrees, variation of each valve's voltage in V/s."""
    p = load({**scenario_overrides(scenario), **overrides})
    run = ClosedLoop(p, seed).run(round(duration / p.scenario.control_period))
    error = np.degrees(run["reference_angle"] - run["angle"])
    rest = (run["time"] > 0.5) & (run["time"] < 1.0)
    moved = {f"{m}_variation": float(np.abs(np.diff(run[f"{m}_voltage"])).sum()) / duration for m in MUSCLES}
    return {
        "maximum": float(np.abs(error).max()),
        "rms": float(np.sqrt(np.mean(error**2))),
        "steady": float(np.abs(error[rest]).mean()),
        **moved,
    }


def made(name: str, wearer: str, overrides: dict[str, Any], seed: int, cascade: str) -> dict[str, Any]:
    """Return a row: what was run, and how the knee followed."""
    told = identity(name, wearer, seed, cascade)
    return told | follow(WEARERS[wearer], {**overrides, **CASCADES[cascade]}, seed)


def identity(name: str, wearer: str, seed: int, cascade: str) -> dict[str, Any]:
    """Return what a row tells of how it was made."""
    return dict(zip(KEYS, (name, wearer, seed, cascade, gains(wearer, cascade)), strict=True))


def gains(wearer: str, cascade: str) -> dict[str, float]:
    """Return what the controllers were set to: rows that do not agree are of other gains."""
    p = load({**scenario_overrides(WEARERS[wearer]), **CASCADES[cascade]}).flat()
    return {key: p[key] for key in GAINS}


def missing(out: Path, seeds: int, only: list[str], cascades: list[str]) -> Iterator[tuple]:
    """Yield what has no row yet."""
    known = {json.dumps([row[key] for key in KEYS]) for row in rows(out)}
    named = {name: overrides for name, overrides in hardware().items() if not only or name in only}
    for seed, (name, overrides), wearer, cascade in product(
        range(1, seeds + 1), named.items(), WEARERS, cascades
    ):
        if json.dumps([*identity(name, wearer, seed, cascade).values()]) not in known:
            yield name, wearer, overrides, seed, cascade


def rows(out: Path) -> list[dict]:
    """Return the rows of a file; none if it is not there."""
    return [json.loads(line) for line in out.read_text().splitlines()] if out.exists() else []


def run(out: Path, seeds: int, only: list[str], cascades: list[str], jobs: int) -> None:
    """Make the rows that are missing."""
    out.parent.mkdir(parents=True, exist_ok=True)
    todo = list(missing(out, seeds, only, cascades))
    with ProcessPoolExecutor(jobs) as pool, out.open("a") as stream:
        tasks = [pool.submit(made, *each) for each in todo]
        for number, task in enumerate(as_completed(tasks), start=1):
            stream.write(json.dumps(task.result()) + "\n")
            stream.flush()
            print(f"{number} of {len(todo)}", file=sys.stderr)


def table(out: Path) -> None:
    """Print the worst of the seeds of each hardware, with the present gains."""
    print("| hardware | worn by | cascade | runs | maximum | RMS | steady | variation | above 3 deg |")
    print("|---|---|---|---|---|---|---|---|---|")
    for name, wearer, cascade in product(hardware(), WEARERS, CASCADES):
        own = {"hardware": name, "wearer": wearer, "cascade": cascade, "gains": gains(wearer, cascade)}
        same = [row for row in rows(out) if all(row[key] == value for key, value in own.items())]
        if same:
            worst = {key: max(row[key] for row in same) for key in ("maximum", "rms", "steady")}
            moved = max(row[f"{m}_variation"] for row in same for m in MUSCLES)
            lost = sum(row["maximum"] > LIMIT for row in same)
            errors = " | ".join(f"{value:.2f}" for value in worst.values())
            print(f"| {name} | {wearer} | {cascade} | {len(same)} | {errors} | {moved:.0f} V/s | {lost} |")


def main() -> None:
    """Run the study or print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=["run", "table"])
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--only", nargs="*", default=[], metavar="HARDWARE")
    parser.add_argument("--cascades", nargs="*", default=["predictor"], choices=CASCADES)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    if given.what == "run":
        run(given.out, given.seeds, given.only, given.cascades, given.jobs)
    table(given.out)


if __name__ == "__main__":
    main()
