# SPDX-License-Identifier: Apache-2.0
"""The gap workflow: check, replay, find where, name, add, show."""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.answer.agreement import remarks_on_agreement, remarks_on_contradiction
from pam_orthosis.discrepancy.answer.between import declared_otherwise, remarks_on_inputs, stamped_late
from pam_orthosis.discrepancy.answer.clocks_doubted import without_doubtful_stamps
from pam_orthosis.discrepancy.answer.judgement import GOOD, OPEN, Outcome, outcome_of
from pam_orthosis.discrepancy.answer.patch import DESCRIBED
from pam_orthosis.discrepancy.answer.ratios import of_ratios
from pam_orthosis.discrepancy.answer.standing import standing
from pam_orthosis.discrepancy.answer.unknown_words import short
from pam_orthosis.discrepancy.answer.unstated import unstated_noise
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.preparation.beginning import Beginning, begin
from pam_orthosis.discrepancy.preparation.clocks import is_periodic, on_one_clock
from pam_orthosis.discrepancy.preparation.mistakes import CHECK
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search import select
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.unknown.unknown import unknown
from pam_orthosis.discrepancy.workers import alone
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Section, load
from pam_orthosis.progress import Progress, silent

NEARLY = 0.1  # of a gap, that a description leaves without the effects that are named
ALONE = 1.1  # times the noise: hardly more than noise alone


def find_gap(
    system: System,
    training: Sequence[Recording],
    held_out: Sequence[Recording],
    settings: Section | None = None,
    progress: Progress = silent,
    replay: Replay | None = None,
) -> Outcome:
    """Find where recordings and the model disagree, and which effects explain it.

    Args:
        training: recordings to fit.
        held_out: recordings to judge by; if empty, the last quarter of each training recording.
        settings: the branch `gap` of the parameters (as shipped).
        progress: is called with what is worked on.
        replay: kept kernels of the same system, to save time over many calls.

    Raises:
        OrthosisError: a recording is unfit.
    """
    settings = settings or load().gap
    with alone():
        return search(begin(system, training, held_out, settings, progress, replay), settings, progress)


def search(start: Beginning, settings: Section, progress: Progress = silent) -> Outcome:
    """Return which effects explain what a recalibrated model leaves.

    Raises:
        OrthosisError: a fit has no minimum; it says what mistake the recordings seem to have, if any.
    """
    try:
        return _compared(start, _searched(start, settings, progress), settings.replay.cross_cutoff)
    except OrthosisError as error:
        if not start.mistaken:
            raise
        mistake = next(one for one in start.remarks if one.startswith(CHECK))
        raise OrthosisError(f"{mistake} ({error})") from error


def _compared(start: Beginning, outcome: Outcome, cutoff: float) -> Outcome:
    """Return an outcome that leaves something with what recordings say of it: are some, or stamps, off?"""
    if outcome.verdict in GOOD or start.mistaken:
        return outcome
    outcome = without_doubtful_stamps(start, outcome, cutoff)
    rough = unstated_noise(outcome.selection, bool(outcome.effects)) if outcome.verdict in OPEN else []
    return replace(outcome, remarks=(*outcome.remarks, *remarks_on_contradiction(start), *rough))


def _searched(start: Beginning, settings: Section, progress: Progress) -> Outcome:
    found = select.extended(start.problem, start.null, start.held_out, settings.evidence, progress)
    start = replace(start, problem=found.problem, null=found.null)
    if start.moved:
        start, found = _on_one_clock(start, found, settings.replay.cross_cutoff)
    progress("measuring the gap on held-out recordings")
    remarks = remarks_on_agreement(found.final_problem, start.held_out, found.final)
    outcome = outcome_of(start, found, settings, [*remarks, *remarks_on_inputs(found, settings)])
    if outcome.misled:
        bare = replace(found, final=start.null, final_problem=start.problem)
        remarks = remarks_on_agreement(start.problem, start.held_out, start.null)
        outcome = outcome_of(start, bare, settings, remarks)
    if declared := declared_otherwise(found, settings):
        return outcome.of_mistaken(declared)
    if start.against and outcome.verdict == "explained":  # what drives it is known, and leaves noise alone
        rest = [one for one in outcome.remarks if one != start.against]
        start, outcome = replace(start, mistaken=False), replace(outcome, remarks=rest)
    if start.mistaken:
        return outcome.described(None).of_mistaken(f"the recordings seem to have a mistake ({CHECK})")
    if outcome.verdict not in OPEN:
        return of_ratios(outcome, found.problem, found.null).of_skewed(start.stamps, start.skewed)
    return _left_open(start, found, outcome, progress)


