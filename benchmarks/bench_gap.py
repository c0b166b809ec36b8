# SPDX-License-Identifier: Apache-2.0
"""Blind cases for the gap workflow: hide effects, search, count; resumable, one JSON line a case.

    python benchmarks/bench_gap.py run --out results.jsonl [--seed 1] [--cases SET ...] [--limit N]
    python benchmarks/bench_gap.py table results.jsonl

The search gets the recordings and the belief; the answer is compared afterwards.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

SETS = ("clean", "realistic", "clean-none", "realistic-none", "pairs", "outside")
SHAPES = ("force_map_misfit", "valve_curve_misfit", "volume_misfit")
NULLS = 50
PAIRS = 30
OUTSIDE_ROUNDS = 4


def plan(sets, seed: int) -> Iterator[dict]:
    """Yield the cases of some sets; the order mixes effects so that a part of it is a fair sample."""
    from pam_orthosis.discrepancy.hidden.effects import EFFECTS, OUTSIDE

    rng = np.random.default_rng(seed)
    for name in sets:
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
        else:
            cases = [
                (size, [e]) for size in ("medium", "large") for _ in range(OUTSIDE_ROUNDS) for e in OUTSIDE
            ]
        for number, (size, effects) in enumerate(cases):
            yield {
                "set": name, "class": class_, "size": size, "effects": effects, "seed": base + number,
                "outside": name == "outside",
            }  # fmt: skip


def _pair(rng, names: list[str]) -> list[str]:
    chosen = [name for name in names if name not in SHAPES]
    return [str(name) for name in rng.choice(chosen, 2, replace=False)]


def solve(case: dict, tools: dict) -> dict:
    """Make a case, search it, and return what was found beside what was hidden."""
    from pam_orthosis.discrepancy.data import from_arrays
    from pam_orthosis.discrepancy.hidden.case import belief, make_case
    from pam_orthosis.discrepancy.knee import knee
    from pam_orthosis.discrepancy.replay import Replay
    from pam_orthosis.discrepancy.verdict import as_dict
    from pam_orthosis.discrepancy.workflow import find_gap

    if not tools:
        parameters = belief()
        system = knee(parameters)
        tools.update(parameters=parameters, system=system, replay=Replay(system))
    effects = case["effects"] or 0
    made = make_case(case["seed"], case["class"], case["size"], effects, case["outside"])
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
    done = {(r["set"], r["seed"]) for r in _results(arguments.out)}
    todo = [case for case in plan(arguments.cases, arguments.seed) if (case["set"], case["seed"]) not in done]
    tools: dict = {}
    for number, case in enumerate(todo[: arguments.limit]):
        try:
            result = solve(case, tools)
        except Exception as error:  # one failed case must not end a night's run; the table counts it
            result = {**case, "failed": f"{type(error).__name__}: {error}"}
        with open(arguments.out, "a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")
        print(f"{number + 1}/{len(todo)}", _line(result), flush=True)


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


def _results(path: Path) -> list[dict]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def judged(result: dict) -> str:
    """Return what became of a case with one effect: right, set (look-alikes), wrong, none, failed."""
    if "failed" in result:
        return "failed"
    named = [effect["name"] for effect in result["found"]["effects"]]
    truth = set(result["effects"])
    if not named:
        return "none"
    if set(named) == truth:
        return "right"
    alike = {*named[:1], *result["found"]["look_alikes"]}
    if len(named) == 1 and len(alike) <= 2 and truth & alike:
        return "set"
    return "extra" if truth & set(named) else "wrong"


def table(path: Path) -> str:
    """Return the tables of a results file as Markdown."""
    results = _results(path)
    lines = [
        "| set | size | cases | right | set of 2 | with extras | wrong | not found | failed |",
        "|" + "---|" * 9,
    ]
    for name in SETS:
        for size in ("small", "medium", "large"):
            chosen = [r for r in results if r["set"] == name and r["size"] == size and r["effects"]]
            if chosen and name not in ("outside", "pairs"):
                count = Counter(judged(r) for r in chosen)
                cells = [count[k] for k in ("right", "set", "extra", "wrong", "none", "failed")]
                lines.append(f"| {name} | {size} | {len(chosen)} | " + " | ".join(map(str, cells)) + " |")
    lines += _others(results)
    return "\n".join(lines)


def _others(results: list[dict]) -> list[str]:
    lines = [""]
    solved = [r for r in results if "found" in r]
    for name in ("clean-none", "realistic-none"):
        chosen = [r for r in solved if r["set"] == name]
        if chosen:
            alarms = sum(r["found"]["verdict"] != "none" for r in chosen)
            named = sum(bool(r["found"]["effects"]) for r in chosen)
            lines.append(f"- {name}: {len(chosen)} cases, {named} with a name, {alarms} not `none`")
    pairs = [r for r in solved if r["set"] == "pairs"]
    if pairs:
        exact = sum(judged(r) == "right" for r in pairs)
        lines.append(f"- pairs: {len(pairs)} cases, both named and nothing else {exact}")
    outside = [r for r in solved if r["set"] == "outside"]
    if outside:
        honest = sum(_honest(r["found"]) for r in outside)
        lines.append(
            f"- outside the catalogue: {len(outside)} cases, {honest} unexplained or closure below 50 %"
        )
    right = [r for r in solved if r["set"] in ("clean", "realistic") and judged(r) in ("right", "set")]
    if right:
        lines += _figures(right)
    return lines


def _honest(found: dict) -> bool:
    share = found["closure"]["overall"]
    return found["verdict"] == "unexplained" or share is None or share < 0.5


def _figures(right: list[dict]) -> list[str]:
    closures = [r["found"]["closure"]["overall"] for r in right]
    closures = [c for c in closures if c is not None]
    errors, inside = [], []
    for r in right:
        error, contained = _parameter(r)
        if error is not None:
            errors.append(error)
            if next(iter(r["answer"]["same_form"].values())):
                inside.append(contained)
    flagged = sum(r["found"]["verdict"] == "unexplained" for r in right)
    return [
        f"- closure of named cases: median {np.median(closures):.3f}, at least 0.95 in"
        f" {np.mean(np.array(closures) >= 0.95):.0%} of {len(closures)}",
        f"- error of the size: median {np.median(errors):.1%}, 90 % below {np.quantile(errors, 0.9):.1%}"
        f" ({len(errors)} cases)",
        f"- 95 % intervals that hold the truth (same form): {sum(inside)} of {len(inside)}",
        f"- named rightly but called unexplained: {flagged} of {len(right)}",
        f"- time: median {np.median([r['seconds'] for r in right]):.1f} s,"
        f" longest {max(r['seconds'] for r in right):.1f} s",
    ]


def _parameter(result: dict):
    """Return the relative error of the size and whether the interval holds it; None for shapes."""
    (name, truth), *_ = result["answer"]["effects"].items()
    found = next((e for e in result["found"]["effects"] if e["name"] == name), None)
    if found is None or not isinstance(truth, dict):
        return None, None
    key = next((k for k in truth if k in found["parameters"]), None)
    if key is None:
        return None, None
    from pam_orthosis.discrepancy.hidden.effects import EFFECTS

    neutral = 1.0 if EFFECTS[name].around_one else 0.0
    value, (low, high) = found["parameters"][key]["value"], found["parameters"][key]["interval"]
    return abs(value - truth[key]) / abs(truth[key] - neutral), low <= truth[key] <= high


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
    running.add_argument("--limit", type=int)
    showing = verbs.add_parser("table", help="print the tables of a results file")
    showing.add_argument("results", type=Path)
    arguments = parser.parse_args()
    if arguments.verb == "run":
        run(arguments)
    else:
        print(table(arguments.results))


if __name__ == "__main__":
    main()
