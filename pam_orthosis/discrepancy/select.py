# SPDX-License-Identifier: Apache-2.0
"""Selection: effects are added one by one while recordings say so, refitted together, and dropped again."""

from __future__ import annotations

import numpy as np

from pam_orthosis.discrepancy import quiet, selection
from pam_orthosis.discrepancy.candidates import (
    Candidate,
    Projection,
    Trial,
    candidate,
    secant_gain,
    widened_shape,
)
from pam_orthosis.discrepancy.fit import (
    Fit,
    Problem,
    fit,
    fit_tempered,
    free_parameters,
    ordinary,
    prior_cost,
    scales_of,
    score,
    with_scales,
)
from pam_orthosis.discrepancy.replay import Replay
from pam_orthosis.discrepancy.selection import Selection, Step
from pam_orthosis.discrepancy.together import together
from pam_orthosis.progress import Progress, silent

ASKED_IN_SILENCE = 3
LEFT_OVER = 1.3  # power density over noise that an effect leaves: its details are refined
LEAST_SCREEN = 6.0  # gain of a score test below which a fit is not worth its time
LEAST_OF_BAR = 0.15  # the same, of the evidence that is asked for
LEAST_SHARE = 0.02  # the same, of the best candidate's gain
POLISHED = 3
POLISHED_SHARE = 0.4  # of the best projected gain: worth a full fit
NEAR_BAR = 0.3  # of the evidence that is asked for: a projection may be that far off
SLACK = 20.0  # the same where little is asked for
SECOND_START = 0.3  # of the best start's gain: a second start is tried
BLOCK = 1.0  # s, of paired differences on held-out recordings
LEAST_T = 3.0  # of these differences
LEAST_TRANSFER = 0.3  # of the training's fall, where one block holds most of it
LEAST_FALL = 1.0  # in training, a block: below it there is nothing to compare
WORST_T = -3.0  # an effect known by its broken tolerance alone must not make held-out data worse
REFIT_NULL = 10.0  # the smaller model is refitted with the larger one's weights below this ratio


def search(
    problem: Problem,
    held_out: Problem,
    settings,
    tell: Progress = silent,
    present: tuple[str, ...] = (),
) -> Selection:
    """Return the effects that recordings ask for, with the fit of all of them together.

    Args:
        problem: training recordings.
        held_out: recordings that accept or refuse an effect, never fitted.
        settings: `gap.evidence`.
        present: effects to start from.
    """
    return extended(*recalibrated(problem, tell, present), held_out, settings, tell)


def recalibrated(
    problem: Problem, tell: Progress = silent, present: tuple[str, ...] = ()
) -> tuple[Problem, Fit]:
    """Return the weighted problem and the model with its ordinary parameters fitted within tolerances."""
    free = free_parameters(problem.system, present)
    tell("recalibrating the nuisance parameters within their tolerances")
    start = problem.replay.defaults(present)
    fits = [fit_tempered(problem, present, one, free) for one in (start, *_from_simpler(problem, start))]
    return _levelled(*_better(problem, fits))


def _from_simpler(problem: Problem, start) -> list[dict[str, float]]:
    """Return where the ordinary parameters lie for the model without the effects that it has already.

    Friction makes a model stick: from parameters that are off it may not find back.
    """
    if not problem.system.simpler:
        return []
    bare = Problem(Replay(problem.system.bare()), problem.scored)
    _, fitted = fit_tempered(bare, (), bare.replay.defaults(()), ordinary(bare.system))
    return [start | {key: value for key, value in fitted.values.items() if key in start}]


def _better(problem: Problem, fits: list[tuple[Problem, Fit]]) -> tuple[Problem, Fit]:
    """Return the fit with the better score at common weights, with its own."""
    common = problem.weighted(
        {name: max(weighted.weights[name] for weighted, _ in fits) for name in problem.weights}
    )
    return min(fits, key=lambda one: score(common, one[1])) if len(fits) > 1 else fits[0]


