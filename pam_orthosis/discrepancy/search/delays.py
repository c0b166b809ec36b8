# SPDX-License-Identifier: Apache-2.0
"""Several sensors that are late: alone, each makes worse what the other drives, so all are tried at once."""

from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import Trial
from pam_orthosis.discrepancy.fitting.fit import Fit, fit_tempered
from pam_orthosis.discrepancy.fitting.free import free_parameters, scales_of
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.fitting.refit import refined_in
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search.acceptance import accepted
from pam_orthosis.discrepancy.search.confirmation import is_too_small, ranking, weighed
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress

LEAST_PROMISED = 0.5  # of the evidence that is asked for, in a linear estimate of what delays may gain
LEFT_OVER, HOPELESS = 1.1, 100.0  # power density over noise, of the equation with most of it


def or_for_delays(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with delays of the sensors in place of those that were found, where that is better."""
    problem, base = found.final_problem, found.final
    sensors = _sensors(problem.replay)
    left = max(1 / weight**2 for weight in problem.weights.values())
    missing = [name for name in sensors if name not in base.effects]
    dead_time = _has_dead_time(problem.system, base)
    if not LEFT_OVER < left < HOPELESS or len(sensors) < 2 or len(missing) <= dead_time:
        return step  # a dead time and all sensors but one are all sensors, counted from that one
    progress(f"trying {', '.join(sensors)} at once")
    if not dead_time and _promised(Projection(problem, base), missing) < LEAST_PROMISED * settings.threshold:
        return step
    models = _late(problem, base, sensors)
    if not models:
        return step
    best = max(weighed(problem, base, models), key=lambda one: one[0])
    evidence, _, model = best
    if evidence < settings.threshold:
        return step
    name = model.effects[-1]
    other = accepted(problem, base, held_out, [best], ranking([best], ()), {name: evidence})
    if other.accepted:
        found.steps.append(step)
    return other if other.accepted else step


def _late(problem: Problem, base: Fit, sensors: list[str]) -> list[tuple[Problem, Fit]]:
    """Return the model with the sensors that are late, the latest one last, if at least two are.

    Where all are, inputs that act late may be as good, and are simpler: that model is there too.
    """
    system = problem.system
    weighted, model = _with(problem, base, sensors)
    late = [name for name in sensors if not is_too_small(system, name, model)]
    if len(late) < 2:
        return []
    late.sort(key=lambda name: abs(_delay(system, model, name)))
    if len(late) < len(sensors):
        weighted, model = _with(weighted, model, late)
    rest = (name for name in model.effects if name not in late)
    models = [(weighted, replace(model, effects=(*rest, *late)))]
    if len(late) == len(sensors) and not _has_dead_time(system, base):
        able = [name for name in system.candidates if system.catalogue[name].is_dead_time]
        models += [_with(weighted, model, [name]) for name in problem.replay.touching(able)]
    return models


def _promised(projection: Projection, sensors: list[str]) -> float:
    """Return by how much the cost would fall with some sensors late, were it linear."""
    blocks = projection.base.blocks
    late = [Trial(projection, name) for name in sensors]
    moved = [trial.residuals(trial.starts()[-1]) for trial in late]
    slopes = {
        name: np.column_stack([row.get(name, block.residual) - block.residual for row in moved])
        for name, block in blocks.items()
    }
    level = projection.best(*projection.state({}))[1]
    right = projection.state({})[0] + level.gradient(projection.position)
    shared = sum(
        (projection.correlated(name, d) for name, d in slopes.items()), np.zeros((len(right), len(late)))
    )
    hessian = sum(d.T @ d for d in slopes.values()) - shared.T @ level.solve(shared)
    gradient = sum(d.T @ blocks[name].residual for name, d in slopes.items()) - shared.T @ level.solve(right)
    return float(gradient @ np.linalg.lstsq(hessian, gradient, rcond=None)[0])


def _sensors(replay: Replay) -> list[str]:
    """Return the effects that make a channel late."""
    system = replay.system
    late = [name for name in system.candidates if system.catalogue[name].advance is not None]
    return replay.touching(late)


def _with(problem: Problem, base: Fit, sensors: list[str]) -> tuple[Problem, Fit]:
    """Return the model with some sensors late and nothing else: inputs that act late are as good as all."""
    system = problem.system
    kept = tuple(name for name in base.effects if not _is_delay(system, name))
    effects = (*kept, *sensors)
    typical = problem.replay.defaults(effects)
    values = {key: base.values.get(key, value) for key, value in typical.items()}
    free = free_parameters(system, effects, refined_in(system, base), scales_of(system, base.free))
    return fit_tempered(problem, effects, values, free)


def _has_dead_time(system: System, model: Fit) -> bool:
    """Whether inputs act late in a model: it hides what sensors that are late in its place would gain."""
    return any(system.catalogue[name].is_dead_time for name in model.effects)


def _is_delay(system: System, name: str) -> bool:
    effect = system.catalogue[name]
    return effect.advance is not None or effect.late is not None


def _delay(system: System, model: Fit, name: str) -> float:
    return model.values[f"{name}.{system.catalogue[name].fitted[0].name}"]
