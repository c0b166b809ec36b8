# SPDX-License-Identifier: Apache-2.0
"""Evidence of fitted models at common weights, and whether held-out recordings confirm them."""

from collections.abc import Sequence
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import Candidate
from pam_orthosis.discrepancy.fitting.fit import Fit, fit, prior_cost, score
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.whitening import stated
from pam_orthosis.discrepancy.search.filtered import noise_squares
from pam_orthosis.discrepancy.systems.implied import is_lag
from pam_orthosis.discrepancy.systems.system import Equation, System

BLOCK = 1.0  # s, of paired differences on held-out recordings
LEAST_T = 3.0  # of these differences
LEAST_TRANSFER = 0.3  # of the training's fall, where one block holds most of it
LEAST_FALL = 1.0  # in training, a block: below it there is nothing to compare
WORST_T = -3.0  # an effect known by its broken tolerance alone must not make held-out data worse
SURE = 30.0  # evidence, for each effect of a model, that training alone must give where held-out data cannot
SILENT = 1.2  # mean square of whitened residuals: noise alone is left
LEAST_DUE = 36.0  # fall of squared residuals that gives a t of 3 if the model is right
MOST_AGAINST = 9.0  # their rise that speaks against it
EARLIEST = -1e-3  # s: what acts earlier, acts before its input
EMPTY = "would not be what its name says"
LONGEST = ", the longest delay that is tried: give the model what is known of it"
MOST_OF_RECORDING = 0.5  # that a lag may last: what follows more slowly is a zero, or a drift
SLOW = "would follow so slowly that it may be a zero or a drift"
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


class Seen(NamedTuple):
    """How recordings that were not fitted see a larger model.

    Attributes:
        t: t value of the fall of squared residuals over blocks of time.
        transfer: that fall a sample over the one in training: blocks are few, one may hold most of the gap.
        fall: the fall itself.
        due: what it would be if the larger model were right, with a standard deviation of 2 sqrt(due).
    """

    t: float
    transfer: float
    fall: float
    due: float

    @property
    def shows(self) -> bool:
        """Whether they confirm the larger model."""
        return self.t > LEAST_T or self.transfer > LEAST_TRANSFER

    @property
    def speaks_against(self) -> bool:
        """Whether they do: steadily, and by more than a trifle that is steady."""
        return self.t <= WORST_T and self.fall <= -MOST_AGAINST

    @property
    def cannot_show(self) -> bool:
        """Whether they could not confirm it if it were right, and do not speak against it."""
        return self.due < LEAST_DUE and self.fall > -MOST_AGAINST


def confirmed(training: Problem, held_out: Problem, smaller: Fit, larger: Fit) -> Seen:
    """Return how recordings that were not fitted see a larger model."""
    (unseen, due), (seen, _) = (_falls(problem, smaller, larger) for problem in (held_out, training))
    transfer = float(unseen.mean() / seen.mean()) if seen.mean() > LEAST_FALL else 0.0
    return Seen(t_value(unseen), transfer, float(unseen.sum()), due)


def t_value(values: np.ndarray) -> float:
    """Return the t value of a mean."""
    # one value shows nothing of its own spread
    spread = values.std(ddof=1) / np.sqrt(len(values)) if len(values) > 1 else np.inf
    return float(values.mean() / max(spread, 1e-12))


def leaves_noise_alone(problem: Problem, base: Fit) -> bool:
    """Whether a model leaves noise alone of recordings, in each channel of each."""
    for equation in problem.system.equations:
        row = problem.residual(equation, base.effects, base.values) / problem.weights[equation.name]
        if any(np.mean(part**2, axis=1).max() > SILENT for _, part in problem.by_run(equation, row)):
            return False
    return True


def _falls(problem: Problem, smaller: Fit, larger: Fit) -> tuple[np.ndarray, float]:
    """Return by how much squared residuals fall, block by block, and `Seen.due`.

    What the larger model filters of the noise with which inputs were read shows nothing: it does not count.
    """
    falls, due = [], 0.0
    if stated(problem.system):
        left, kept = (noise_squares(problem, model) for model in (smaller, larger))
        falls = [
            block_sums(problem, one, kept[one.name] - left[one.name]) for one in problem.system.equations
        ]
    for equation in problem.system.equations:
        before = problem.residual(equation, smaller.effects, smaller.values)
        after = problem.residual(equation, larger.effects, larger.values)
        falls.append(block_sums(problem, equation, before**2 - after**2))
        due += float(np.sum((before - after) ** 2))
    total: np.ndarray = np.sum(falls, axis=0)
    return total, due


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


def least_size(system: System, name: str) -> str:
    """Return the size from which on an effect is worth a name, in words."""
    effect = system.catalogue[name]
    return f"{effect.minimum_effect:g} {effect.fitted[0].unit}"


def emptied(system: System, name: str, model: Fit) -> tuple[str, ...]:
    """Return the parameters (as `EFFECT.PARAMETER`) at which an effect is not what its name says."""
    effect = system.catalogue[name]
    own = {q.name: model.values[f"{name}.{q.name}"] for q in effect.parameters}
    if effect.late is not None:
        known = system.late + system.later.get(effect.late_of, 0.0)
        if known + effect.late(SimpleNamespace(**own)) < EARLIEST:
            return tuple(f"{name}.{q}" for q in own)
    return tuple(f"{name}.{q.name}" for q in effect.parameters if q.is_empty(own[q.name]))


def is_slow(problem: Problem, name: str, model: Fit) -> bool:
    """Return whether an effect is a lag that no recording is long enough to tell from a zero or a drift."""
    effect = problem.system.catalogue[name]
    if not is_lag(effect):
        return False
    longest = max(one.run.recording.samples * one.run.period for one in problem.scored)
    return model.values[f"{name}.{effect.fitted[0].name}"] > MOST_OF_RECORDING * longest


def at_values(system: System, model: Fit, keys: Sequence[str]) -> str:
    """Return parameters with their values in words, the first ones; and what to do about a long delay."""
    shown = ", ".join(f"{key} = {model.values[key]:.4g}" for key in keys[:MOST_SHOWN])
    more = f" and {len(keys) - MOST_SHOWN} more" if len(keys) > MOST_SHOWN else ""
    longest = any(_is_longest(system, model, key.partition(".")[0]) for key in keys)
    return shown + more + LONGEST * longest


def _is_longest(system: System, model: Fit, name: str) -> bool:
    """Return whether an effect is a delay that would be longer than any that is tried."""
    effect = system.catalogue[name]
    return effect.late is not None and any(
        model.values[f"{name}.{q.name}"] >= q.maximum for q in effect.fitted
    )
