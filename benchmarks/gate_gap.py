# SPDX-License-Identifier: Apache-2.0
"""Twenty fixed searches of the gap workflow, short, and what they answered: `results/gate.json`."""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import hidden_rig
import numpy as np

from pam_orthosis.control import diagnostic
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.recordings.data import Recording, from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search.findings import Named
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.rig import test_rig
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.model.compiled import processor
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.testing import case as cases
from pam_orthosis.testing.quantities import Hidden

RESULTS = Path(__file__).resolve().parent / "results" / "gate.json"
# between machines: a fit ends where its cost falls by less than 1, and the last bits of libraries differ
TOLERANCE = 1e-6
GAIT, HELD_OUT_GAIT = 8.0, 6.0  # s
DEVIATION = 0.7  # of the stated tolerance, by which the rig's nuisance parameters are off
# effect of the rig -> field of the hidden plant and its size
AT_RIG = {"carriage_friction": ("coulomb", 10.0), "specimen_leak": ("leak_e", 5e-11), "creep": ("creep", 2e3)}
EXPERIMENTS = (diagnostic.closed_hold, diagnostic.cocontraction)


@dataclass(frozen=True)
class Search:
    """What is hidden in a system, `knee` or `rig`; `known`: what its nominal model has already."""

    hidden: tuple[str, ...] = ()
    system: str = "knee"
    class_: str = "clean"
    outside: bool = False
    known: str = ""

    @property
    def name(self) -> str:
        """The search in words."""
        known = f", {self.known} known" if self.known else ""
        return f"{self.system}: {' + '.join(self.hidden) or 'nothing'}, {self.class_}{known}"


SEARCHES = (
    *(Search((name,)) for name in (
        "joint_friction", "muscle_hysteresis", "extra_foot_mass", "stretch_reflex", "backlash",
        "periodic_torque", "extensor_leak", "supply_sag", "valve_delay", "hose_resistance",
        "angle_offset", "flexor_pressure_gain",
    )),
    Search(("valve_dead_band",), class_="realistic"),
    Search(("joint_friction", "extensor_leak")),
    Search(("joint_friction", "flexor_leak"), known="joint_friction"),
    Search(("cogging_torque",), outside=True),
    Search(),
    *(Search((name,), "rig") for name in ("carriage_friction", "specimen_leak", "creep")),
)  # fmt: skip


def keep() -> list[str]:
    """Write what all searches answer."""
    RESULTS.write_text(json.dumps({"machine": _machine(), "searches": _answers()}, indent=1) + "\n")
    return []


def differences() -> list[str]:
    """Return a line on every answer that is not as it was."""
    kept = json.loads(RESULTS.read_text(encoding="utf-8"))
    tolerance = 0.0 if kept["machine"] == _machine() else TOLERANCE
    answers = _answers()
    return [
        f"{name}: {line}"
        for name, before in kept["searches"].items()
        for line in different(before, answers[name], tolerance)
    ]


def _machine() -> str:
    """Return what separates machines whose floating-point results may differ."""
    return f"{zlib.crc32(processor().encode()):08x}, numpy {np.__version__}"


def different(before: Any, after: Any, tolerance: float, path: str = "") -> list[str]:
    """Return lines on what is not the same in two answers; numbers may differ by a relative tolerance."""
    if isinstance(before, Mapping) and isinstance(after, Mapping) and before.keys() == after.keys():
        return [
            line
            for key in before
            for line in different(before[key], after[key], tolerance, f"{path}.{key}".strip("."))
        ]
    if isinstance(before, float) and isinstance(after, float):
        same = math.isclose(before, after, rel_tol=tolerance)
        return [] if same else [f"{path} {before!r} -> {after!r} ({abs(after / before - 1):.1e} relative)"]
    return [] if before == after else [f"{path} {before} -> {after}"]


def _answers() -> dict[str, Any]:
    replays: dict[tuple[str, str], tuple[Parameters, Replay]] = {}
    answers = {}
    for number, search in enumerate(SEARCHES):
        kind = search.system, search.known
        if kind not in replays:
            replays[kind] = _system(search)
        answers[search.name] = _answer(search, *replays[kind], number)
        print(f"{number + 1}/{len(SEARCHES)} {search.name}: {_line(answers[search.name])}", flush=True)
    return answers


