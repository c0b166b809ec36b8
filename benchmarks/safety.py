# SPDX-License-Identifier: Apache-2.0
"""The safety monitor beside random persons and beside commands without sense; resumable, a JSON line a run.

    python benchmarks/safety.py run --out benchmarks/results/safety.jsonl [--persons 200] [--spasms 261]
    python benchmarks/safety.py table benchmarks/results/safety.jsonl

Truth judges. A trip is *missed* if a limit is exceeded by more than its margin before one, if a spasm of at
least `SURE` against the motion does not trip within 0.2 s, or if lost samples do not. A first trip is *false*
if nothing befalls the person and the same run without the monitor keeps all limits for the next 0.3 s.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from control_campaign.hardware import drawn
from fault_campaign.signals import FaultyPlant

from pam_orthosis.control.limits import SafetyMonitor
from pam_orthosis.control.loop import ClosedLoop, Hardware, Watched
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.model.person.volition import needed_effort
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.truth import true_parameters

SECONDS, NONSENSE_SECONDS = 8.0, 2.5
EVENTS = ("none", "none", "none", "push", "block", "spasm", "lost samples", "clonus", "supply lost")
ALWAYS = ("push", "clonus")  # from the beginning on
# as in a session: a guard that vents lets the muscle go that holds the joint against a spasm
STANDS_IN = {"control.guard.tracking_error": 3.0}
BODIES = 6  # hardware samples with a person's height each
AFTER, REACTION = 0.3, 0.2  # s
LOST = 0.06  # s without a sample
FIRST = 5000  # number of the first person: none on whom a limit was chosen
SURE = 30.0  # N m, from which on a spasm has to be seen
SIZES = (20.0, 25.0, 30.0, 35.0, 45.0)  # N m, of spasms
# what truth may be beyond a limit: the valves need time, and the model of the muscles errs. A vented joint
# goes on, with its momentum or the person's spasm, to the mechanical stop, which gives way: see `deepest`
MARGINS = {"range of motion": 0.48, "speed": 5.0, "torque": 5.0, "pressure": 2.0e4}
UNITS = {"range of motion": "rad", "speed": "rad/s", "torque": "N m", "pressure": "Pa"}


def deepest(parameters: Parameters, torque: float) -> float:
    """Return how far beyond the range a leg comes to rest that reaches its stop at the limit of speed, rad.

    A torque, N m, is behind it; its weight holds against it.
    """
    joint, limits = parameters.leg.joint, parameters.control.limits
    needed = needed_effort(parameters.declared.mechanism(true_parameters(parameters)))
    weight = float(needed(joint.maximum, 0.0, 0.0))
    inertia = float(needed(joint.maximum, 0.0, 1.0)) - weight
    depth, speed, step = 0.0, limits.speed, 1e-4
    while speed > 0:
        stop = depth * (joint.stop_stiffness + joint.stop_damping * speed)
        speed += step * (torque - weight - stop) / inertia
        depth += step * speed
    return float(joint.maximum - limits.high + depth)


class Deaf(Watched):
    """Hardware whose monitor hears nothing for a while."""

    def __init__(self, plant: Hardware, monitor: SafetyMonitor, since: float):
        super().__init__(plant, monitor)
        self._since = since

    def measure(self) -> Sequence[float]:
        """Return a sample, which the monitor sees at times."""
        if self._since <= self._time_ns * 1e-9 < self._since + LOST:
            return self._plant.measure()
        return super().measure()


class Beyond:
    """By how much the truth of a run is beyond each limit, at most, and since when."""

    def __init__(self, parameters: Parameters):
        self._limits, self._lever = parameters.control.limits, parameters.leg.cogwheel_diameter / 2
        self.rows: list[list[float]] = []

    def see(self, truth: Any) -> None:
        """Take a sample of the truth."""
        limits = self._limits
        torque = self._lever * (truth.flexor_force - truth.extensor_force)
        self.rows.append([
            max(limits.low - truth.angle, truth.angle - limits.high),
            abs(truth.velocity) - limits.speed, abs(torque) - limits.effort,
            max(truth.extensor_pressure, truth.flexor_pressure) - limits.pressure, truth.velocity,
        ])  # fmt: skip

    def most(self) -> dict[str, float]:
        """Return the largest excess over each limit; below 0 it was kept."""
        return dict(zip(MARGINS, np.max(self.rows, axis=0)[:4].tolist(), strict=True))

    def first(self, margins: Sequence[float], since: float = 0.0, until: float = np.inf) -> float | None:
        """Return the first instant at which a limit and its margin are exceeded, s."""
        rows = np.array(self.rows)[:, :4]
        time = np.arange(len(rows)) * 0.005
        out = (rows > np.array(margins)).any(axis=1) & (time >= since) & (time < until)
        return float(time[out][0]) if out.any() else None


class Seen:
    """Hardware whose truth a judge sees."""

    def __init__(self, plant: Any, judge: Beyond):
        self._plant, self._judge, self.period_ns = plant, judge, plant.period_ns
        self.measure, self.advance = plant.measure, plant.advance

    def truth(self) -> Any:
        """Return the truth."""
        truth = self._plant.truth()
        self._judge.see(truth)
        return truth


def person(number: int, spasm: bool = False) -> tuple[Parameters, str, float]:
    """Return parameters of a random person on one of the hardware samples, what befalls them, and when."""
    body, rng = number % BODIES, np.random.default_rng(number)
    of_body = np.random.default_rng(100 + body)
    event, at, mass = (
        "spasm" if spasm else str(rng.choice(EVENTS)),
        float(rng.uniform(3.5, 7.0)),
        float(rng.uniform(35.0, 110.0)),
    )
    u = rng.uniform
    will = {
        "share": u(-0.3, 1.0), "stiffness": u(0, 30), "damping": u(0, 1.5), "cycle_time": u(1.9, 2.1),
        "enabled": True,
    }  # fmt: skip
    overrides = {
        **drawn(body), **scenario_overrides("person-passive"), **STANDS_IN,
        "plant.deviation.supply_pressure": 1.0, "leg.person.mass": mass,
        "leg.person.height": float(of_body.uniform(1.5, 1.9)),
        "plant.person.tissue.passive_moment.scale": float(of_body.uniform(0.5, 1.5)),
        **{f"plant.person.volition.{key}": value for key, value in will.items()},
    }  # fmt: skip
    if event == "push":
        overrides |= {"plant.external_torque": u(3, 15), "plant.external_frequency": u(0.2, 2.0)}
    if event == "block":
        overrides |= {"plant.person.block.start": at, "plant.person.block.stiffness": u(50, 300)}
    if event == "clonus":
        overrides |= {
            "plant.person.tissue.clonus.enabled": True, "plant.person.tissue.clonus.amplitude": u(8, 25),
            "plant.person.tissue.clonus.threshold": u(2, 4),
        }  # fmt: skip
    if event == "spasm":
        torque = float(rng.choice([-1, 1])) * (u(SIZES[0], SIZES[-1]) if spasm else u(25, 40))
        overrides |= {"plant.person.spasm.start": at, "plant.person.spasm.torque": torque}
    return load(overrides), event, 0.0 if event in ALWAYS else at


def walk(number: int, spasm: bool = False) -> dict[str, Any]:
    """Return what the walk of a random person shows, on request of one whom a spasm seizes."""
    parameters, event, at = person(number, spasm)
    judge, steps = Beyond(parameters), round(SECONDS / 0.005)
    monitor = SafetyMonitor(parameters)
    plant = FaultyPlant(parameters, number, at, starved=event == "supply lost")
    watched = Deaf(plant, monitor, at if event == "lost samples" else np.inf)
    ClosedLoop(parameters, plant=Seen(watched, judge)).run(steps)
    trip = monitor.trips[0] if monitor.trips else None
    when = trip.time_ns * 1e-9 if trip else None
    out = judge.first(list(MARGINS.values()))
    missed = out is not None and (when is None or when > out)
    torque = abs(parameters.plant.person.spasm.torque) if event == "spasm" else 0.0
    against = event == "spasm" and _against(judge, parameters, at)
    seen = when is not None and when <= at + REACTION
    missed |= against and torque >= SURE and not seen
    missed |= event == "lost samples" and when is None
    return {
        "kind": "spasm" if spasm else "walk", "number": number, "event": event, "at": at,
        "trip": trip and trip.limit, "time": when, "torque": torque, "against": against, "seen": seen,
        "beyond": judge.most(), "missed": bool(missed),
        "false": _is_false(parameters, number, event, at, when),
    }  # fmt: skip


def _against(judge: Beyond, parameters: Parameters, at: float) -> bool:
    """Whether a spasm pulls against a motion that goes on for a while."""
    speeds = np.array(judge.rows)[round(at / 0.005) - 2 : round((at + 0.05) / 0.005), 4]
    return bool((speeds * np.sign(parameters.plant.person.spasm.torque) < -0.5).all())


def _is_false(parameters: Parameters, number: int, event: str, at: float, when: float | None) -> bool:
    if when is None or (event != "none" and when >= at):
        return False
    judge = Beyond(parameters)
    steps = round((when + AFTER) / 0.005)
    ClosedLoop(parameters, plant=Seen(Plant(parameters, number), judge)).run(steps)
    return judge.first([0.0] * len(MARGINS), when - AFTER) is None


def nonsense(number: int) -> dict[str, Any]:
    """Return what voltages without sense do when the monitor alone stands between them and the valves."""
    rng = np.random.default_rng(number)
    scenario = ("default", "person", "person-light", "person-heavy")[number % 4]
    angle = {"scenario.start_angle": float(rng.uniform(0.1, 1.0))}
    parameters = load(scenario_overrides(scenario) | angle)
    monitor, judge, plant = SafetyMonitor(parameters), Beyond(parameters), Plant(parameters, number)
    watched, left, voltages = Watched(plant, monitor), 0, (5.0, 5.0)
    for _ in range(round(NONSENSE_SECONDS / 0.005)):
        watched.measure()
        judge.see(plant.truth())
        if left == 0:
            voltages = tuple(rng.choice([0.0, 10.0, rng.uniform(0, 10)], 2).tolist())
            left = 1 + int(rng.exponential(30))
        watched.advance(*voltages)
        left -= 1
    trip = monitor.trips[0].limit if monitor.trips else None
    out = judge.first(list(MARGINS.values()))
    return {
        "kind": "nonsense",
        "number": number,
        "scenario": scenario,
        "trip": trip,
        "beyond": judge.most(),
        "missed": out is not None,
    }


def sizes(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield a Markdown table: of spasms against the motion, how many are seen, by size."""
    yield "| spasm against the motion | persons | seen within 0.2 s | furthest beyond the range |"
    yield "|---|---|---|---|"
    for low, high in itertools.pairwise(SIZES):
        some = [one for one in results if one.get("against") and low <= one["torque"] < high]
        most = max((one["beyond"]["range of motion"] for one in some), default=0.0)
        furthest = f"{most:.2g} rad" if most > 0 else "kept"
        yield f"| {low:g} to {high:g} N m | {len(some)} | {sum(one['seen'] for one in some)} | {furthest} |"


