# SPDX-License-Identifier: Apache-2.0
"""Does a model with a description do what this says? Where the model bends, the curves are fitted again."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.fitting import measure, refit
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.unknown.description import LEAST_REDUCED, refitted
from pam_orthosis.errors import OrthosisError
from pam_orthosis.progress import silent

ROUNDS = 4  # of fits in the model that has the curves of the last one
MORE = 0.003  # of the held-out gap: what a round has to remove


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
    for _ in range(ROUNDS):
        other = _refitted(outcome, now)
        further = _bent(start, other)
        if further is None or further.reduced < now.reduced + MORE:
            break
        outcome, now = other, further
    return _removing(outcome, now.reduced) if now.reduced >= LEAST_REDUCED else None


def _refitted(outcome: Outcome, bent: _Bent) -> Outcome:
    """Return an outcome with its curves fitted again in the model that has them."""
    told = outcome.unknown
    assert told is not None
    equation = next(one for one in bent.problem.system.equations if one.name == told.equation)
    curves = refitted(bent.problem, bent.judge, bent.model, equation, told.descriptions)
    return replace(outcome, unknown=replace(told, descriptions=curves))


def _removing(outcome: Outcome, share: float) -> Outcome:
    """Return an outcome whose curves remove a share of the held-out gap together."""
    told = outcome.unknown
    assert told is not None
    parts = [replace(one, reduced=one.reduced * share / told.reduced) for one in told.descriptions]
    return replace(outcome, unknown=replace(told, descriptions=parts))


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
    judge = Problem(replay, start.held_out.scored)
    before, now = (
        measure.over_noise(outcome.system, gap, outcome.floor)[outcome.unknown.equation]
        for gap in (outcome.before, measure.gap(judge, model))
    )
    return _Bent(problem, judge, model, 1 - (now**2 - 1) / max(before**2 - 1, 1e-12))
