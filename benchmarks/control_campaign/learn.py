# SPDX-License-Identifier: Apache-2.0
"""What a specimen's own recordings teach, with the effects given by name: one joint fit, no search.

`pam-orthosis improve` searches for the names; for the tables over many specimens the names that hardware of
this kind can have are given, and each specimen's parameters are fitted to its own recordings. Of the plant
nothing is used but these.
"""

from __future__ import annotations

from typing import Any

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.discrepancy.fitting.fit import fit_tempered, score
from pam_orthosis.discrepancy.fitting.free import free_parameters
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.improvement import learned
from pam_orthosis.improvement.rounds import experiments
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import NOMINAL

EFFECTS = (
    "joint_friction", "muscle_hysteresis", "creep", "backlash", "direction_dependent_damping",
    "valve_dead_band", "valve_delay", "extensor_leak", "flexor_leak", "supply_sag",
)  # fmt: skip
MECHANICAL = EFFECTS[:5]
RECORDED = ("gait", "gait-faster", "decay")
# what one knows of hardware that was bought and not yet measured: sd of the ranges that it is drawn from
TOLERANCES = {
    "muscle_damping": 0.5, "extensor_force": 0.05, "flexor_force": 0.05, "conductance": 0.15,
    "critical_ratio": 0.25, "polytropic_exponent": 0.08, "supply_pressure": 0.12, "hose_volume": 0.4,
    "hose_conductance": 0.3,
}  # fmt: skip


def tolerances(specimen: int) -> dict[str, float]:
    """Return the overrides of `gap.tolerance`: the shipped hardware is known as the configuration says."""
    return {f"gap.tolerance.{name}": value for name, value in TOLERANCES.items()} if specimen else {}


def learn(parameters) -> dict[str, Any]:
    """Return the nominal model that the specimen's recordings give, as overrides."""
    system = knee(parameters.only(*NOMINAL, "gap"), learned.learnable(parameters.declared))
    values = fitted(system, recordings(system, parameters), parameters.gap)
    effects = [name for name in EFFECTS if _matters(name, values)]
    return learned.calibrated(parameters, effects, values) | learned.named(parameters, effects, values)


def recordings(system, parameters) -> list:
    """Return what the specimen does in the experiments of `RECORDED`."""
    made = []
    for experiment in experiments(parameters):
        if experiment.name in RECORDED:
            there = parameters.changed(experiment.changes)
            steps = round(there.scenario.duration / there.scenario.control_period)
            made.append(from_arrays(experiment.name, system, ClosedLoop(there, experiment.seed).run(steps)))
    return made


def fitted(system, recorded, settings) -> dict[str, float]:
    """Return all parameters of the model with `EFFECTS`, fitted to recordings within their tolerances."""
    replay = Replay(system)
    problem, _, _ = beginning.prepared(replay, recorded, recorded[:1], settings)
    typical, free = replay.defaults(EFFECTS), free_parameters(system, EFFECTS)
    fits = [fit_tempered(problem, EFFECTS, typical, free)]
    fits.append(fit_tempered(problem, EFFECTS, _restarted(fits[0][1].values, typical), free))
    weights = {name: max(weighted.weights[name] for weighted, _ in fits) for name in problem.weights}
    common = problem.weighted(weights)
    found = min((one for _, one in fits), key=lambda one: score(common, one))
    return {key: float(value) for key, value in found.values.items()}


def _restarted(values, typical) -> dict[str, float]:
    """Return values with those effects back at their start that oppose the same motion.

    While much is far off, one of them may drive the others out of their place.
    """
    start = {key: value for key, value in typical.items() if key.split(".")[0] in MECHANICAL}
    return {**values, **start, "direction_dependent_damping.asymmetry": 0.0}


def _matters(name: str, values) -> bool:
    effect = KNEE.catalogue[name]
    size = effect.fitted[0]
    off = size.neutral if size.neutral is not None else 0.0
    return abs(values[f"{name}.{size.name}"] - off) >= effect.minimum_effect
