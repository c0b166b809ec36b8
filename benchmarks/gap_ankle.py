# SPDX-License-Identifier: Apache-2.0
"""Effects hidden in the ankle: is each one named? Resumable.

    python benchmarks/gap_ankle.py [--out benchmarks/results/gap_ankle.jsonl]

The emulated ankle is the nominal model but for the sensors' noise, its gas, supply and valves, which are off
as shipped, and the hidden effect; a person of 75 kg wears it. Recorded are 14 s of its gait and of two sines,
to judge a gait of another cadence and a third sine. The search gets the recordings alone.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from gap_table import read, work_off

import pam_orthosis as po
from pam_orthosis.model.machines import machine_named

RESULTS = Path(__file__).resolve().parent / "results" / "gap_ankle.jsonl"
# effect, its parameter, the hidden value
HIDDEN = (
    ("joint_friction", "coulomb", 0.5),
    ("plantarflexor_leak", "coefficient", 2.0e-10),
    ("parallel_elasticity", "stiffness", 6.0),
    ("hose_resistance", "resistance", 3.0e6),
    ("dorsiflexor_pressure_gain", "gain", 0.93),
)


def motion(kind: str, cycle: float, seed: int, amplitude: float = 0.0) -> dict:
    """Return the values of one recording."""
    sine = {"scenario.sine.centre": 0.0, "scenario.sine.amplitude": amplitude} if amplitude else {}
    own = {"scenario.trajectory": kind, "scenario.cycle_time": cycle, "scenario.seed": seed}
    return {**own, **sine, "scenario.duration": 14.0, "leg.person.present": True}


TRAINING = (motion("gait", 2.0, 1), motion("sine", 1.5, 2, 0.12), motion("sine", 3.0, 3, 0.22))
HELD_OUT = (motion("gait", 1.8, 4), motion("sine", 2.0, 5, 0.16))


def solve(case: dict, _tools: dict) -> dict:
    """Record the ankle with an effect, search, and return what was named beside what was hidden."""
    branch = f"plant.effects.{case['effect']}"
    hidden = {f"{branch}.enabled": True, f"{branch}.{case['parameter']}": case["true"]}
    ankle = machine_named(Path("ankle"))
    with tempfile.TemporaryDirectory() as folder:
        bags = []
        for number, values in enumerate((*TRAINING, *HELD_OUT)):
            bags.append(Path(folder) / str(number))
            po.simulate(po.parameters("default", hidden | values, ankle, exact=True)).save(bags[-1])
        start = time.monotonic()
        found = po.gap(bags[: len(TRAINING)], bags[len(TRAINING) :])
    told = found.as_dict()
    return {
        **case,
        "verdict": told["verdict"],
        "effects": told["effects"],
        "runner_up": told["runner_up"],
        "explained": told["closure"],
        "right": [one["name"] for one in told["effects"]] == [case["effect"]],
        "seconds": round(time.monotonic() - start, 1),
    }


def main() -> None:
    """Solve the cases that the results file does not hold yet; print how many were named rightly."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=RESULTS)
    out = parser.parse_args().out
    known = {case["effect"] for case in read(out)} if out.exists() else set()
    plan = [dict(zip(("effect", "parameter", "true"), one, strict=True)) for one in HIDDEN]
    work_off([case for case in plan if case["effect"] not in known], None, solve, out, str)
    results = read(out)
    print(f"{sum(bool(r.get('right')) for r in results)} of {len(results)} named")


if __name__ == "__main__":
    main()
