# SPDX-License-Identifier: Apache-2.0
"""How the joint meets a person: stiffness asked and measured, what is felt, assistance, a slow person.

python benchmarks/cooperation.py run --out benchmarks/results/cooperation.json
python benchmarks/cooperation.py table benchmarks/results/cooperation.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from control_campaign.hardware import drawn

from pam_orthosis.control.activity import Array, Stride, shares
from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import Parameters, load, scenario_overrides
from pam_orthosis.model.truth import true_parameters

STIFFNESSES = {
    40: 2.0,
    100: 4.0,
    150: 5.0,
    200: 6.0,
    300: 9.0,
    400: 12.0,
    600: 20.0,
}  # N m/rad -> damping, N m s/rad
FREQUENCIES = (0.1, 0.5, 1.0, 2.0)  # Hz
PERSONS = {30: 1.35, 75: 1.75, 120: 1.9}  # body mass, kg -> height, m
SHARES = (0.0, 0.3, 0.6, 1.0)
SAMPLES = 3  # drawn hardware samples, beside that of the configuration
PUSH, ANGLE, WARM_UP = 12.0, 0.6, 3.0  # N m, rad, s
WILL = "plant.person.volition"
FAST = {"control.observer.pole": 105.0, "control.guard.tracking_error": 3.0}
DRY = {f"plant.effects.{name}.enabled": False for name in ("joint_friction", "muscle_hysteresis")}


def loop(parameters: Parameters) -> ClosedLoop:
    """Return the closed loop with the cooperative controller."""
    return ClosedLoop(parameters, 1, position=CooperativeController(parameters))


def stiffness(task: dict[str, Any]) -> dict[str, Any]:
    """Return the stiffness that a push of one frequency meets, beside the joint's own inertia, N m/rad.

    The real part of torque over deflection; the imaginary part is positive while the joint takes up energy.
    """
    asked, hertz, mass = task["asked"], task["hertz"], task["mass"]
    parameters = load({
        **scenario_overrides("person"), **drawn(task["sample"]), **FAST, **(DRY if task["dry"] else {}),
        "leg.person.mass": mass, "leg.person.height": PERSONS[mass],
        "scenario.trajectory": "hold", "scenario.start_angle": ANGLE,
        "plant.external_torque": PUSH, "plant.external_frequency": hertz,
        "control.cooperation.mode": "impedance", "control.cooperation.stiffness": asked,
        "control.cooperation.damping": STIFFNESSES[asked],
    })  # fmt: skip
    cycles = max(2, round(4 * hertz))
    count = round(cycles / hertz / 0.005)
    run = loop(parameters).run(count + round(WARM_UP / 0.005))
    wave = np.exp(-2j * np.pi * hertz * run["time"][-count:])
    pushed, moved = (np.mean(run[name][-count:] * wave) for name in ("true_torque", "true_angle"))
    true = true_parameters(parameters)
    answer = pushed / moved
    own = _inertia(true) * (2 * np.pi * hertz) ** 2
    return task | {"measured": float(answer.real + own), "loss": float(answer.imag)}


def _inertia(true: Parameters) -> float:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    terms = true.declared.mechanism(true).terms(q, v)
    return float(ca.Function("inertia", [q, v], [terms.inertia])(ANGLE, 0.0))


def felt(task: dict[str, Any]) -> dict[str, Any]:
    """Return what a leg that swings by 17 degrees at 0.5 Hz feels of the transparent orthosis, N m RMS."""
    parameters = load({
        **scenario_overrides("sine"), **drawn(task["sample"]), **FAST, "scenario.cycle_time": 2.0,
        f"{WILL}.enabled": True, f"{WILL}.stiffness": 150.0, f"{WILL}.damping": 6.0,
        "control.cooperation.mode": "transparent",
    })  # fmt: skip
    run = loop(parameters).run(2400)
    late = run["true_torque"][-1600:]
    swing = float(np.degrees(np.ptp(run["true_angle"][-1600:]) / 2))
    return task | {"rms": float(np.sqrt(np.mean(late**2))), "swing_deg": swing}


def strides(run: Mapping[str, Array], parameters: Parameters) -> list[Stride]:
    """Return the share in each whole cycle of the scenario, as `shares` does, the first one left out."""
    begin = parameters.scenario.start_hold + parameters.scenario.start_ramp
    period, cycle = parameters.scenario.control_period, parameters.scenario.cycle_time
    length, count = round(cycle / period), len(run["disturbance"])
    starts = range(round(begin / period), count - length + 1, length)
    return shares(run, parameters, [(start, start + length) for start in starts])


def assisted(task: dict[str, Any]) -> dict[str, Any]:
    """Return path, assistance and estimated share of a person who brings a share of the needed torque."""
    parameters = load({
        **scenario_overrides("person-passive"), **drawn(task["sample"]), **FAST,
        f"{WILL}.share": task["share"], "plant.deviation.supply_pressure": 1.0,
        "plant.person.tissue.passive_moment.enabled": task["tissue"], "control.cooperation.mode": "assist",
    })  # fmt: skip
    controller = CooperativeController(parameters)
    run = ClosedLoop(parameters, 1, position=controller).run(6000)
    error = np.degrees(run["reference_angle"] - run["true_angle"])[-4000:]
    late = strides(run, parameters)[-6:]
    share = float(np.mean([one.share for one in late]))
    uncertainty = float(np.mean([one.error for one in late]))
    return task | {"path_deg": float(np.abs(error).max()), "level": controller.level, "estimated": share,
                   "uncertainty": uncertainty}  # fmt: skip


def slow(task: dict[str, Any]) -> dict[str, Any]:
    """Return the error of a person who walks in 2.6 s what is asked for in 2.0 s, waited for or not."""
    parameters = load({
        **scenario_overrides("person-passive"), **FAST, f"{WILL}.share": 1.0, f"{WILL}.stiffness": 120.0,
        f"{WILL}.damping": 4.0, f"{WILL}.cycle_time": 2.6, "control.cooperation.mode": "assist",
        "control.cooperation.stiffness": 60.0, "control.cooperation.wait": task["waits"],
    })  # fmt: skip
    run = loop(parameters).run(6000)
    error = np.degrees(run["reference_angle"] - run["true_angle"])[-4000:]
    return task | {"rms_deg": float(np.sqrt(np.mean(error**2))), "max_deg": float(np.abs(error).max())}


def tasks() -> dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], list[dict[str, Any]]]]:
    """Return name -> what measures, and its tasks."""
    of_stiffness = [
        {"asked": asked, "hertz": hertz, "mass": mass, "sample": 0, "dry": False}
        for asked in STIFFNESSES for hertz in FREQUENCIES for mass in PERSONS
    ]  # fmt: skip
    of_stiffness += [
        {"asked": asked, "hertz": 0.5, "mass": 75, "sample": sample, "dry": False}
        for asked in STIFFNESSES for sample in range(1, SAMPLES + 1)
    ]  # fmt: skip
    of_stiffness += [
        {"asked": asked, "hertz": 0.5, "mass": 75, "sample": 0, "dry": True} for asked in STIFFNESSES
    ]
    samples = range(SAMPLES + 1)
    of_shares = [
        {"share": share, "sample": sample, "tissue": tissue}
        for share in SHARES for sample in samples for tissue in (False, True)
    ]  # fmt: skip
    return {
        "stiffness": (stiffness, of_stiffness), "felt": (felt, [{"sample": sample} for sample in samples]),
        "assisted": (assisted, of_shares), "slow": (slow, [{"waits": waits} for waits in (False, True)]),
    }  # fmt: skip


def stiffness_table(found: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield stiffness asked and measured as Markdown, of persons over all frequencies."""
    persons = " | ".join(f"person of {mass} kg" for mass in PERSONS)
    yield f"| asked / N m/rad | {persons} | 75 kg, drawn hardware | 75 kg, no dry friction |"
    yield "|---|" + "---|" * (len(PERSONS) + 2)
    for asked in STIFFNESSES:
        own = [one for one in found["stiffness"] if one["asked"] == asked]
        plain = [one for one in own if not one["sample"] and not one["dry"]]
        groups = [[one for one in plain if one["mass"] == mass] for mass in PERSONS]
        groups += [[one for one in own if one["sample"]], [one for one in own if one["dry"]]]
        cells = [_span([one["measured"] for one in group], 0) for group in groups]
        yield f"| {asked} | " + " | ".join(cells) + " |"