def extended(problem: Problem, base: Fit, held_out: Problem, settings, tell: Progress = silent) -> Selection:
    """Return what the search adds to a recalibrated model; arguments as for `search`."""
    found = Selection(problem, base, problem, base, present=_earned(problem, base, tell))
    while len(found.final.effects) < settings.effects:
        step = _round(found, held_out, settings, tell)
        found.steps.append(step)
        if step.accepted is None and step.blocked:
            step = _round_in_silence(found, held_out, step, settings, tell)
            found.steps.append(step)
        if step.accepted is None:
            break
        tell(f"added {step.accepted} (evidence {step.evidence:.0f}, held-out t {step.held_out_t:.1f})")
        found.final_problem, found.final = _levelled(*_detailed(step.problem, step.fit, tell))
        found.evidence[step.accepted] = found.entered[step.accepted] = step.evidence
        found.alike[step.accepted] = _alike(step)
    _eliminate(found, settings, tell)
    return found


def _details(system, effects) -> list[str]:
    """Return the effects that have details to refine."""
    return [name for name in effects if any(not q.fitted for q in system.catalogue[name].parameters)]


def _detailed(problem: Problem, model: Fit, tell) -> tuple[Problem, Fit]:
    """Return the model with the details of its effects free, if these earn it.

    What an effect's own form leaves over must not be named as another effect.
    """
    details = _details(problem.system, model.effects)
    free = free_parameters(problem.system, model.effects, details, scales_of(problem.system, model.free))
    if len(free) == len(model.free):
        return problem, model
    tell(f"refining {', '.join(details)}")
    weighted, refined = fit_tempered(problem, model.effects, model.values, free)
    common = problem.weighted({name: max(w, weighted.weights[name]) for name, w in problem.weights.items()})
    better = score(common, refined) < score(common, model)
    return (weighted, refined) if better else (problem, model)


def _levelled(problem: Problem, model: Fit) -> tuple[Problem, Fit]:
    """Return the model refitted with the most likely level of the shape corrections' priors."""
    projection = Projection(problem, model)
    level = projection.best(*projection.state({}))[1]
    if level.scales == scales_of(problem.system, model.free):
        return problem, model
    free = with_scales(problem.system, model.free, level.scales)
    return fit_tempered(problem, model.effects, model.values, free)


def _earned(problem: Problem, base: Fit, tell) -> dict[str, tuple[float, frozenset[str]]]:
    """Return what each effect that the model has already earns in these recordings, and where.

    A model that an earlier search has found keeps what it knew: beside a large effect a small one needs more.
    """
    earned = {}
    for name in problem.system.simpler:
        tell(f"looking at what {name}, which the model has, explains here")
        replay = Replay(problem.system.lacking_effect(name))
        simpler = Problem(replay, problem.scored).weighted(problem.weights)
        # as in `_loss`
        known = replay.defaults(())
        values = known | {key: value for key, value in base.values.items() if key in known}
        without = fit(simpler, (), values, [one for one in base.free if one.name in known], most=3)
        earned[name] = score(simpler, without) - score(problem, base), replay.touched(name)
    return earned


def _alike(step: Step) -> dict[str, float]:
    """Return by how much of what an effect has gained the other candidates would have."""
    return {name: gain / step.gains[step.accepted] for name, gain in step.gains.items()}


