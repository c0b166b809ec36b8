# SPDX-License-Identifier: Apache-2.0
"""Controllers compared on the same specimens, tasks, seeds and limits; resumable, one JSON line a run.

    python benchmarks/bench_control.py run --out results.jsonl [--controllers NAME...] [--limit N] [--jobs 2]
    python benchmarks/bench_control.py table results.jsonl
    python benchmarks/bench_control.py supply results.jsonl
    python benchmarks/bench_control.py figure results.jsonl figure.png

The paper's cascade; other laws in its place, by name, with gains searched by `tune_peers.py`: these and the
first one are also pushed and blocked; the paper's cascade with the same gains and with what each specimen's
own recordings, made without a person, taught; this one with a slower observer (without a person only: with
one it is slower already); the one before with a plan of the gait by what was taught (with a person only, who
brings the muscles to their limits); and, where a run with the plan goes beyond 1 deg or there is none, with
another plan that knows what that run, or one without a plan, showed.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from control_campaign import learn
from control_campaign.cases import (
    BLOCK,
    CALM,
    CASES,
    CONTROLLERS,
    PEERS,
    PUSH,
    RECORDED_SEED,
    SEED,
    SPECIMENS,
    Case,
    plan,
)  # fmt: skip
from control_campaign.hardware import drawn

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning.plan import make_plan
from pam_orthosis.planning.recorded import recorded

MUSCLES = ("extensor", "flexor")
LEARNING = ("learned", "calm", "planned", "replanned")
BOUND, GOAL = 3.0, 1.0  # deg
HEAD = (
    "| task | drawn specimens | controller | maximum | worst of | as shipped | of the paper's"
    " | RMS | variation | pressures | above 3 deg |"
)
SUPPLY_HEAD = "| specimen | taken at 7 bar | its own supply | error with it | error at 7 bar |"
NICE = 10


def solve(specimen: int, tasks: list[tuple[Case, str]], known: dict | None) -> Iterator[dict]:
    """Yield what controllers do with tasks of a specimen, and first what was learned if that is unknown."""
    for case, controller in tasks:
        if controller in LEARNING and known is None:
            known = learn.learn(load(drawn(specimen) | learn.tolerances(specimen)))
            yield {"specimen": specimen, "belief": known}
        told = {"specimen": specimen, "case": case.name, "controller": controller}
        try:
            parameters = load(drawn(specimen) | case.overrides())
            yield told | _figures(_run(parameters, case, controller, known or {}), parameters, case)
        except Exception as error:  # one failed run must not end all; the table counts it
            yield told | {"failed": f"{type(error).__name__}: {error}"}


def _run(parameters: Parameters, case: Case, controller: str, nominal: dict) -> dict[str, np.ndarray]:
    steps = round(case.duration / parameters.scenario.control_period)
    if controller in PEERS:
        parameters = parameters.changed({"control.position.controller": controller})
    assumed = {key: value for key, value in nominal.items() if key not in case.otherwise}
    parameters = with_nominal(parameters, assumed if controller in LEARNING else {})
    if controller == "calm":
        parameters = parameters.changed(CALM)
    if controller == "planned":
        parameters = parameters.changed(make_plan(parameters).overrides)
    if controller == "replanned":
        watched = round(parameters.scenario.duration / parameters.scenario.control_period)
        before = ClosedLoop(_planned_if_any(parameters), RECORDED_SEED).run(watched)
        after = make_plan(parameters, recorded=recorded(before["time"], before, parameters))
        parameters = parameters.changed(after.overrides)
    return ClosedLoop(parameters, SEED).run(steps)


def _planned_if_any(parameters: Parameters) -> Parameters:
    try:
        return parameters.changed(make_plan(parameters).overrides)
    except OrthosisError:  # no motion found: then a run without a plan shows what the model lacks
        return parameters


def _figures(run: dict[str, np.ndarray], parameters: Parameters, case: Case) -> dict[str, float]:
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
        "saturated": float(np.mean(run["saturated"])),
        **(_contact(run, case) if case.contact else {}),
    }


def _contact(run: dict[str, np.ndarray], case: Case) -> dict[str, float]:
    """Return how stiff a push finds the joint, or what a person who blocks feels, and the speed then."""
    if case.name == "push":
        moved = (run["true_angle"] - run["reference_angle"])[run["time"] > 3.0]
        return {"stiffness": float(2 * PUSH / np.ptp(moved))}
    start, duration = BLOCK.values()
    blocked = (run["time"] >= start) & (run["time"] < start + duration)
    after = (run["time"] >= start + duration) & (run["time"] < start + duration + 1.0)
    return {
        "felt": float(np.abs(run["true_torque"][blocked]).max()),
        "speed_after": float(np.abs(run["true_velocity"][after]).max()),
    }


def _work(task: tuple[Path, int, list[tuple[Case, str]], dict | None]) -> None:
    """Do the tasks of a specimen; each result is a line of the file as soon as it is there."""
    out, specimen, tasks, known = task
    for result in solve(specimen, tasks, known):
        with open(out, "a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")
        print(_line(result), flush=True)


def run(out: Path, controllers: Sequence[str], limit: int | None, jobs: int) -> None:
    """Make the runs that the results file does not hold yet."""
    results = _results(out)
    models = {r["specimen"]: r["belief"] for r in results if "belief" in r}
    todo = missing(results, controllers)[:limit]
    for everywhere in (True, False):  # what is learned for the first ones is there for the others
        groups: dict[int, list[tuple[Case, str]]] = {}
        for specimen, case, name in todo:
            if case.everywhere == everywhere:
                groups.setdefault(specimen, []).append((case, name))
        tasks = [(out, specimen, group, models.get(specimen)) for specimen, group in groups.items()]
        with ProcessPoolExecutor(jobs, initializer=os.nice, initargs=(NICE,)) as pool:
            list(pool.map(_work, tasks))
        models |= {r["specimen"]: r["belief"] for r in _results(out) if "belief" in r}


def missing(results: Sequence[dict], controllers: Sequence[str]) -> list[tuple[int, Case, str]]:
    """Return specimen, task and controller of the runs that these results lack."""
    done = {(r["specimen"], r["case"], r["controller"]) for r in results if "controller" in r}
    not_enough = {
        (r["specimen"], r["case"]) for r in results
        if r.get("controller") == "planned" and r.get("max_deg", np.inf) > GOAL
    }  # fmt: skip
    wanted = [
        (specimen, case, name) for specimen, case in plan() for name in controllers
        if (name != "planned" or case.wearer == "person")
        and (name != "calm" or case.wearer == "default")
        and (not case.contact or name in ("paper", *PEERS))
        and (name != "replanned" or (specimen, case.name) in not_enough)
    ]  # fmt: skip
    return [one for one in wanted if (one[0], one[1].name, one[2]) not in done]


def _line(result: dict) -> str:
    if "belief" in result:
        return f"specimen {result['specimen']}: learned"
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
    lines = [HEAD, "|" + "---|" * HEAD[1:].count("|")]
    for case in CASES:
        of_case = [r for r in runs if r["case"] == case.name]
        for controller in CONTROLLERS:
            chosen = [r for r in of_case if r["controller"] == controller]
            lines += [_row(case.name, controller, chosen, _share(of_case, controller))] if chosen else []
    return "\n".join(lines)


def _share(runs: list[dict], controller: str) -> str:
    """Return the largest quotient, over specimens, of a controller's largest error and the paper's."""
    of_paper = {r["specimen"]: r["max_deg"] for r in runs if r["controller"] == "paper" and "max_deg" in r}
    own = [r for r in runs if r["controller"] == controller and "max_deg" in r]
    shares = [r["max_deg"] / of_paper[r["specimen"]] for r in own if r["specimen"] in of_paper]
    return f"{max(shares):.2f}" if shares and controller in LEARNING else "-"


def _row(case: str, controller: str, chosen: list[dict], share: str) -> str:
    good = [r for r in chosen if "failed" not in r]
    failed = f", {len(chosen) - len(good)} failed" if len(good) < len(chosen) else ""
    if not good:
        return f"| {case} | 0{failed} | {controller} |" + " - |" * (HEAD.count("|") - 4)
    shipped = next((f"{r['max_deg']:.2f}" for r in good if not r["specimen"]), "-")
    worst = max(good, key=lambda r: r["max_deg"])
    rms, variation = (max(r[key] for r in good) for key in ("rms_deg", "variation_v_per_s"))
    low, high = min(r["least_pressure"] for r in good), max(r["most_pressure"] for r in good)
    cells = (
        case, f"{len([r for r in good if r['specimen']])}{failed}", controller,
        f"{worst['max_deg']:.2f} deg", worst["specimen"], shipped, share,
        f"{rms:.3f} deg", f"{variation:.0f} V/s", f"{low * 1e-5:.2f} .. {high * 1e-5:.2f} bar",
        sum(r["max_deg"] > BOUND for r in good),
    )  # fmt: skip
    return "| " + " | ".join(map(str, cells)) + " |"


def supply(path: Path) -> str:
    """Return which pressure the gait with 75 kg takes of each specimen, and which it has, as Markdown."""
    runs = {(r["specimen"], r["case"]): r for r in _results(path) if r.get("controller") == "learned"}
    drawn_supply, full_supply = (
        case.name for case in CASES if case.everywhere and case.scenario == "person" and not case.contact
    )
    lines = [SUPPLY_HEAD, "|" + "---|" * SUPPLY_HEAD[1:].count("|")]
    for specimen in sorted(number for number, case in runs if case == full_supply):
        parameters = load(drawn(specimen))
        there = parameters.valve.supply_pressure * parameters.plant.deviation.supply_pressure
        taken = runs[specimen, full_supply]["most_pressure"]
        errors = [runs[specimen, case]["max_deg"] for case in (drawn_supply, full_supply)]
        bars = [f"{value * 1e-5:.2f} bar" for value in (taken, there)]
        cells = [str(specimen), *bars, *(f"{error:.2f} deg" for error in errors)]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def figure(path: Path, file: Path) -> None:
    """Draw the largest error of each specimen in the tasks that all of them were asked."""
    from matplotlib.figure import Figure

    drawing = Figure(figsize=(13, 3.6), layout="constrained")
    cases = [case for case in CASES if case.everywhere and not case.contact]
    runs = [r for r in _results(path) if "max_deg" in r]
    for axes, case in zip(drawing.subplots(1, len(cases), sharey=True), cases, strict=True):
        for controller, mark in zip(CONTROLLERS, "o^<>svDx", strict=True):
            own = [r for r in runs if (r["case"], r["controller"]) == (case.name, controller)]
            axes.semilogy([r["specimen"] for r in own], [r["max_deg"] for r in own], mark, label=controller)
        axes.axhline(BOUND, color="0.5", lw=1)
        axes.set(title=case.name, xlabel="specimen (0: as shipped)", xticks=range(SPECIMENS + 1))
    drawing.axes[0].set_ylabel("largest error / deg")
    drawing.axes[-1].legend()
    drawing.savefig(file, dpi=110)


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
    running.add_argument("--controllers", nargs="+", choices=CONTROLLERS, default=CONTROLLERS)
    showing = verbs.add_parser("table", help="print the table of a results file")
    showing.add_argument("results", type=Path)
    supplying = verbs.add_parser("supply", help="print what supply a gait with 75 kg takes")
    supplying.add_argument("results", type=Path)
    drawing = verbs.add_parser("figure", help="draw the largest errors of a results file")
    drawing.add_argument("results", type=Path)
    drawing.add_argument("file", type=Path)
    arguments = parser.parse_args()
    if arguments.verb == "run":
        run(arguments.out, arguments.controllers, arguments.limit, arguments.jobs)
    elif arguments.verb == "figure":
        figure(arguments.results, arguments.file)
    elif arguments.verb == "supply":
        print(supply(arguments.results))
    else:
        print(table(arguments.results))


if __name__ == "__main__":
    main()