def share_table(found: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield what assistance does for persons of different shares as Markdown."""
    yield "| share of the person | largest distance from the path / deg | assistance | estimated share |"
    yield "|---|---|---|---|"
    for share in SHARES:
        own = [one for one in found["assisted"] if one["share"] == share]
        path, level, estimated = (
            _span([one[key] for one in own], digits)
            for key, digits in (("path_deg", 1), ("level", 2), ("estimated", 2))
        )
        yield f"| {share:.1f} | {path} | {level} | {estimated} |"


def felt_table(found: dict[str, list[dict[str, Any]]]) -> Iterator[str]:
    """Yield what is felt in transparent mode, and how a slow person lags, as Markdown."""
    yield "| case | measured |"
    yield "|---|---|"
    torque = _span([one["rms"] for one in found["felt"]], 1)
    yield f"| transparent, 0.5 Hz: torque that is felt | {torque} N m RMS |"
    for one in found["slow"]:
        waits = "waited for" if one["waits"] else "not waited for"
        yield f"| strides of 2.6 s, a reference of 2.0 s, {waits}: error | {one['rms_deg']:.1f} deg RMS |"


def _span(values: list[float], digits: int) -> str:
    return f"{min(values):.{digits}f} .. {max(values):.{digits}f}"


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(dest="verb", required=True)
    running = verbs.add_parser("run", help="make all runs")
    running.add_argument("--out", type=Path, required=True)
    running.add_argument("--jobs", type=int, default=2)
    verbs.add_parser("table", help="print the tables of a results file").add_argument("results", type=Path)
    arguments = parser.parse_args()
    if arguments.verb == "run":
        with ProcessPoolExecutor(arguments.jobs) as pool:
            found = {name: list(pool.map(measure, of)) for name, (measure, of) in tasks().items()}
        arguments.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        return
    found = json.loads(arguments.results.read_text(encoding="utf-8"))
    print("\n\n".join("\n".join(table(found)) for table in (stiffness_table, share_table, felt_table)))


if __name__ == "__main__":
    main()