def _round(found: Selection, held_out: Problem, settings, tell) -> Step:
    problem, base = found.final_problem, found.final
    bars = {name: selection.bar(found, name, settings) for name in problem.system.catalogue}
    ranked, gains = fitted_candidates(problem, base, settings.screened, bars, tell)
    if not ranked:
        blocked = selection.blocked(found, bars, gains, (), settings)
        return Step(None, None, None, 0.0, 0.0, (), "no effect gains anything", gains, blocked)
    worth = _worth_polishing(problem, ranked, bars)
    models = together(lambda one: _polished(problem, base, one, tell), worth)
    judged = sorted(_judged(problem, base, models), key=lambda item: -item[0])
    told = _told(judged, ranked)
    blocked = selection.blocked(found, bars, gains, told, settings)
    able = [one for one in judged if one[0] >= bars[one[2].effects[-1]]]
    if not able:
        name, evidence = told[0]
        reason = f"{name} has evidence {evidence:.0f}, it would need {bars[name]:.0f}"
        return Step(None, None, None, evidence, 0.0, told, reason, gains, blocked)
    return _accepted(problem, base, held_out, able[:2], told, gains, blocked)


def _accepted(problem: Problem, base: Fit, held_out: Problem, able, told, gains, blocked=()) -> Step:
    """Return the step with the first of some models that held-out recordings confirm, or why none is.

    What is refused is the first one: its evidence, its t value and the reason belong together.
    """
    refused = []
    for evidence, weighted, model in able:
        name = model.effects[-1]
        t, transfer = confirmed(
            problem.weighted(weighted.weights), held_out.weighted(weighted.weights), base, model
        )
        strained = not _visible(problem, base, model)
        if _too_small(problem.system, name, model):
            reason = f"{name} is smaller than what is worth a name"
        elif t > LEAST_T or transfer > LEAST_TRANSFER or (strained and t > WORST_T):
            return Step(name, model, weighted, evidence, t, told, "accepted", gains)
        else:
            reason = f"held-out recordings do not confirm {name}"
        refused.append(Step(None, None, None, evidence, t, told, reason, gains, blocked))
    return refused[0]


def _round_in_silence(found: Selection, held_out: Problem, last: Step, settings, tell) -> Step:
    """Return the step with the best of the effects that only larger ones kept from being added.

    It needs its evidence where these are silent.
    """
    problem, base = found.final_problem, found.final
    seen = {}
    for large, names in _by_larger(found, last.blocked[:ASKED_IN_SILENCE], settings).items():
        tell(f"looking for {', '.join(names)} where {', '.join(sorted(large))} is inactive")
        seen |= quiet.evidence(problem, base, names, large)
    told = tuple(sorted(seen.items(), key=lambda one: -one[1]))
    if not told or told[0][1] < settings.threshold:
        return Step(None, None, None, 0.0, 0.0, told, "nothing shows where the larger effects are silent")
    name = told[0][0]
    model = _polished(problem, base, quiet.beside(Projection(problem, base), name), tell)
    able = [
        one for one in _judged(problem, base, [model]) if one[0] >= selection.least(found, name, settings)
    ]
    if not able:
        return Step(None, None, None, told[0][1], 0.0, told, f"{name} has too little evidence in all samples")
    step = _accepted(problem, base, held_out, able, told, last.gains)
    if step.accepted:
        found.apart[name] = selection.larger(found, name, settings)
    return step


def _by_larger(found: Selection, names, settings) -> dict[frozenset[str], list[str]]:
    """Return effects by the larger ones that kept them from being added."""
    groups: dict[frozenset[str], list[str]] = {}
    for name in names:
        groups.setdefault(frozenset(selection.larger(found, name, settings)), []).append(name)
    return groups


