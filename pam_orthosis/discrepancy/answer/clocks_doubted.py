# SPDX-License-Identifier: Apache-2.0
"""Are stamps off that seem off? Only if what is found fits recordings far better that are moved by as much.

A skew is seen from accelerations, before any search: what is missing may look like one.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.fitting.fit import Fit, fit_tempered
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.recordings.stamps import Skew
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.errors import OrthosisError

BETTER = 0.8  # of the gap of what is fitted, or what judges, that moved recordings may leave at most


def without_doubtful_stamps(start: Beginning, outcome: Outcome, cutoff: float) -> Outcome:
    """Return an outcome without remarks on stamps by which its model fits hardly better, or worse.

    `cutoff`: with which neighbouring signals are smoothed, Hz.
    """
    if outcome.skewed or not {*start.stamps} & {*outcome.remarks} or _fits_better(start, outcome, cutoff):
        return outcome
    return replace(outcome, remarks=[one for one in outcome.remarks if one not in start.stamps])


def _fits_better(start: Beginning, outcome: Outcome, cutoff: float) -> bool:
    """Return whether what is named, or the recalibrated model, fits recordings with moved signals better."""
    found, judge = outcome.selection, outcome.held_out
    problem, model = (found.final_problem, found.final) if outcome.effects else (found.problem, found.null)
    moved = _moved(start, problem.system, [*problem.scored, *judge.scored], cutoff)
    fitted, judged = problem.on(moved[: len(problem.scored)]), judge.on(moved[len(problem.scored) :])
    pairs = ((fitted, problem), (judged, judge))
    try:
        _, other = fit_tempered(fitted, model.effects, model.values, model.free)
        left = [(_overall(one, other), _overall(whole, model)) for one, whole in pairs]
    except OrthosisError:  # it has no minimum
        return True
    finally:
        for one in moved:
            problem.replay.forget(one.run)
    described = outcome.unknown is not None and bool(outcome.unknown.descriptions)
    most = outcome.left_unknown if described else np.inf
    return any(there < min(BETTER * here, most) for there, here in left)


def _overall(problem: Problem, model: Fit) -> float:
    """Return how many times the noise a model leaves."""
    return measure.gap(problem, model).white[measure.OVERALL]


def _moved(start: Beginning, system: System, scored: Sequence[Scored], cutoff: float) -> list[Scored]:
    """Return runs whose signals are moved by the skews of their recordings, or those of others."""
    skews = [[*many] for _, many in start.skews]
    usual = list({skew[:2]: skew for many in skews for skew in many}.values())
    result = []
    for i, one in enumerate(scored):
        recording = one.run.recording
        own = skews[i % len(skews)]  # of the same recording, where its last part judges
        for skew in own or usual:
            recording = _shifted(recording, system, skew)
        result.append(Scored(Run(system, recording, cutoff), one.whiten, one.warm_up))
    return result


def _shifted(one: Recording, system: System, skew: Skew) -> Recording:
    """Return a recording whose signals are earlier by a skew; what is held, by whole rows."""
    time, signals = np.arange(one.samples) * one.period, dict(one.signals)
    for name in skew.signals:
        held = name in system.inputs and name not in system.gradual
        lead = round(skew.seconds / one.period) * one.period if held else skew.seconds
        signals[name] = np.interp(np.clip(time + lead, 0.0, time[-1]), time, one.signals[name])
    return replace(one, signals=signals)
