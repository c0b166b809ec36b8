# SPDX-License-Identifier: Apache-2.0
"""Does a model with a description do what this says? Where the model bends, the curves are fitted again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.fitting import measure, refit
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.unknown.description import LEAST_REDUCED, Description, refitted
from pam_orthosis.errors import OrthosisError
from pam_orthosis.progress import silent

ROUNDS = 4  # of fits in the model that has the curves of the last one
MORE = 0.003  # of the held-out gap: what a round has to remove
SLOWEST = 0.95  # of a step of an amplitude, the next one, at most
SEEN = 0.01  # squares over those of the noise: the same, where the gap is large


class _Bent(NamedTuple):
    """A recalibrated model with curves, its recordings, and the share of the held-out gap that it removes."""

    problem: Problem
    judge: Problem
    model: Fit
    reduced: float


def standing(start: Beginning, outcome: Outcome) -> Outcome | None:
    """Return an outcome with curves that do most in the model too; None if they leave most of the gap.

    They were fitted to first order. A system of a user's own can be asked, and no other.
    """
    if outcome.verdict != patch.DESCRIBED or outcome.unknown is None or outcome.system.changed is None:
        return outcome
    if not any(patch.of_description(outcome.system, one) for one in outcome.unknown.descriptions):
        return outcome
    if (now := _bent(start, outcome)) is None:
        return None
    over = outcome.kept[outcome.unknown.equation] ** 2 - 1
    more = min(MORE, SEEN / max(over, 1e-12))
    sizes = [_sizes(outcome)]
    for _ in range(ROUNDS):
        other = _refitted(outcome, now)
        sizes.append(_sizes(other))
        further = _bent(start, other)
        if further is None or further.reduced < now.reduced + more:
            break
        outcome, now = other, further
    return _removing(outcome, now, sizes) if now.reduced >= LEAST_REDUCED else None


def _sizes(outcome: Outcome) -> np.ndarray:
    """Return the amplitudes of the curves."""
    return np.array([one.amplitude[0] for one in outcome.unknown.descriptions] if outcome.unknown else [])


def _unsettled(told: Sequence[Description], sizes: Sequence[np.ndarray]) -> list[Description]:
    """Return curves whose intervals hold what further rounds would move them by.

    That is what a geometric series has left, but no more than all rounds together have moved.
    """
    steps = np.abs(np.diff(np.array(sizes), axis=0))
    if not len(steps):
        return list(told)
    before, last = (steps if len(steps) > 1 else np.vstack([2 * steps, steps]))[-2:]
    ratio = np.minimum(last / np.maximum(before, 1e-300), SLOWEST)
    rest = np.minimum(last / (1 - ratio), np.ptp(np.array(sizes), axis=0))
    return [
        one if one.is_constant else replace(one, moving=float(more))
        for one, more in zip(told, rest, strict=True)
    ]


def _refitted(outcome: Outcome, bent: _Bent) -> Outcome:
    """Return an outcome with its curves fitted again in the model that has them."""
    told = outcome.unknown
    assert told is not None
    equation = next(one for one in bent.problem.system.equations if one.name == told.equation)
    curves = refitted(bent.problem, bent.judge, bent.model, equation, told.descriptions)
    return replace(outcome, unknown=replace(told, descriptions=curves))


def _removing(outcome: Outcome, bent: _Bent, sizes: Sequence[np.ndarray]) -> Outcome:
    """Return an outcome whose curves remove as much, and whose parameters are, as in the model with both."""
    told = outcome.unknown
    assert told is not None
    share = bent.reduced / told.reduced
    settled = _unsettled(told.descriptions, sizes)
    parts = [replace(one, reduced=one.reduced * share) for one in settled]
    beside = {**_parameters(bent), **_effects(outcome, bent)}
    return replace(outcome, unknown=replace(told, descriptions=parts, beside=beside))


def _parameters(bent: _Bent) -> dict[str, float]:
    """Return key -> value of the parameters of a recalibrated model, as a model file has them."""
    system, values = bent.problem.system, bent.model.values
    moved = {name: one for name in system.wrong if (one := system.recalibrating(name)) is not None}
    known = {f"{name}.{VALUE}": values[one.name] for name, one in moved.items()}
    return patch.overrides(system, [*moved], known)


def _effects(outcome: Outcome, bent: _Bent) -> dict[str, float]:
    """Return key -> value of the parameters of named effects, which are recalibrated by their deviation."""
    found = {}
    for key, value in patch.changes_of(outcome).items():
        deviation = bent.model.values.get(key.removeprefix(f"{outcome.system.branch}.").replace(".", "_"))
        if key.startswith(f"{outcome.system.branch}.") and deviation is not None:
            found[key] = float(f"{value * (1 + deviation):.6g}")
    return found


def _bent(start: Beginning, outcome: Outcome) -> _Bent | None:
    """Return the model that has an outcome's curves; None if it cannot have them, or runs away."""
    assert outcome.unknown is not None
    assert outcome.system.changed is not None
    try:
        better = outcome.system.changed(patch.changes_of(outcome))
        judged = {one.name for one in outcome.system.equations}
        better = replace(better, equations=tuple(one for one in better.equations if one.name in judged))
        replay = Replay(better, start.problem.replay.workers)
        problem, model = refit.recalibrated(Problem(replay, start.problem.scored), silent)
    except OrthosisError:  # effects moved out of their bounds, or it has no minimum
        return None
    judge, equation = Problem(replay, start.held_out.scored), outcome.unknown.equation
    now = measure.over_noise(outcome.system, measure.gap(judge, model), outcome.floor)[equation]
    gap = outcome.kept[equation] ** 2 - 1
    return _Bent(problem, judge, model, 1 - (now**2 - 1) / max(gap, 1e-12))