def fitted_candidates(
    problem: Problem, base: Fit, most: int, bars, tell
) -> tuple[list[Candidate], dict[str, float]]:
    """Return the candidates that a score test lets through, fitted, best evidence first, and all gains.

    `bars` is the evidence that each effect needs; one whose score is far below is not fitted.
    """
    projection = Projection(problem, base)
    touched = problem.replay.touched
    names = [name for name in problem.system.candidates if name not in base.effects and touched(name)]
    shapes = [name for name in problem.system.shapes if name not in base.effects and touched(name)]

    def screen(name):
        trial = Trial(projection, name)
        starts = trial.starts()
        gains = [secant_gain(projection, trial, start) for start in starts]
        order = np.argsort(gains)[::-1][:2]
        kept = [starts[i] for i in order if gains[i] >= SECOND_START * gains[order[0]]]
        return gains[order[0]], trial, kept

    screened = sorted(together(screen, names, tell, "screening effects"), key=lambda item: -item[0])
    least = max(LEAST_SCREEN, LEAST_SHARE * screened[0][0])
    kept = [
        (gain, trial, starts)
        for gain, trial, starts in screened[:most]
        if gain > least and gain * _room(problem, trial.name) > LEAST_OF_BAR * bars[trial.name]
    ]
    found = together(
        lambda item: candidate(projection, item[1], item[2], item[0]), kept, tell, "fitting candidates"
    )
    found += [widened_shape(projection, name) for name in shapes]
    gains = {trial.name: gain for gain, trial, _ in screened} | {one.name: one.gain for one in found}
    return sorted((one for one in found if one.gain > least), key=lambda one: -one.evidence), gains


def _room(problem: Problem, name: str) -> float:
    """Return by how much the gain of an effect may grow: a model that lacks much weighs residuals less."""
    return max(1 / problem.weights[equation] ** 2 for equation in problem.replay.touched(name))


def _worth_polishing(problem: Problem, ranked: list[Candidate], bars) -> list[Candidate]:
    """Return the candidates that a full fit may lift over what is asked of them."""
    near = [
        one
        for one in ranked
        if one.gain * _room(problem, one.name) - (one.gain - one.evidence)
        > min(NEAR_BAR * bars[one.name], bars[one.name] - SLACK)
    ]
    return [one for one in near[:POLISHED] if one.gain > POLISHED_SHARE * near[0].gain]


def _polished(problem: Problem, base: Fit, one: Candidate, tell) -> tuple[Problem, Fit]:
    tell(f"refitting everything with {one.name}")
    effects = (*base.effects, one.name)
    free = free_parameters(problem.system, effects, _refined_in(problem.system, base), one.scales)
    weighted, model = fit_tempered(problem, effects, one.values, free)
    left = max(1 / weighted.weights[name] ** 2 for name in problem.replay.touched(one.name))
    return _detailed(weighted, model, tell) if left > LEFT_OVER else (weighted, model)


def _refined_in(system, model: Fit) -> list[str]:
    """Return the effects whose details are free in a model."""
    known = {one.name for one in model.free}
    return [
        name
        for name in _details(system, model.effects)
        if any(f"{name}.{q.name}" in known for q in system.catalogue[name].parameters if not q.fitted)
    ]


def _judged(problem: Problem, base: Fit, models) -> list[tuple[float, Problem, Fit]]:
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


def _told(judged, ranked) -> tuple[tuple[str, float], ...]:
    full = [(model.effects[-1], evidence) for evidence, _, model in judged]
    rest = [(one.name, one.evidence) for one in ranked if one.name not in dict(full)]
    return (*full, *rest)


def confirmed(training: Problem, held_out: Problem, smaller: Fit, larger: Fit) -> tuple[float, float]:
    """Return how recordings that were not fitted see a larger model.

    Two figures, since blocks of time are few and one may hold most of the gap: the t value of the fall
    of squared residuals over blocks, and the fall a sample over that in training.
    """
    unseen, seen = (_falls(problem, smaller, larger) for problem in (held_out, training))
    # one block tells nothing of its own spread
    spread = unseen.std(ddof=1) / np.sqrt(len(unseen)) if len(unseen) > 1 else np.inf
    t = float(unseen.mean() / max(spread, 1e-12))
    return t, float(unseen.mean() / seen.mean()) if seen.mean() > LEAST_FALL else 0.0


def _falls(problem: Problem, smaller: Fit, larger: Fit) -> np.ndarray:
    """Return by how much squared residuals fall, block by block."""
    falls = []
    for equation in problem.system.equations:
        before = problem.residual(equation, smaller.effects, smaller.values)
        after = problem.residual(equation, larger.effects, larger.values)
        falls.append(_block_sums(problem, equation, before**2 - after**2))
    return np.sum(falls, axis=0)