def _line(answer: Mapping[str, Any]) -> str:
    return f"{answer['verdict']} {', '.join(answer['effects']) or '-'}"


def _system(search: Search) -> tuple[Parameters, Replay]:
    if search.system == "rig":
        parameters = hidden_rig.nominal()
        return parameters, Replay(test_rig(parameters, hidden_rig.SPECIMEN))
    parameters = cases.nominal()
    if search.known:
        parameters = parameters.changed({f"effects.{search.known}.enabled": True})
    return parameters, Replay(knee(parameters))


def _answer(search: Search, parameters: Parameters, replay: Replay, seed: int) -> dict[str, Any]:
    at_rig = search.system == "rig"
    arrays = _rig_recordings(search, replay.system, seed) if at_rig else _recordings(search, seed)
    *training, held_out = (_recording(name, replay, one) for name, one in arrays.items())
    outcome = find_gap(replay.system, training, [held_out], parameters.gap, replay=replay)
    return _found(outcome)


def _recording(name: str, replay: Replay, arrays: Mapping[str, np.ndarray]) -> Recording:
    return from_arrays(name, replay.system, arrays)


def _found(outcome: Outcome) -> dict[str, Any]:
    def named(effects: tuple[Named, ...]) -> dict[str, Any]:
        return {
            one.name: {"evidence": one.evidence, **{k: v[0] for k, v in one.parameters.items()}}
            for one in effects
        }

    return {
        "verdict": outcome.verdict,
        "effects": named(outcome.effects),
        "surrogates": named(outcome.surrogates),
        "look_alikes": list(outcome.look_alikes),
        "runner_up": outcome.runner_up[0] if outcome.runner_up else None,
        "closure": outcome.closure["overall"],
        "gap_after": outcome.after.white["overall"],
    }


def _recordings(search: Search, seed: int) -> dict[str, dict[str, np.ndarray]]:
    """Return recordings of a knee with hidden effects."""
    rng = np.random.default_rng([seed, 29])
    hidden = list(search.hidden) or 0
    secret = cases.draw(rng, cases.nominal(), search.class_, "medium", hidden, search.outside)
    return record(secret, seed)


def record(
    secret: cases.Secret, seed: int, wrong: Mapping[str, float] | None = None
) -> dict[str, dict[str, np.ndarray]]:
    """Return recordings of a knee: a gait and experiments, and a gait to judge by.

    Args:
        secret: what is hidden in the plant.
        seed: of the noise.
        wrong: values of the plant's parameters of which the nominal model has others.
    """
    parameters = cases.nominal()
    script = diagnostic.Script(parameters.scenario.start_angle, parameters.control.position.mean_pressure)
    for part in EXPERIMENTS:
        part(script, parameters.scenario.diagnostic)
    experiments = diagnostic.Experiment(script.phases, parameters.gap.replay.warm_up)
    slower = parameters.changed({"scenario.cycle_time": 2.6})
    runs = {
        "gait": (make_trajectory(parameters), GAIT),
        "experiments": (experiments, experiments.duration),
        "held-out gait": (make_trajectory(slower), HELD_OUT_GAIT),
    }
    return {
        name: cases.record(parameters, secret, run, 100 * seed + number, wrong=wrong)
        for number, (name, run) in enumerate(runs.items())
    }


def _rig_recordings(search: Search, system: System, seed: int) -> dict[str, dict[str, np.ndarray]]:
    """Return a recording of a rig with a hidden effect, and one to judge by."""
    rng = np.random.default_rng([seed, 29])
    deviations = {one.name: DEVIATION * one.sd * rng.standard_normal() for one in system.calibrations}
    deviations["positioner_damping"] = abs(deviations["positioner_damping"])  # a damper that pushes is none
    hidden = Hidden(**{AT_RIG[name][0]: AT_RIG[name][1] for name in search.hidden})
    nominal = hidden_rig.nominal()
    return {name: hidden_rig.record(rng, nominal, hidden, deviations) for name in ("run", "held-out run")}