def _left_open(start: Beginning, found: Selection, outcome: Outcome, progress: Progress) -> Outcome:
    """Return an outcome that leaves a gap with what can be said of that."""
    if not outcome.effects and _is_late(start, found):
        return replace(outcome.described(None), skewed=True, foreign=False)
    if outcome.foreign or (not outcome.effects and stamped_late(start.system, found.steps)):
        return outcome.described(None)
    progress("describing what is left")
    if not outcome.effects:  # surrogates explain nothing: what they hide is left too
        return _described(start, outcome, start.problem, start.null)
    told = _described(start, outcome, found.final_problem, found.final)
    return told if told.verdict != DESCRIBED else _or_without_names(start, told)


def _is_late(start: Beginning, found: Selection) -> bool:
    """Return whether stamps are clearly off, and the search has added a delay."""
    names = (name for name in found.final.effects if name not in start.system.wrong)
    added = [start.system.catalogue[name] for name in names]
    return start.skewed and any(one.late is not None or one.advance is not None for one in added)


def _described(start: Beginning, outcome: Outcome, problem: Problem, model: Fit) -> Outcome:
    """Return an outcome with what can be said of what a model leaves."""
    left = unknown(problem, start.held_out, model, outcome.floor)
    told = outcome.described(left)
    if left is not None and told.foreign and any(one.harmonics for one in left.descriptions):
        # to first order a wave may leave much of a large gap, of which the model with it leaves nothing
        bent = standing(start, replace(outcome, verdict=DESCRIBED, unknown=left))
        return _by_its_stamps(start, outcome.described(bent.unknown if bent else left))
    return _by_its_stamps(start, standing(start, told) or outcome.described(None))


def _by_its_stamps(start: Beginning, told: Outcome) -> Outcome:
    """Return an outcome without remarks on stamps where a description leaves noise alone by these."""
    if told.verdict != DESCRIBED or told.left_unknown > ALONE:
        return told
    return replace(told, remarks=[one for one in told.remarks if one not in start.stamps])


def _or_without_names(start: Beginning, told: Outcome) -> Outcome:
    """Return a description beside named effects, with a remark if one without them does nearly as much.

    Effects that resemble what is missing, and a curve of what they leave of it, are as good as one curve of
    it all.
    """
    nothing = replace(told, verdict="unexplained", effects=(), unknown=None)
    bare = _described(start, nothing, start.problem, start.null)
    if bare.verdict != DESCRIBED or bare.unknown is None:
        return told
    gap, left = bare.kept[bare.unknown.equation], bare.left_unknown
    if left - 1 > NEARLY * (gap - 1):
        return told
    names = " and ".join(one.name for one in told.effects)
    words = f"{short(told.system, bare.unknown)} alone, without {names}, leaves {left:.1f} times the noise"
    return replace(told, remarks=(*told.remarks, f"{words}: what is named may only be a part of that"))


def _on_one_clock(start: Beginning, found: Selection, cutoff: float) -> tuple[Beginning, Selection]:
    """Return what was found with the recordings' clocks moved to where a periodic effect fits best."""
    problem, model, held_out = on_one_clock(found.final_problem, found.final, start.held_out, cutoff)
    null = found.problem.on(problem.scored)
    found = replace(found, problem=null, final_problem=problem, final=model)
    remarks = (*start.remarks, *[start.moved] * is_periodic(start.system, model))
    return replace(start, problem=null, held_out=held_out, remarks=remarks), found