def _block_sums(problem: Problem, equation, values: np.ndarray) -> np.ndarray:
    """Return sums over blocks of time, the equation's channels added."""
    sums = []
    for one, part in problem.by_run(equation, values):
        size = round(BLOCK / one.run.period)
        whole = one.samples // size * size
        sums.append(part.sum(axis=0)[:whole].reshape(-1, size).sum(axis=1))
    return np.concatenate(sums)


def _visible(problem: Problem, base: Fit, model: Fit) -> bool:
    """Whether the effect removes a visible misfit, not only a strain on the tolerances."""
    fall = sum(float(np.sum(b.residual**2)) for b in base.blocks.values())
    fall -= problem.total(model.effects, model.values)
    return fall > prior_cost(base.free, base.values) - prior_cost(model.free, model.values)


def _too_small(system, name: str, model: Fit) -> bool:
    effect = system.catalogue[name]
    size = effect.fitted[0]
    if effect.shape:
        return False
    if size.neutral is None:
        return False
    return abs(model.values[f"{name}.{size.name}"] - size.neutral) < effect.minimum_effect


def _eliminate(found: Selection, settings, tell) -> None:
    """Drop effects that no longer earn their place beside the others."""
    while len(found.final.effects) > 1:
        effects = found.final.effects
        lost = together(lambda name: _loss(found, name), effects, tell, "refitting without each effect")
        losses = dict(zip(effects, lost, strict=True))
        found.evidence.update({name: evidence for name, (evidence, _) in losses.items()})
        weakest = _weakest(found, losses, settings)
        if weakest is None:
            return
        tell(f"dropped {weakest}: beside the others its evidence is {losses[weakest][0]:.0f}")
        left = losses[weakest][1]
        found.final_problem, found.final = fit_tempered(
            found.final_problem, left.effects, left.values, left.free
        )
        found.evidence.pop(weakest)
        if len(found.final.effects) == 1:
            _revalue(found)


def _revalue(found: Selection) -> None:
    """Give the only effect that is left its evidence anew: the last was that beside a dropped one."""
    name = found.final.effects[0]
    found.evidence[name] = _loss(found, name)[0]


def _weakest(found: Selection, losses, settings) -> str | None:
    """Return the effect to drop first, if any: too little evidence, and none where larger ones are silent."""
    weak = {name: evidence / selection.bar(found, name, settings) for name, (evidence, _) in losses.items()}
    for name in sorted((one for one in weak if weak[one] < 1), key=weak.get):
        if not _seen_in_silence(found, name, *losses[name], settings):
            return name
    return None


def _seen_in_silence(found: Selection, name: str, evidence: float, without: Fit, settings) -> bool:
    """Whether an effect that larger ones would have dropped shows where they are silent."""
    large = selection.larger(found, name, settings)
    if not large or evidence < selection.least(found, name, settings) or name in found.problem.system.shapes:
        return False
    seen = quiet.evidence(found.final_problem, without, [name], large).get(name, 0.0) >= settings.threshold
    if seen:
        found.apart[name] = large
    return seen


def _loss(found: Selection, name: str) -> tuple[float, Fit]:
    problem, final = found.final_problem, found.final
    system = problem.system
    effects = tuple(other for other in final.effects if other != name)
    refined = [other for other in _refined_in(system, final) if other != name]
    scales = {**scales_of(system, final.free), **({name: 1.0} if name in system.shapes else {})}
    free = free_parameters(system, effects, refined, scales)
    gone = f"{name}." if name not in system.shapes else "\n"
    values = {key: value for key, value in final.values.items() if not key.startswith(gone)}
    # at the weights of the full model, but not to the end: a wrong model has no good fit
    without = fit(problem, effects, values, free, most=3)
    return score(problem, without) - score(problem, final), without
