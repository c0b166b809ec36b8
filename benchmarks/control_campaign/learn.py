# SPDX-License-Identifier: Apache-2.0
"""What a specimen's own recordings teach, with the effects given by name: one joint fit, no search.

`pam-orthosis improve` searches for the names; for the tables over many specimens the names that hardware of
this kind can have are given, and each specimen's parameters are fitted to its own recordings. Of the plant
nothing is used but these.
"""

from __future__ import annotations

from typing import Any

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.data import from_arrays
from pam_orthosis.discrepancy.fit import fit_tempered, free_parameters
from pam_orthosis.discrepancy.knee import knee
from pam_orthosis.discrepancy.replay import Replay
from pam_orthosis.improvement import learned
from pam_orthosis.improvement.experiments import programme
from pam_orthosis.model.effects import CATALOGUE

EFFECTS = (
    "joint_friction", "muscle_hysteresis", "creep", "backlash", "direction_dependent_damping",
    "valve_dead_band", "valve_lag", "valve_delay", "extensor_leak", "flexor_leak",
)  # fmt: skip
RECORDED = ("gait", "gait-faster", "decay")


def learn(parameters) -> dict[str, Any]:
    """Return the belief that the specimen's recordings give, as overrides."""
    recordings, system = [], knee(parameters, learned.LEARNABLE)
    for experiment in programme(parameters):
        if experiment.name in RECORDED:
            there = parameters.changed(experiment.changes)
            steps = round(there.scenario.duration / there.scenario.control_period)
            run = ClosedLoop(there, experiment.seed).run(steps)
            recordings.append(from_arrays(experiment.name, system, run))
    values = fitted(system, recordings, parameters.gap)
    effects = [name for name in EFFECTS if _matters(name, values)]
    return learned.calibrated(parameters, effects, values) | learned.named(parameters, effects, values)


def fitted(system, recordings, settings) -> dict[str, float]:
    """Return all parameters of the model with `EFFECTS`, fitted to recordings within their tolerances."""
    replay = Replay(system)
    problem, _, _ = workflow.prepared(replay, recordings, recordings[:1], settings)
    _, found = fit_tempered(problem, EFFECTS, replay.defaults(EFFECTS), free_parameters(system, EFFECTS))
    return {key: float(value) for key, value in found.values.items()}


def _matters(name: str, values) -> bool:
    effect = CATALOGUE[name]
    size = effect.fitted[0]
    off = size.neutral if size.neutral is not None else 0.0
    return abs(values[f"{name}.{size.name}"] - off) >= effect.minimum_effect
