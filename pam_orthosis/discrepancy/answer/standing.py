# SPDX-License-Identifier: Apache-2.0
"""Does a model with a description do what the description says?"""

from dataclasses import replace

from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.fitting import measure, refit
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.unknown.description import LEAST_REDUCED
from pam_orthosis.errors import OrthosisError
from pam_orthosis.progress import silent


def stands(start: Beginning, outcome: Outcome) -> bool:
    """Return whether what is described removes most of the gap as a part of the model too.

    Curves are fitted to first order, and a model may bend. A system of a user's own can be asked.
    """
    if outcome.verdict != patch.DESCRIBED or outcome.unknown is None or outcome.system.changed is None:
        return True
    if not any(patch.of_description(outcome.system, one) for one in outcome.unknown.descriptions):
        return True  # the model has a curve there already
    try:
        better = outcome.system.changed(patch.changes_of(outcome))
    except OrthosisError:  # effects moved out of their bounds
        return False
    judged = {one.name for one in outcome.system.equations}
    better = replace(better, equations=tuple(one for one in better.equations if one.name in judged))
    return _reduced(start, outcome, better) >= LEAST_REDUCED


def _reduced(start: Beginning, outcome: Outcome, better: System) -> float:
    """Return the share of an equation's held-out gap, above the noise, that a model leaves no more."""
    assert outcome.unknown is not None
    replay = Replay(better, start.problem.replay.workers)
    try:
        _, model = refit.recalibrated(Problem(replay, start.problem.scored), silent)
    except OrthosisError:  # it runs away
        return 0.0
    after = measure.gap(Problem(replay, start.held_out.scored), model)
    before, now = (
        measure.over_noise(outcome.system, gap, outcome.floor)[outcome.unknown.equation]
        for gap in (outcome.before, after)
    )
    return 1 - (now**2 - 1) / max(before**2 - 1, 1e-12)
