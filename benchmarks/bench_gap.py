# SPDX-License-Identifier: Apache-2.0
"""Blind cases for the gap workflow: hide effects, search, count; resumable, one JSON line a case.

    python benchmarks/bench_gap.py run --out results.jsonl [--seed 1] [--cases SET ...] [--limit N]
    python benchmarks/bench_gap.py table results.jsonl ... [--keep short.jsonl] [--peer peer.jsonl]

The search gets the recordings and the nominal model; the answer is compared afterwards. The peer's file,
PySINDy on the same cases, is made by `gap_peer.py`.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from gap_table import SETS, SIZES, beside, keep, read, table, which, work_off

SHAPES = ("force_map_misfit", "valve_curve_misfit", "volume_misfit")
NULLS = 50
PAIRS = 40
OUTSIDE_ROUNDS = 4
# cases of a set that are asked for: in these shares the sets take turns
ASKED = {"clean": 100, "realistic": 100, "clean-none": 50, "realistic-none": 50, "pairs": 40, "outside": 40}


def plan(sets, seed: int) -> Iterator[dict]:
    """Yield the cases of some sets; the order mixes effects so that a part of it is a fair sample."""
    from pam_orthosis.testing.effects import EFFECTS, OUTSIDE

    for name in sets:
        rng = np.random.default_rng(seed)  # a set does not depend on which others are made
        class_ = "realistic" if name.startswith("realistic") else "clean"
        base = 100_000 * seed + 10_000 * SETS.index(name)
        if name in ("clean", "realistic"):
            cases = [(size, [effect]) for size in ("medium", "large", "small") for effect in EFFECTS]
            order = np.concatenate([rng.permutation(len(EFFECTS)) + k * len(EFFECTS) for k in range(3)])
            cases = [cases[i] for i in order]
        elif name.endswith("none"):
            cases = [("medium", [])] * NULLS
        elif name == "pairs":
            cases = [("medium", _pair(rng, list(EFFECTS))) for _ in range(PAIRS)]
        elif name == "alone":
            yield from _each_alone(plan(["pairs"], seed))
            continue
        else:
            cases = [
                (size, [e]) for size in ("medium", "large") for _ in range(OUTSIDE_ROUNDS) for e in OUTSIDE
            ]
        for number, (size, effects) in enumerate(cases):
            yield {
                "set": name, "class": class_, "size": size, "effects": effects, "seed": base + number,
                "outside": name == "outside",
            }  # fmt: skip


def in_turns(cases: Iterable[dict]) -> list[dict]:
    """Return cases in an order in which every part is a fair sample of all sets."""
    count: Counter[str] = Counter()
    placed = []
    for case in cases:
        placed.append(((count[case["set"]] + 0.5) / ASKED.get(case["set"], 1), case))
        count[case["set"]] += 1
    return [case for _, case in sorted(placed, key=lambda one: one[0])]


def _each_alone(pairs) -> Iterator[dict]:
    """Yield for each pair two cases that are the same but for one of its effects."""
    for case in pairs:
        for effect in case["effects"]:
            yield {**case, "set": "alone", "effects": [effect], "pair": case["effects"]}


def _pair(rng, names: list[str]) -> list[str]:
    chosen = [name for name in names if name not in SHAPES]
    return [str(name) for name in rng.choice(chosen, 2, replace=False)]


def solve(case: dict, tools: dict) -> dict:
    """Make a case, search it, and return what was found beside what was hidden."""
    from pam_orthosis.discrepancy.answer.contract import as_dict
    from pam_orthosis.discrepancy.recordings.data import from_arrays
    from pam_orthosis.discrepancy.replay.replay import Replay
    from pam_orthosis.discrepancy.systems.knee import knee
    from pam_orthosis.discrepancy.workflow import find_gap
    from pam_orthosis.testing.case import make_case, nominal

    if not tools:
        parameters = nominal()
        system = knee(parameters)
        tools.update(parameters=parameters, system=system, replay=Replay(system))
    drawn, alone = (case["pair"], case["effects"][0]) if "pair" in case else (case["effects"] or 0, None)
    made = make_case(case["seed"], case["class"], case["size"], drawn, case["outside"], alone)
    system = tools["system"]
    training, held_out = (
        [from_arrays(name, system, arrays) for name, arrays in group.items()]
        for group in (made.training, made.held_out)
    )
    start = time.monotonic()
    outcome = find_gap(system, training, held_out, tools["parameters"].gap, replay=tools["replay"])
    return {
        **case,
        "answer": made.answer,
        "seconds": round(time.monotonic() - start, 2),
        "found": as_dict(outcome),
    }


def run(arguments) -> None:
    """Solve the cases that the results file does not hold yet."""
    known = read(arguments.out) if arguments.out.exists() else []
    done = {which(r) for r in known}
    planned = (case for case in plan(arguments.cases, arguments.seed) if case["size"] in arguments.sizes)
    todo = [case for case in in_turns(planned) if which(case) not in done]
    work_off(todo, arguments.limit, solve, arguments.out, _line)


def _line(result: dict) -> str:
    if "failed" in result:
        return f"{result['set']} {result['size']} {result['effects']} FAILED {result['failed']}"
    found = result["found"]
    named = [effect["name"] for effect in found["effects"]] + [f"~{name}" for name in found["look_alikes"]]
    ranking = found["rounds"][0]["ranking"][:2] if found["rounds"] else []
    return (
        f"{result['set']} {result['size']} {result['effects']} -> {found['verdict']} {named}"
        f" closure {found['closure']['overall']} {ranking} {result['seconds']} s"
    )


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="solve cases that are not in the results file")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--seed", type=int, default=1)
    running.add_argument("--cases", nargs="+", choices=SETS, default=list(SETS))
    running.add_argument("--sizes", nargs="+", choices=SIZES, default=list(SIZES))
    running.add_argument("--limit", type=int)
    showing = verbs.add_parser("table", help="print the tables of a results file")
    showing.add_argument("results", type=Path, nargs="+")
    showing.add_argument("--keep", type=Path, help="write what the table needs of each case")
    showing.add_argument("--peer", type=Path, help="results of gap_peer.py on the same cases")
    arguments = parser.parse_args()
    if arguments.verb == "run":
        run(arguments)
    else:
        results = [one for path in arguments.results for one in read(path)]
        if arguments.keep:
            keep(results, arguments.keep)
        print(table(results))
        if arguments.peer:
            print("\n" + beside(results, read(arguments.peer)))


if __name__ == "__main__":
    main()
