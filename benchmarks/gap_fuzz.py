# SPDX-License-Identifier: Apache-2.0
"""Recordings of another apparatus than the model's: is it ever called explained, or `none`? Resumable.

    python benchmarks/gap_fuzz.py --seed N [--out FILE] [--limit N]

Signals are swapped or bent by their sensor, or the hidden knee moves another load. The seed gives the sizes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from gap_table import read, work_off
from gate_gap import record
from numpy.random import Generator

from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.errors import OrthosisError
from pam_orthosis.testing import case as cases
from pam_orthosis.testing import loads

COUNT = 50
FALSE = ("none", "recalibrated", "explained")  # verdicts that call another apparatus this one
MUSCLES = "extensor", "flexor"
Arrays = dict[str, np.ndarray]


def _swapped(kind: str) -> Callable[[Arrays, float], Arrays]:
    first, second = (f"{name}_{kind}" for name in MUSCLES)
    return lambda a, _: {**a, first: a[second], second: a[first]}


def _bent(name: str, low: float, high: float) -> Callable[[Arrays, float], Arrays]:
    """Return a sensor that shows a parabola: right at both ends of a range, off by `size` of it halfway."""

    def bend(a: Arrays, size: float) -> Arrays:
        place = (a[name] - low) / (high - low)
        return {**a, name: a[name] + size * (high - low) * 4 * place * (1 - place)}

    return bend


# what happens to recorded signals, with least and largest size
SENSORS: dict[str, tuple[Callable[[Arrays, float], Arrays], float, float]] = {
    "pressures swapped": (_swapped("pressure"), 0.0, 0.0),
    "voltages swapped": (_swapped("voltage"), 0.0, 0.0),
    "angle bent": (_bent("angle", 0.0, 1.3), 0.05, 0.15),
    "extensor pressure bent": (_bent("extensor_pressure", 1e5, 7e5), 0.04, 0.1),
    "flexor pressure bent": (_bent("flexor_pressure", 1e5, 7e5), 0.04, 0.1),
    "angle of the other sign": (lambda a, size: {**a, "angle": size - a["angle"]}, 1.2, 1.4),
}


def _pendulum(rng: Generator) -> np.ndarray:
    """Return (6, n): a rigid pendulum about the knee in place of the leg on its bearing."""
    q = loads.TABLE_START + loads.TABLE_STEP * np.arange(loads.TABLE_SIZE)
    inertia, weight = rng.uniform(0.15, 0.6), rng.uniform(4.0, 15.0)
    row = np.ones_like(q)
    return np.array([inertia * row, 0 * q, weight * np.sin(q - rng.uniform(0, 0.8)), 0.1 * row, 0 * q, 0 * q])


def _sprung(rng: Generator, usual: np.ndarray) -> np.ndarray:
    """Return (6, n): the leg beside a spring that snaps from one side to the other, and a cam."""
    q = loads.TABLE_START + loads.TABLE_STEP * np.arange(loads.TABLE_SIZE)
    table = usual.copy()
    table[2] += rng.uniform(3.0, 8.0) * np.sin(rng.uniform(5.0, 9.0) * q + rng.uniform(0, 6.3))
    return table


LOADS: dict[str, Callable[[Generator, np.ndarray], np.ndarray]] = {
    "a pendulum": lambda rng, usual: _pendulum(rng),
    "a cam": _sprung,
}
KINDS = (*SENSORS, *LOADS)


def solve(case: dict, tools: dict) -> dict:
    """Record a case and return what the search answers."""
    if not tools:
        parameters = cases.nominal()
        tools.update(parameters=parameters, replay=Replay(knee(parameters)))
    parameters, replay, kind = tools["parameters"], tools["replay"], case["kind"]
    seed = COUNT * case["seed"] + case["number"]
    rng = np.random.default_rng([seed, 83])
    secret = cases.draw(rng, parameters, "clean", "medium", 0)
    if kind in LOADS:
        usual = loads.leg_table(parameters.leg, 1.0)
        secret = replace(secret, misfits={"load": LOADS[kind](rng, usual)})
    made = record(secret, seed)
    size = 0.0
    if kind in SENSORS:
        bend, least, most = SENSORS[kind]
        size = rng.uniform(least, most) * (rng.choice([-1, 1]) if "bent" in kind else 1)
        made = {name: bend(arrays, size) for name, arrays in made.items()}
    start = time.monotonic()
    try:
        *training, held_out = (from_arrays(name, replay.system, one) for name, one in made.items())
        outcome = find_gap(replay.system, training, [held_out], parameters.gap, replay=replay)
    except OrthosisError as error:
        return {**case, "size": size, "verdict": "refused", "why": str(error)}
    return {
        **case, "size": size, "verdict": outcome.verdict, "effects": [one.name for one in outcome.effects],
        "foreign": outcome.foreign, "seconds": round(time.monotonic() - start, 1),
    }  # fmt: skip


def plan(seed: int) -> list[dict]:
    """Return the cases of a seed; kinds take turns."""
    return [{"number": n, "seed": seed, "kind": KINDS[n % len(KINDS)]} for n in range(COUNT)]


def main() -> None:
    """Solve the cases that the results file does not hold yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--limit", type=int)
    arguments = parser.parse_args()
    known = {one["number"] for one in read(arguments.out)} if arguments.out.exists() else set()
    todo = [case for case in plan(arguments.seed) if case["number"] not in known]
    work_off(todo, arguments.limit, solve, arguments.out, str)


if __name__ == "__main__":
    main()
