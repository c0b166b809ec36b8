# SPDX-License-Identifier: Apache-2.0
"""Selection: effects are added one by one while recordings say so, refitted together, and dropped again."""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.candidates import Candidate, twins
from pam_orthosis.discrepancy.fitting.fit import Fit, fit, score
from pam_orthosis.discrepancy.fitting.free import scales_of
from pam_orthosis.discrepancy.fitting.projection import Projection, RanAway
from pam_orthosis.discrepancy.fitting.refit import (
    at_best_level,
    better,
    fitted_with,
    refined,
    refitted,
    with_details,
)
from pam_orthosis.discrepancy.fitting.unbiased import unbiased
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.whitening import stated
from pam_orthosis.discrepancy.search import selection
from pam_orthosis.discrepancy.search.acceptance import accepted
from pam_orthosis.discrepancy.search.confirmation import leaves_noise_alone, ranking, weighed
from pam_orthosis.discrepancy.search.delays import or_for_delays
from pam_orthosis.discrepancy.search.elimination import eliminate_weak, make_plain
from pam_orthosis.discrepancy.search.exchange import exchanged
from pam_orthosis.discrepancy.search.screening import (
    fitted_candidates,
    is_far,
    promising,
    shapes_astray,
    strained,
    worth_polishing,
)
from pam_orthosis.discrepancy.search.second_chance import (
    or_for_both,
    or_for_details,
    or_in_any_form,
    or_in_silence,
)
from pam_orthosis.discrepancy.search.selection import Ranking, Selection, Step
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress, silent

Judged = tuple[float, Problem, Fit]  # evidence, weighted problem and fit of a model

BETTER = 0.3  # of a candidate's evidence, that the model without it gains from where the candidate's fit went
TRIED = 3  # effects of a round, the most evident ones, that held-out recordings are asked about


def extended(
    problem: Problem, base: Fit, held_out: Problem, settings: Section, progress: Progress = silent
) -> Selection:
    """Return what the search adds to a recalibrated model, with the fit of all effects together.

    Args:
        problem: training recordings.
        base: the model.
        held_out: recordings that accept or refuse an effect, never fitted.
        settings: `gap.evidence`.
        progress: is called with what is worked on.
    """
    if (nominal := _with_noise_alone(problem, base, held_out)) is not None:
        return Selection(problem, nominal, problem, nominal)
    found = Selection(problem, base, problem, base, present=_earned(problem, base, progress))
    while len(known := found.final.effects) < settings.effects:
        try:
            step = _round(found, held_out, settings, progress)
        except RanAway:
            break
        if step.blocked:
            step = or_in_silence(found, held_out, step, settings, progress)
        if step.blocked:
            step = or_in_any_form(found, held_out, step, settings, progress)
        if step.accepted is None:
            step = or_for_details(found, held_out, step, settings, progress)
        if step.accepted is None:
            step = or_for_both(found, held_out, step, settings, progress)
        if step.accepted is None:
            step = or_for_delays(found, held_out, step, settings, progress)
        if not _added(found, step, progress):
            break
        if step.apart and len(found.final.effects) < settings.effects:
            _added(found, _beside(found, held_out, step, step.apart, settings), progress)
        if (other := exchanged(found, known, held_out, settings, progress)) is not None:
            _added(found, other, progress)
    make_plain(found, progress)
    eliminate_weak(found, settings, progress)
    alone = found.final is found.null
    found.final = refit.estimated(problem.system, unbiased(found.final_problem, found.final))
    found.null = found.final if alone else found.null
    return found


def _with_noise_alone(problem: Problem, base: Fit, held_out: Problem) -> Fit | None:
    """Return the model as it is stated, where that leaves noise alone, and inputs are read with noise.

    That noise would be fitted by parameters, and by what filters it, though nothing is missing.
    """
    nominal = replace(base, values={**base.values, **{one.name: one.centre for one in base.free}})
    alone = stated(problem.system) and all(leaves_noise_alone(one, nominal) for one in (problem, held_out))
    return nominal if alone else None


def _added(found: Selection, step: Step, progress: Progress) -> bool:
    """Note a step, add what it accepted to the model, and return whether it did."""
    found.steps.append(step)
    if step.accepted is None or step.problem is None or step.fit is None:
        return False
    progress(f"added {step.accepted} (evidence {step.evidence:.0f}, held-out t {step.held_out_t:.1f})")
    for name in set(found.evidence) - set(step.fit.effects):
        found.forget(name)
    for name in set(step.fit.effects) - set(found.evidence):
        found.evidence[name] = found.entered[name] = step.evidence
        found.alike[name], found.fitted[name] = _alike(step), _fitted(step)
    found.final_problem, found.final = at_best_level(
        *with_details(step.problem, step.fit, found.final, progress)
    )
    return True


