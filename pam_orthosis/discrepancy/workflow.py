# SPDX-License-Identifier: Apache-2.0
"""The gap workflow: check, replay, find where, name, add, show."""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.answer.agreement import remarks_on_agreement
from pam_orthosis.discrepancy.answer.between import remarks_on_inputs
from pam_orthosis.discrepancy.answer.judgement import OPEN, Outcome, outcome_of
from pam_orthosis.discrepancy.answer.standing import standing
from pam_orthosis.discrepancy.preparation.beginning import Beginning, begin
from pam_orthosis.discrepancy.preparation.clocks import is_periodic, on_one_clock
from pam_orthosis.discrepancy.preparation.mistakes import CHECK
from pam_orthosis.discrepancy.recordings.data import Recording
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.search import select
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.unknown.unknown import unknown
from pam_orthosis.discrepancy.workers import alone
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Section, load
from pam_orthosis.progress import Progress, silent


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
        return _searched(start, settings, progress)
    except OrthosisError as error:
        if not start.mistaken:
            raise
        mistake = next(one for one in start.remarks if one.startswith(CHECK))
        raise OrthosisError(f"{mistake} ({error})") from error


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
    if outcome.verdict not in OPEN:
        return outcome.of_mistaken() if start.mistaken else outcome.of_skewed(start.stamps, start.skewed)
    if outcome.foreign:
        return outcome.described(None)
    progress("describing what is left")
    named = bool(outcome.effects)  # surrogates explain nothing: what they hide is left too
    model, problem = (found.final, found.final_problem) if named else (start.null, start.problem)
    told = outcome.described(unknown(problem, start.held_out, model, outcome.floor))
    return standing(start, told) or outcome.described(None)


def _on_one_clock(start: Beginning, found: Selection, cutoff: float) -> tuple[Beginning, Selection]:
    """Return what was found with the recordings' clocks moved to where a periodic effect fits best."""
    problem, model, held_out = on_one_clock(found.final_problem, found.final, start.held_out, cutoff)
    null = found.problem.on(problem.scored)
    found = replace(found, problem=null, final_problem=problem, final=model)
    remarks = (*start.remarks, *[start.moved] * is_periodic(start.system, model))
    return replace(start, problem=null, held_out=held_out, remarks=remarks), found
