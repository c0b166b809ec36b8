# SPDX-License-Identifier: Apache-2.0
"""Controllers compared on the same specimens, tasks, seeds and limits; resumable, one JSON line a run.

    python benchmarks/bench_control.py run --out results.jsonl [--limit N] [--jobs 2]
    python benchmarks/bench_control.py table results.jsonl

Three controllers: a cascaded PID tuned by a search, the paper's cascade, the paper's cascade with the same
gains and with what each specimen's own recordings taught.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from control_campaign import learn, pid
from control_campaign.cases import CASES, CONTROLLERS, SEED, Case, plan
from control_campaign.hardware import drawn

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.model.plant import Plant, with_belief

MUSCLES = ("extensor", "flexor")
BOUND = 3.0  # deg
NICE = 10


def solve(specimen: int, cases: list[Case], known: dict[str, dict]) -> Iterator[dict]:
    """Yield what each controller does with some tasks of a specimen; `known`: wearer -> learned belief."""
    for case in cases:
        parameters = load(drawn(specimen) | case.overrides())
        if case.wearer not in known:
            known[case.wearer] = _learned(specimen, case.wearer)
            yield {"specimen": specimen, "wearer": case.wearer, "belief": known[case.wearer]}
        for controller in CONTROLLERS:
            told = {"specimen": specimen, "case": case.name, "controller": controller}
            try:
                yield told | _figures(_run(parameters, case, controller, known[case.wearer]), parameters)
            except Exception as error:  # one failed run must not end all; the table counts it
                yield told | {"failed": f"{type(error).__name__}: {error}"}


def _learned(specimen: int, wearer: str) -> dict[str, Any]:
    return learn.learn(load(drawn(specimen) | scenario_overrides(wearer)))


def _run(parameters: Parameters, case: Case, controller: str, belief: dict) -> dict[str, np.ndarray]:
    steps = round(case.duration / parameters.scenario.control_period)
    if controller == "pid":
        return pid.run(parameters, Plant(parameters, SEED), pid.TUNED[case.wearer], steps)
    return ClosedLoop(with_belief(parameters, belief if controller == "learned" else {}), SEED).run(steps)


def _figures(run: dict[str, np.ndarray], parameters: Parameters) -> dict[str, float]:
    error = np.degrees(run["reference_angle"] - run["angle"])
    duration = len(error) * parameters.scenario.control_period
    pressures = np.array([run[f"{muscle}_pressure"] for muscle in MUSCLES])
    variation = max(np.abs(np.diff(run[f"{muscle}_voltage"])).sum() / duration for muscle in MUSCLES)
    return {
        "max_deg": float(np.abs(error).max()),
        "rms_deg": float(np.sqrt(np.mean(error**2))),
        "variation_v_per_s": float(variation),
        "least_pressure": float(pressures.min()),
        "most_pressure": float(pressures.max()),
        "saturated": float(np.mean(run["saturated"])) if "saturated" in run else 0.0,
    }


def _work(task: tuple[int, list[str], dict[str, dict]]) -> list[dict]:
    specimen, names, known = task
    return list(solve(specimen, [case for case in CASES if case.name in names], known))


def run(out: Path, limit: int | None, jobs: int) -> None:
    """Make the runs that the results file does not hold yet."""
    results = _results(out)
    done = {(r["specimen"], r["case"]) for r in results if r.get("controller") == CONTROLLERS[-1]}
    beliefs = {(r["specimen"], r["wearer"]): r["belief"] for r in results if "belief" in r}
    todo = [(specimen, case) for specimen, case in plan() if (specimen, case.name) not in done][:limit]
    groups: dict[tuple[int, str], list[str]] = {}
    for specimen, case in todo:  # tasks of one wearer share what is learned
        groups.setdefault((specimen, case.wearer), []).append(case.name)
    tasks = [
        (specimen, names, {w: b for (s, w), b in beliefs.items() if s == specimen})
        for (specimen, _), names in groups.items()
    ]
    with ProcessPoolExecutor(jobs, initializer=os.nice, initargs=(NICE,)) as pool:
        for number, lines in enumerate(pool.map(_work, tasks), start=1):
            with open(out, "a", encoding="utf-8") as stream:
                stream.writelines(json.dumps(line) + "\n" for line in lines)
            print(f"{number}/{len(tasks)}", *(_line(line) for line in lines), sep="\n  ", flush=True)


def _line(result: dict) -> str:
    if "belief" in result:
        return f"specimen {result['specimen']}, {result['wearer']}: learned"
    start = f"specimen {result['specimen']}, {result['case']}, {result['controller']}: "
    if "failed" in result:
        return start + result["failed"]
    return start + f"{result['max_deg']:.3f} deg, {result['variation_v_per_s']:.0f} V/s"


def _results(path: Path) -> list[dict]:
    if not path.exists():
        return []
    return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]


def table(path: Path) -> str:
    """Return the table of a results file as Markdown: of each task the worst specimen."""
    runs = [r for r in _results(path) if "controller" in r]
    head = (
        "| task | specimens | controller | maximum | worst of | RMS | variation | pressures | above 3 deg |"
    )
    lines = [head, "|" + "---|" * 9]
    for case in CASES:
        for controller in CONTROLLERS:
            chosen = [r for r in runs if r["case"] == case.name and r["controller"] == controller]
            lines += [_row(case.name, controller, chosen)] if chosen else []
    return "\n".join(lines)


def _row(case: str, controller: str, chosen: list[dict]) -> str:
    good = [r for r in chosen if "failed" not in r]
    failed = f", {len(chosen) - len(good)} failed" if len(good) < len(chosen) else ""
    drawn_ones = [r for r in good if r["specimen"]]
    shipped = next((f"{r['max_deg']:.2f}" for r in good if not r["specimen"]), "-")
    worst = max(good, key=lambda r: r["max_deg"])
    rms, variation = (max(r[key] for r in good) for key in ("rms_deg", "variation_v_per_s"))
    low, high = min(r["least_pressure"] for r in good), max(r["most_pressure"] for r in good)
    cells = (
        case, f"{len(drawn_ones)}{failed}", controller,
        f"{worst['max_deg']:.2f} deg", worst["specimen"], shipped,
        f"{rms:.3f} deg", f"{variation:.0f} V/s", f"{low * 1e-5:.2f} .. {high * 1e-5:.2f} bar",
        sum(r["max_deg"] > BOUND for r in good),
    )  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="make the runs that are not in the results file")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--limit", type=int)
    running.add_argument("--jobs", type=int, default=2)
    showing = verbs.add_parser("table", help="print the table of a results file")
    showing.add_argument("results", type=Path)
    arguments = parser.parse_args()
    if arguments.verb == "run":
        run(arguments.out, arguments.limit, arguments.jobs)
    else:
        print(table(arguments.results))


if __name__ == "__main__":
    main()