def _beside(found: Selection, held_out: Problem, last: Step, candidate: Candidate, settings: Section) -> Step:
    """Return the step with a candidate of other equations than those of what the same round accepted.

    What was accepted changes nothing there: no other round is needed to find it.
    """
    problem, base = found.final_problem, found.final
    own = {key: value for key, value in candidate.values.items() if key not in base.values}
    moved = replace(candidate, values={**base.values, **own}, scales=scales_of(problem.system, base.free))
    judged = weighed(problem, base, [refitted(problem, base, moved, silent)])
    able = [one for one in judged if one[0] >= selection.threshold(found, candidate.name, settings)]
    ranked = ranking(judged, ())
    if not able:
        return Step(None, None, None, judged[0][0], 0.0, ranked, f"{candidate.name} has too little evidence")
    touched = problem.replay.touched
    gains = {name: gain for name, gain in last.gains.items() if touched(name) & touched(candidate.name)}
    return accepted(problem, base, held_out, able, ranked, gains)


def _apart(problem: Problem, model: Fit, worth: Sequence[Candidate], judged: Ranking) -> Candidate | None:
    """Return the best candidate of equations that neither a model's last effect nor a better one changes."""
    able, taken = {one.name: one for one in worth}, _changed(problem, model.effects[-1])
    for name, _ in judged:
        if name in able and not taken & _changed(problem, name):
            return able[name]
        taken |= _changed(problem, name)
    return None


def _changed(problem: Problem, name: str) -> frozenset[str]:
    """Return the equations that an effect changes; a sensor that lags moves what the others are driven by."""
    lags = problem.system.catalogue[name].advance is not None
    return frozenset(problem.weights) if lags else problem.replay.touched(name)


def _earned(problem: Problem, base: Fit, progress: Progress) -> dict[str, tuple[float, frozenset[str]]]:
    """Return what each effect that the model has already earns in these recordings, and where.

    A model that an earlier search has found keeps what it knew: beside a large effect a small one needs more.
    """
    earned = {}
    for name in problem.system.simpler:
        progress(f"looking at what {name}, which the model has, explains here")
        replay = Replay(problem.system.without_effect(name), problem.replay.workers)
        simpler = Problem(replay, problem.scored).weighted(problem.weights)
        # as in `elimination.loss`
        known = replay.defaults(())
        values = known | {key: value for key, value in base.values.items() if key in known}
        without = fit(simpler, (), values, [one for one in base.free if one.name in known], most=3)
        earned[name] = score(simpler, without) - score(problem, base), replay.touched(name)
    return earned


def _alike(step: Step) -> dict[str, float]:
    """Return by how much of what an effect has gained the other candidates would have."""
    own = step.gains[str(step.accepted)]
    return {name: gain / own for name, gain in step.gains.items()}


def _fitted(step: Step) -> dict[str, float]:
    """Return which share of the evidence of what was accepted the other candidates had."""
    known = dict(step.ranked)
    own = max(known.get(str(step.accepted), 0.0), step.evidence)
    return {name: max(evidence, 0.0) / own for name, evidence in known.items()}


def short_of(name: str, evidence: float, threshold: float) -> str:
    """Return why the best effect is not accepted: its evidence is too little, or none."""
    has = f"evidence {evidence:.0f}" if evidence > 0 else "no evidence"
    return f"{name} has {has}, it would need {threshold:.0f}"


def _round(found: Selection, held_out: Problem, settings: Section, progress: Progress) -> Step:
    """Return the step with the best effect beside what was found.

    Far off, shape corrections go astray for what is missing; what they hid shows without them.
    """
    step = _seen_from((found.final_problem, found.final), found, held_out, settings, progress)
    if not is_far(step.problem or found.final_problem) or not shapes_astray(
        found.problem.system, found.final
    ):
        return step
    around = refit.unshaped(found.final_problem, found.final, progress)
    other = _seen_from(around, found, held_out, settings, progress, patient=step.accepted is None)
    return _better(found, step, other)


def _better(found: Selection, one: Step, other: Step) -> Step:
    """Return the step whose effect has more evidence, at common weights; the first where neither has one."""
    models = [(step.problem, step.fit) for step in (one, other) if step.problem and step.fit]
    if len(models) < 2:
        return other if other.fit else one
    first, second = (evidence for evidence, *_ in weighed(found.final_problem, found.final, models))
    return one if first >= second else other


