# SPDX-License-Identifier: Apache-2.0
"""Evidence of fitted models at common weights, and whether held-out recordings confirm them."""

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np

from pam_orthosis.discrepancy.candidates import Candidate
from pam_orthosis.discrepancy.fit import Fit, fit, prior_cost, score
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.system import Equation, System

BLOCK = 1.0  # s, of paired differences on held-out recordings
LEAST_T = 3.0  # of these differences
LEAST_TRANSFER = 0.3  # of the training's fall, where one block holds most of it
LEAST_FALL = 1.0  # in training, a block: below it there is nothing to compare
WORST_T = -3.0  # an effect known by its broken tolerance alone must not make held-out data worse
SURE = 30.0  # evidence, for each effect of a model, of training alone where nothing is left to be shown
SILENT = 1.2  # mean square of whitened residuals: noise alone is left
EARLIEST = -1e-3  # s: what acts earlier, acts before its input
EMPTY = "would not be what its name says"
MOST_SHOWN = 3  # parameters in one line
REFIT_NULL = 10.0  # the smaller model is refitted with the larger one's weights below this ratio


def weighed(
    problem: Problem, base: Fit, models: Sequence[tuple[Problem, Fit]]
) -> list[tuple[float, Problem, Fit]]:
    """Return evidence, weighted problem and fit of each model, all with the best model's weights."""
    if not models:
        return []
    weights = dict(problem.weights)
    for weighted, _ in models:
        weights = {name: max(w, weighted.weights[name]) for name, w in weights.items()}
    common = problem.weighted(weights)
    before = score(common, _comparable(problem, common, base))
    return [(before - score(common, model), weighted, model) for weighted, model in models]


def _comparable(problem: Problem, common: Problem, base: Fit) -> Fit:
    """Return the smaller model refitted with the common weights where these are not far from its own."""
    ratio = max((common.weights[name] / w) ** 2 for name, w in problem.weights.items())
    if ratio > REFIT_NULL or ratio < 1.05:
        return base
    return fit(common, base.effects, base.values, base.free, most=2)


def ranking(
    judged: Sequence[tuple[float, Problem, Fit]], ranked: Sequence[Candidate]
) -> tuple[tuple[str, float], ...]:
    """Return effects with their evidence, best first: of the full fit where there is one."""
    full = [(model.effects[-1], evidence) for evidence, _, model in judged]
    rest = [(one.name, one.evidence) for one in ranked if one.name not in dict(full)]
    return (*full, *rest)


def confirmed(training: Problem, held_out: Problem, smaller: Fit, larger: Fit) -> tuple[float, float]:
    """Return how recordings that were not fitted see a larger model.

    Two figures, since blocks of time are few and one may hold most of the gap: the t value of the fall
    of squared residuals over blocks, and the fall a sample over that in training.
    """
    unseen, seen = (_falls(problem, smaller, larger) for problem in (held_out, training))
    # one block shows nothing of its own spread
    spread = unseen.std(ddof=1) / np.sqrt(len(unseen)) if len(unseen) > 1 else np.inf
    t = float(unseen.mean() / max(spread, 1e-12))
    return t, float(unseen.mean() / seen.mean()) if seen.mean() > LEAST_FALL else 0.0


def leaves_noise_alone(problem: Problem, base: Fit, name: str) -> bool:
    """Whether a model leaves noise alone of recordings in all equations that an effect changes."""
    plain = problem.weighted(dict.fromkeys(problem.weights, 1.0))
    own = [one for one in problem.system.equations if one.name in problem.replay.touched(name)]
    left = [np.mean(plain.residual(one, base.effects, base.values) ** 2) for one in own]
    return all(level < SILENT for level in left)


def _falls(problem: Problem, smaller: Fit, larger: Fit) -> np.ndarray:
    """Return by how much squared residuals fall, block by block."""
    falls = []
    for equation in problem.system.equations:
        before = problem.residual(equation, smaller.effects, smaller.values)
        after = problem.residual(equation, larger.effects, larger.values)
        falls.append(block_sums(problem, equation, before**2 - after**2))
    total: np.ndarray = np.sum(falls, axis=0)
    return total


def block_sums(problem: Problem, equation: Equation, values: np.ndarray) -> np.ndarray:
    """Return sums over blocks of time, the equation's channels added."""
    sums = []
    for one, part in problem.by_run(equation, values):
        size = round(BLOCK / one.run.period)
        whole = one.samples // size * size
        sums.append(part.sum(axis=0)[:whole].reshape(-1, size).sum(axis=1))
    return np.concatenate(sums)


def is_visible(problem: Problem, base: Fit, model: Fit) -> bool:
    """Whether the effect removes a visible misfit, not only a strain on the tolerances."""
    fall = sum(float(np.sum(b.residual**2)) for b in base.blocks.values())
    fall -= problem.total(model.effects, model.values)
    relief = prior_cost(base.free, base.values) - prior_cost(model.free, model.values)
    return fall > max(0.0, relief)


def is_too_small(system: System, name: str, model: Fit) -> bool:
    """Return whether an effect is below the size from which on it is worth a name."""
    effect = system.catalogue[name]
    size = effect.fitted[0]
    if effect.shape:
        return False
    if size.neutral is None:
        return False
    return abs(model.values[f"{name}.{size.name}"] - size.neutral) < effect.minimum_effect


def emptied(system: System, name: str, model: Fit) -> tuple[str, ...]:
    """Return the parameters (as `EFFECT.PARAMETER`) at which an effect is not what its name says."""
    effect = system.catalogue[name]
    own = {q.name: model.values[f"{name}.{q.name}"] for q in effect.parameters}
    if effect.late is not None and system.late + effect.late(SimpleNamespace(**own)) < EARLIEST:
        return tuple(f"{name}.{q}" for q in own)
    return tuple(f"{name}.{q.name}" for q in effect.parameters if q.is_empty(own[q.name]))


def at_values(model: Fit, keys: Sequence[str]) -> str:
    """Return parameters with their values in words, the first ones."""
    shown = ", ".join(f"{key} = {model.values[key]:.4g}" for key in keys[:MOST_SHOWN])
    return shown + (f" and {len(keys) - MOST_SHOWN} more" if len(keys) > MOST_SHOWN else "")
