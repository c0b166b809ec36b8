# SPDX-License-Identifier: Apache-2.0
"""Has an input noise that its system does not state, and would that alone leave as much as is left?"""

import numpy as np

from pam_orthosis.discrepancy.answer.digits import in_short
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.noisy import forget, with_noise
from pam_orthosis.discrepancy.replay.problem import Problem, sum_of_squares
from pam_orthosis.discrepancy.replay.whitening import noise_levels
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import System

ROUGHER = 1.5  # times the noise that is stated: below it that may be right
LEAST = 0.25  # of the squares that are left: what noise leaves which is worth a word


def unstated_noise(found: Selection, named: bool) -> list[str]:
    """Return a remark on each input whose noise, not stated, leaves much of what a model leaves.

    It is the model with all effects if they are `named`. The voltages of machines are commands: exact.
    """
    problem, model = (found.final_problem, found.final) if named else (found.problem, found.null)
    if problem.system.input_period:
        return []
    left = sum_of_squares(problem.residuals(model.effects, model.values))
    return [
        _words(problem.system, name, level)
        for name, level in _levels(problem).items()
        if _left_by(problem, model, name, level) > LEAST * left
    ]


def _levels(problem: Problem) -> dict[str, float]:
    """Return the noise (sd) of inputs that are rougher from row to row than is stated."""
    system, runs = problem.system, [one.run for one in problem.scored]
    levels: dict[str, float] = {}
    for name in system.inputs:
        having = [run for run in runs if name in run.recording.signals]
        rows, periods = [run.recording.signals[name] for run in having], [run.period for run in having]
        levels |= noise_levels({name: rows}, periods) if having else {}
    return {name: sd for name, sd in levels.items() if sd > ROUGHER * system.input_noise.get(name, 0.0)}


def _left_by(problem: Problem, model: Fit, name: str, level: float) -> float:
    """Return the squares that noise of an input leaves of a model."""
    rng = np.random.default_rng(0)
    noisy = with_noise(
        problem, [{name: level * rng.standard_normal(one.run.recording.samples)} for one in problem.scored]
    )
    plain = problem.residuals(model.effects, model.values)
    changed = noisy.residuals(model.effects, model.values)
    forget(noisy)
    return sum_of_squares({key: changed[key] - row for key, row in plain.items()})


def _words(system: System, name: str, level: float) -> str:
    unit = system.input_units[name]
    return (
        f"{name} varies from row to row by {in_short((level, unit))}, which may be why this is left: if that"
        f" is noise of its sensor, write Input({name!r}, {unit!r}, noise={level:.2g}) and search again"
    )
