# SPDX-License-Identifier: Apache-2.0
"""A small effect beside large ones, judged where these are silent.

What the exact form of a large effect leaves over looks like a small effect, and can do so only where the
large one shows. A delay says nothing while pressures rest: what is seen there is not left over from it.
"""

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from scipy.ndimage import maximum_filter1d

from pam_orthosis.discrepancy.fitting.candidates import (
    Candidate,
    Trial,
    candidate,
    secant_gain,
    widened_shape,
)
from pam_orthosis.discrepancy.fitting.fit import Fit, fit, score
from pam_orthosis.discrepancy.fitting.free import of_effect, with_scales
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.system import Equation

SILENT = 0.5  # whitened samples: by how much a silent effect may change them
AROUND = 0.1  # s, on both sides of a sample, in which it must be silent too
LEAST_SECONDS = 5.0  # of silence, over all recordings
STEPS = 3


def evidence(problem: Problem, base: Fit, names: Sequence[str], large: Collection[str]) -> dict[str, float]:
    """Return the evidence of effects beside a model, by samples in which its large effects are silent.

    The large effects stay as they are; all else is fitted anew to these samples. Empty if there are too few.

    Args:
        names: effects that are missing in the model.
        large: those of its effects that must be silent.
    """
    shown = _silences(problem, base, large)
    if _seconds(problem, shown) < LEAST_SECONDS:
        return {}
    quiet = problem.shown(shown)
    free = [one for one in base.free if one.name.partition(".")[0] not in large]
    smaller = fit(quiet, base.effects, base.values, free, most=STEPS)
    before, projection = score(quiet, smaller), Projection(quiet, smaller)
    scores = problem.replay.workers.forked(
        lambda name: score(quiet, _fitted(projection, name)), names, problem.replay
    )
    return {name: before - one for name, one in zip(names, scores, strict=True)}


def _fitted(projection: Projection, name: str) -> Fit:
    """Return the model with an effect more, fitted to the problem of a projection.

    A shape correction is there already: it may go beyond its priors.
    """
    problem, base = projection.problem, projection.base
    if name in problem.system.shapes:
        one = widened_shape(projection, name)
        free = with_scales(problem.system, base.free, one.scales)
    else:
        one = beside(projection, name)
        free = [*base.free, *(free for added in one.added for free in of_effect(problem.system, added))]
    return fit(problem, (*base.effects, *one.added), one.values, free, most=STEPS)


def beside(projection: Projection, name: str) -> Candidate:
    """Return an effect fitted beside a model, from the start that promises most."""
    trial = Trial(projection, name)
    starts = trial.starts()
    gains = [secant_gain(projection, trial, start) for start in starts]
    best = int(np.argmax(gains))
    return candidate(projection, trial, [starts[best]], gains[best])


def _silences(problem: Problem, model: Fit, large: Collection[str]) -> dict[str, np.ndarray]:
    """Return, for each equation's row of residuals, the samples in which effects are silent."""
    plain = problem.weighted(dict.fromkeys(problem.weights, 1.0))
    with_all = plain.residuals(model.effects, model.values)
    loudest = {name: np.zeros(len(row)) for name, row in with_all.items()}
    for effect in large:
        rest = tuple(name for name in model.effects if name != effect)
        for name, row in plain.residuals(rest, model.values).items():
            np.maximum(loudest[name], np.abs(row - with_all[name]), out=loudest[name])
    return {
        equation.name: _around(problem, equation, loudest[equation.name]) < SILENT
        for equation in problem.system.equations
    }


def _around(problem: Problem, equation: Equation, row: np.ndarray) -> np.ndarray:
    """Return the largest value near each sample, recording by recording."""
    parts = [
        maximum_filter1d(part, 2 * round(AROUND / one.run.period) + 1, axis=1).ravel()
        for one, part in problem.by_run(equation, row)
    ]
    return np.concatenate(parts)


def _seconds(problem: Problem, shown: Mapping[str, np.ndarray]) -> float:
    """Return the time that is shown in the equation that has least of it."""
    seconds = [
        sum(one.run.period * float(part.sum()) for one, part in problem.by_run(e, shown[e.name]))
        / len(e.channels)
        for e in problem.system.equations
    ]
    return min(seconds)
