# SPDX-License-Identifier: Apache-2.0
"""Wrong parameters of the nominal model: is each one named, and how near is its value? Resumable.

    python benchmarks/gap_wrong.py [--out benchmarks/results/gap_wrong.jsonl] [--seed N] [--limit N]

The hidden plant has another value, its nuisance parameters are off by 0.7 of their tolerance beside it. The
search gets the recordings and the nominal model.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from gap_table import read, work_off
from gate_gap import record

from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.suspects import name_of
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.testing import case as cases

RESULTS = Path(__file__).resolve().parent / "results" / "gap_wrong.jsonl"
NEAR = 0.05  # of the value, or of 1 rad or 0.2 m where it may be zero
MUSCLE = "muscle.dmsp_20.length"
# key, value over the nominal one, or what is added to it
WRONG = (
    ("leg.cogwheel_diameter", "x1.4"), ("leg.cogwheel_diameter", "x0.8"), ("leg.symmetric_angle", "+0.3"),
    ("leg.symmetric_angle", "-0.2"), ("leg.symmetric_contraction", "x1.25"),
    ("leg.symmetric_contraction", "x0.75"), ("leg.thigh.length", "x1.25"), ("leg.shank.length", "x0.8"),
    ("leg.bearing_height", "+0.1"), ("leg.shoe_mass", "x1.8"), ("leg.knee_mass", "x2"),
    ("leg.thigh.mass", "x2"), ("leg.shank.mass", "x1.7"), ("valve.supply_pressure", "x1.2"),
    ("valve.supply_pressure", "x1.4"), ("valve.conductance", "x0.6"), ("valve.conductance", "x1.5"),
    ("valve.hose.volume", "x2"), (MUSCLE, "x0.8"), (MUSCLE, "x1.2"),
)  # fmt: skip


def solve(case: dict, tools: dict) -> dict:
    """Record a case, search it, and return what was named beside what was wrong."""
    if not tools:
        parameters = cases.nominal()
        tools.update(parameters=parameters, replay=Replay(knee(parameters)))
    parameters, replay, key = tools["parameters"], tools["replay"], case["key"]
    nominal, size = parameters.flat()[key], float(case["by"].lstrip("x"))
    true = nominal * size if case["by"].startswith("x") else nominal + size
    seed = case["number"] + len(WRONG) * case.get("seed", 0)
    secret = cases.draw(np.random.default_rng([seed, 79]), parameters, "clean", "medium", 0)
    arrays = record(secret, seed, {key: true})
    *training, held_out = (from_arrays(name, replay.system, one) for name, one in arrays.items())
    start = time.monotonic()
    outcome = find_gap(replay.system, training, [held_out], parameters.gap, replay=replay)
    named = {one.name: next(iter(one.parameters.values())) for one in outcome.effects}
    found = {
        "verdict": outcome.verdict,
        "effects": list(named),
        "seconds": round(time.monotonic() - start, 1),
    }
    # a heavier shoe and a mass at the foot are one thing
    wrong, off = (name_of(key), 0.0) if key != "leg.shoe_mass" else ("extra_foot_mass", nominal)
    if wrong in named:
        value, _, low, high = named[wrong]
        scale = {"leg.symmetric_angle": 1.0, "leg.bearing_height": 0.2}.get(key, true)
        found |= {"value": value + off, "interval": [low + off, high + off]}
        found["error"] = abs(value + off - true) / scale
    right = list(named) == [wrong] and found["error"] < NEAR
    return {**case, "nominal": nominal, "true": true, **found, "right": right}


def main() -> None:
    """Solve the cases that the results file does not hold yet; print how many were named rightly."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--seed", type=int, default=0, help="of deviations and noise")
    parser.add_argument("--limit", type=int)
    arguments = parser.parse_args()
    out = arguments.out
    known = {case["number"] for case in read(out)} if out.exists() else set()
    plan = [
        {"number": n, "seed": arguments.seed, "key": key, "by": by}
        for n, (key, by) in enumerate(WRONG)
        if n not in known
    ]
    work_off(plan, arguments.limit, solve, out, str)
    results = read(out)
    print(f"{sum(bool(r.get('right')) for r in results)} of {len(results)} named, within {NEAR:.0%}")


if __name__ == "__main__":
    main()