def summary(results: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the counts that the table shows."""
    kinds = ("walk", "spasm"), ("nonsense",)
    walks, blind = ([one for one in results if one["kind"] in some] for some in kinds)
    return {
        "walks": len(walks), "minutes": sum(one["time"] or SECONDS for one in walks) / 60,
        "events": dict(Counter(one["event"] for one in walks)),
        "trips": dict(Counter(one["trip"] or "none" for one in walks)),
        "missed": sum(one["missed"] for one in walks), "false": sum(one["false"] for one in walks),
        "beyond": _worst(walks), "beyond_margin": sum(map(_is_beyond, walks)), "nonsense": len(blind),
        "nonsense_trips": dict(Counter(one["trip"] or "none" for one in blind)),
        "nonsense_beyond_margin": sum(one["missed"] for one in blind), "nonsense_beyond": _worst(blind),
    }  # fmt: skip


def _is_beyond(run: dict[str, Any]) -> bool:
    """Whether a limit was exceeded by more than its margin, before a trip or after it."""
    return any(run["beyond"][name] > margin for name, margin in MARGINS.items())


def _worst(runs: Sequence[dict]) -> dict[str, float]:
    return {name: max(run["beyond"][name] for run in runs) for name in MARGINS} if runs else {}


def table(found: dict[str, Any]) -> Iterator[str]:
    """Yield counts and a Markdown table: limits, margins, and what truth was beyond."""
    yield (
        f"{found['walks']} walks, {found['minutes']:.1f} minutes to the first trip: {found['missed']} missed,"
        f" {found['false']} false, {found['beyond_margin']} beyond a margin. {found['nonsense']} runs of"
        f" senseless voltages: {found['nonsense_beyond_margin']} beyond a margin."
    )
    yield ""
    yield "| limit | margin of truth | persons: beyond the limit | senseless voltages: beyond the limit |"
    yield "|---|---|---|---|"
    for name, margin in MARGINS.items():
        values = (found[group].get(name, 0.0) for group in ("beyond", "nonsense_beyond"))
        cells = [f"{value:.3g} {UNITS[name]}" if value > 0 else "kept" for value in values]
        yield f"| {name} | {margin:g} {UNITS[name]} | {' | '.join(cells)} |"


def do(task: tuple[str, int]) -> dict[str, Any]:
    """Return the result of a run, given its kind and number."""
    kind, number = task
    return nonsense(number) if kind == "nonsense" else walk(number, kind == "spasm")


def read(path: Path) -> list[dict[str, Any]]:
    """Return the results that a file holds."""
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] if path.exists() else []
    )


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="make all runs")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--persons", type=int, default=200)
    running.add_argument("--spasms", type=int, default=261)
    running.add_argument("--nonsense", type=int, default=200)
    running.add_argument("--jobs", type=int, default=2)
    verbs.add_parser("table", help="print the table of a results file").add_argument("results", type=Path)
    arguments = parser.parse_args()
    if arguments.verb == "table":
        results = read(arguments.results)
        print("\n".join([*table(summary(results)), "", *sizes(results)]))
        return
    done = {(one["kind"], one["number"]) for one in read(arguments.out)}
    wanted = [("nonsense", n) for n in range(arguments.nonsense)]
    first = FIRST + arguments.persons
    wanted += [("walk", n) for n in range(FIRST, first)]
    wanted += [("spasm", n) for n in range(first, first + arguments.spasms)]
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for result in pool.map(do, [task for task in wanted if task not in done]):
            with open(arguments.out, "a", encoding="utf-8") as stream:
                stream.write(json.dumps(result) + "\n")


if __name__ == "__main__":
    main()