def _seen_from(
    around: tuple[Problem, Fit],
    found: Selection,
    held_out: Problem,
    settings: Section,
    progress: Progress,
    patient: bool = True,
) -> Step:
    """Return the step with the best effect as seen from a model, judged beside what was found.

    `patient`: it goes on to what promises less where the best candidates do not keep their promise.
    """
    near, start = around
    problem, base = found.final_problem, found.final
    if found.evidence or found.present:  # the thresholds ask which equations each effect changes
        problem.replay.touching(problem.system.catalogue, progress)
    thresholds = {name: selection.threshold(found, name, settings) for name in problem.system.catalogue}
    fitted, gains = fitted_candidates(near, start, settings.screened, thresholds, progress)
    if not fitted:
        blocked = selection.blocked(found, thresholds, gains, (), settings)
        return Step(None, None, None, 0.0, 0.0, (), "no effect gains anything", gains, tuple(blocked))
    worth = worth_polishing(near, fitted, thresholds)
    judged = _judged(problem, base, around, worth, progress)
    while patient and not _able(judged, thresholds) and (others := promising(fitted, worth, thresholds)):
        # a projection is worth little far off: what promised more was not there
        worth += others
        judged += _judged(problem, base, around, others, progress)
    judged.sort(key=lambda item: -item[0])
    ranked = ranking(judged, fitted)
    blocked = selection.blocked(found, thresholds, gains, ranked, settings)
    able = _able(judged, thresholds)
    if not able:
        name, evidence = ranked[0]
        reason = short_of(name, evidence, thresholds[name])
        return Step(None, None, None, evidence, 0.0, ranked, reason, gains, tuple(blocked))
    if _better_base(found, able[0], progress):
        return _round(found, held_out, settings, progress)
    step = accepted(problem, base, held_out, able[:TRIED], ranked, gains, tuple(blocked))
    if step.problem is None or step.fit is None:
        return step
    if step.fit is not able[0][2] and _better_base(found, (step.evidence, step.problem, step.fit), progress):
        return _round(found, held_out, settings, progress)
    rivals = tuple(name for name, promised in blocked.items() if promised > step.evidence)
    enough = [one for one in worth if one.name in {model.effects[-1] for _, _, model in able}]
    return replace(step, blocked=rivals, apart=_apart(problem, step.fit, enough, ranked))


def _able(judged: Sequence[Judged], thresholds: Values) -> list[Judged]:
    """Return the models whose last effect has the evidence that is asked of it."""
    return [one for one in judged if one[0] >= thresholds[one[2].effects[-1]]]


def _judged(
    problem: Problem,
    base: Fit,
    around: tuple[Problem, Fit],
    worth: Sequence[Candidate],
    progress: Progress,
) -> list[Judged]:
    """Return the models with some candidates as seen from a model, most evident first, beside a base.

    Where the best one strains tolerances, what it is at another actuator is tried too.
    """
    models = _refitted_all(*around, worth, progress)
    best = max(weighed(problem, base, models), key=lambda item: item[0], default=None)
    others = twins(Projection(*around), best[2]) if best and strained(best[2]) else []
    models += _refitted_all(*around, others, progress) if others else []
    found: dict[str, Judged] = {}
    for item in sorted(weighed(problem, base, models), key=lambda item: -item[0]):
        found.setdefault(item[2].effects[-1], item)
    return list(found.values())


def _better_base(found: Selection, best: Judged, progress: Progress) -> bool:
    """Return whether the model so far does much better from where the best candidate's fit went; take it.

    Else a fit that had not come to its end would give the candidate the credit for what parameters do.
    """
    evidence, _, model = best
    if model.effects[-1] in found.problem.system.shapes:
        return False
    problem, base = refit.without_last(found.final_problem, found.final, model, progress)
    gained, *_ = weighed(found.final_problem, found.final, [(problem, base)])[0]
    if gained < BETTER * evidence:
        return False
    if found.final is found.null:
        found.problem, found.null = problem, base
    found.final_problem, found.final = problem, base
    return True


def _refitted_all(
    problem: Problem, base: Fit, worth: Sequence[Candidate], progress: Progress
) -> list[tuple[Problem, Fit]]:
    """Return the model with each of some candidates: see `refitted`.

    Shape corrections that went astray for what was missing can hold a fit fast: it starts anew without.
    """
    unnamed = set(problem.system.shapes) - set(base.effects)
    plain = {key: 0.0 for key in base.values if key.partition(".")[0] in unnamed}

    def one(candidate: Candidate) -> tuple[Values, Fit]:
        weighted, model = fitted_with(problem, base, candidate)
        unshaped = replace(candidate, values={**candidate.values, **plain})
        if unshaped != candidate and is_far(weighted) and shapes_astray(problem.system, model):
            weighted, model = better(problem, [(weighted, model), fitted_with(problem, base, unshaped)])
        weighted, model = refined(weighted, model, base, candidate.name, silent)
        return weighted.weights, model

    names = ", ".join(candidate.name for candidate in worth)
    found = problem.replay.workers.forked(
        one, worth, problem.replay, progress, f"refitting everything with {names}"
    )
    return [(problem.weighted(weights), model) for weights, model in found]
