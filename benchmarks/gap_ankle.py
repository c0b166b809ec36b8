# SPDX-License-Identifier: Apache-2.0
"""What is hidden in ankle and shoe: is each named, and is nothing named where nothing is hidden? Resumable.

    python benchmarks/gap_ankle.py SEED [--out benchmarks/results/gap_ankle.jsonl]

The hidden machine is that of `pam_orthosis.testing`, which shares no physics with the model: its nuisance
parameters are off by 0.7 of their tolerance, and an effect is in another form than the catalogue's. The
search gets what `gap-hide --machine` writes. All sizes follow from the seed.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from gap_table import read, work_off

import pam_orthosis as po
from pam_orthosis.discrepancy.systems.suspects import name_of
from pam_orthosis.model.machines import machine_named
from pam_orthosis.testing import case as cases
from pam_orthosis.testing.write import write_case

RESULTS = Path(__file__).resolve().parent / "results" / "gap_ankle.jsonl"
PERSON = {"leg.person.present": True}
NAMED = "explained", "recalibrated"
# machine, worn by a person, effect or wrong parameter (empty: nothing), size or factor on the parameter
HIDDEN = (
    ("ankle", False, "joint_friction", "large"),
    ("ankle", True, "parallel_elasticity", "large"),
    ("ankle", False, "plantarflexor_leak", "medium"),
    ("ankle", False, "hose_resistance", "medium"),
    ("ankle", True, "dorsiflexor_pressure_gain", "medium"),
    ("ankle", False, "valve_delay", "medium"),
    ("ankle", False, "leg.shoe_mass", 1.6),
    ("ankle", False, "valve.supply_pressure", 1.15),
    ("shoe", False, "heel_leak", "medium"),
    ("shoe", False, "forefoot_pressure_gain", "large"),
    ("ankle", False, "", "medium"),
    ("ankle", True, "", "medium"),
    ("shoe", False, "", "medium"),
    ("ankle", False, "parallel_elasticity", "large"),
    ("shoe", False, "heel_leak", "large"),
)


def plan(seed: int) -> list[dict]:
    """Return the cases of a seed."""
    names = "machine", "person", "hidden", "size"
    return [{"seed": seed, "number": n, **dict(zip(names, one, strict=True))} for n, one in enumerate(HIDDEN)]


def made(case: dict) -> cases.Case:
    """Return the recordings of a case."""
    parameters = cases.nominal(machine_named(Path(case["machine"])))
    parameters = parameters.changed(PERSON if case["person"] else {})
    effects, size, wrong = ([case["hidden"]] if case["hidden"] else 0), case["size"], {}
    if "." in case["hidden"]:
        effects, size, key = 0, "medium", case["hidden"]
        wrong = {key: parameters.at(key) * case["size"]}
    seed = 1000 * case["seed"] + case["number"]
    return cases.make_case(seed, "clean", size, effects, parameters=parameters, wrong=wrong)


def solve(case: dict, _tools: dict) -> dict:
    """Record a case, search it, and return what was named beside what was hidden."""
    recorded = made(case)
    with tempfile.TemporaryDirectory() as folder:
        training, held_out, _ = write_case(recorded, Path(folder))
        start = time.monotonic()
        answer = po.gap(training, held_out).as_dict()
    named = [one["name"] for one in answer["effects"]]
    expected = [name_of(case["hidden"])] if case["hidden"] else []
    return {
        **case,
        "true": recorded.answer["wrong"] or recorded.answer["effects"],
        "verdict": answer["verdict"],
        "effects": answer["effects"],
        "runner_up": answer["runner_up"],
        "explained": answer["closure"],
        "right": named == expected and answer["verdict"] in (NAMED if expected else ("none",)),
        "seconds": round(time.monotonic() - start, 1),
    }


def main() -> None:
    """Solve the cases that the results file does not hold yet; print how many were named rightly."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("seed", type=int)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--only", type=int, nargs="+", help="numbers of cases")
    arguments = parser.parse_args()
    out = arguments.out
    known = {(case["seed"], case["number"]) for case in read(out)} if out.exists() else set()
    todo = [case for case in plan(arguments.seed) if (case["seed"], case["number"]) not in known]
    if arguments.only is not None:
        todo = [case for case in todo if case["number"] in arguments.only]
    work_off(todo, None, solve, out, str)
    results = [one for one in read(out) if one["seed"] == arguments.seed]
    print(f"{sum(bool(r.get('right')) for r in results)} of {len(results)} right")


if __name__ == "__main__":
    main()
