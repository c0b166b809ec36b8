# SPDX-License-Identifier: Apache-2.0
"""Selection: effects are added one by one while recordings say so, refitted together, and dropped again."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from pam_orthosis.discrepancy.candidates import (
    Candidate,
    Projection,
    Trial,
    candidate,
    penalty,
    secant_gain,
    widened_shape,
)
from pam_orthosis.discrepancy.fit import Fit, Problem, fit, fit_tempered, free_parameters, prior_cost

THREADS = 2
LEAST_SCREEN = 6.0  # gain of a score test below which a fit is not worth its time
LEAST_SHARE = 0.02  # the same, of the best candidate's gain
POLISHED = 3
POLISHED_SHARE = 0.4  # of the best projected gain: worth a full fit
SECOND_START = 0.3  # of the best start's gain: a second start is tried
BLOCK = 1.0  # s, of paired differences on held-out recordings
LEAST_T = 3.0  # of these differences
WORST_T = -3.0  # an effect known by its broken tolerance alone must not make held-out data worse
REFIT_NULL = 10.0  # the smaller model is refitted with the larger one's weights below this ratio


@dataclass(frozen=True)
class Step:
    """One round: what was accepted, what came next, and all candidates that were fitted."""

    accepted: str | None
    fit: Fit | None
    problem: Problem | None
    evidence: float
    held_out_t: float
    ranked: tuple[tuple[str, float], ...]
    reason: str


@dataclass
class Selection:
    """What the search found.

    Attributes:
        problem, null: weighted problem and fit without added effects.
        final_problem, final: the same with all effects that stayed.
        steps: rounds in order.
        evidence: effect -> difference of BIC when it alone is taken away (or was added).
    """

    problem: Problem
    null: Fit
    final_problem: Problem
    final: Fit
    steps: list[Step] = field(default_factory=list)
    evidence: dict[str, float] = field(default_factory=dict)


def search(
    problem: Problem,
    held_out: Problem,
    settings,
    tell: Callable[[str], None] = lambda _: None,
    present: tuple[str, ...] = (),
) -> Selection:
    """Return the effects that recordings ask for, with the fit of all of them together.

    Args:
        problem: training recordings.
        held_out: recordings that accept or refuse an effect, never fitted.
        settings: `gap.evidence`.
        present: effects to start from.
    """
    free = free_parameters(problem.system, present)
    tell("recalibrating the ordinary parameters within their tolerances")
    problem, base = fit_tempered(problem, present, problem.replay.defaults(present), free)
    found = Selection(problem, base, problem, base)
    while len(found.final.effects) < settings.effects:
        step = _round(found.final_problem, found.final, held_out, settings, tell)
        found.steps.append(step)
        if step.accepted is None:
            break
        tell(f"added {step.accepted} (evidence {step.evidence:.0f}, held-out t {step.held_out_t:.1f})")
        found.final_problem, found.final = step.problem, step.fit
        found.evidence[step.accepted] = step.evidence
    _eliminate(found, settings, tell)
    return found


def _round(problem: Problem, base: Fit, held_out: Problem, settings, tell) -> Step:
    ranked = fitted_candidates(problem, base, settings.screened, tell)
    if not ranked:
        return Step(None, None, None, 0.0, 0.0, (), "no effect gains anything")
    models = [(*_polished(problem, base, one, tell), one.price) for one in _worth_polishing(ranked)]
    judged = sorted(_judged(problem, base, models), key=lambda item: -item[0])
    told = _told(judged, ranked)
    for evidence, weighted, model in judged[:2]:
        name = model.effects[-1]
        if evidence < settings.threshold:
            return Step(None, None, None, evidence, 0.0, told, f"{name} has evidence {evidence:.0f} only")
        t = paired_t(held_out.weighted(weighted.weights), base, model)
        visible = _misfit_share(problem, base, weighted, model)
        if _too_small(problem.system, name, model):
            continue
        if t > LEAST_T or (t > WORST_T and not visible):
            return Step(name, model, weighted, evidence, t, told, "accepted")
    return Step(None, None, None, judged[0][0], t, told, "held-out recordings do not confirm it")


def fitted_candidates(problem: Problem, base: Fit, most: int, tell) -> list[Candidate]:
    """Return the candidates that a score test lets through, fitted, best evidence first."""
    projection = Projection(problem, base)
    names = [name for name in problem.system.candidates if name not in base.effects]
    shapes = [name for name in problem.system.shapes if name not in base.effects]
    tell(f"screening {len(names)} effects")

    def screen(name):
        trial = Trial(projection, name)
        starts = trial.starts()
        gains = [secant_gain(projection, trial, start) for start in starts]
        order = np.argsort(gains)[::-1][:2]
        kept = [starts[i] for i in order if gains[i] >= SECOND_START * gains[order[0]]]
        return gains[order[0]], trial, kept

    with ThreadPoolExecutor(THREADS) as pool:
        screened = sorted(pool.map(screen, names), key=lambda item: -item[0])
    least = max(LEAST_SCREEN, LEAST_SHARE * screened[0][0])
    kept = [item for item in screened[:most] if item[0] > least]
    tell(
        f"fitting {len(kept)}: {', '.join(trial.name for _, trial, _ in kept)}"
        if kept
        else "none is worth a fit"
    )
    with ThreadPoolExecutor(THREADS) as pool:
        fitted = pool.map(lambda item: candidate(projection, item[1], item[2]), kept)
        found = [*fitted, *(widened_shape(projection, name) for name in shapes)]
    return sorted((one for one in found if one.gain > least), key=lambda one: -one.evidence)


def _worth_polishing(ranked: list[Candidate]) -> list[Candidate]:
    best = ranked[0].gain
    return [one for one in ranked[:POLISHED] if one.gain > POLISHED_SHARE * best]


def _polished(problem: Problem, base: Fit, one: Candidate, tell) -> tuple[Problem, Fit]:
    tell(f"refitting everything with {one.name}")
    effects = (*base.effects, one.name)
    return fit_tempered(problem, effects, one.values, free_parameters(problem.system, effects))


def _judged(problem: Problem, base: Fit, models) -> list[tuple[float, Problem, Fit]]:
    """Return evidence, weighted problem and fit of each model, all with the best model's weights."""
    weights = dict(problem.weights)
    for weighted, _, _ in models:
        weights = {name: max(w, weighted.weights[name]) for name, w in weights.items()}
    common = problem.weighted(weights)
    before = _cost(common, _comparable(problem, common, base))
    judged = []
    for weighted, model, price in models:
        judged.append((before - _cost(common, model) - price, weighted, model))
    return judged


def _comparable(problem: Problem, common: Problem, base: Fit) -> Fit:
    """Return the smaller model refitted with the common weights where these are not far from its own."""
    ratio = max((common.weights[name] / w) ** 2 for name, w in problem.weights.items())
    if ratio > REFIT_NULL or ratio < 1.05:
        return base
    return fit(common, base.effects, base.values, base.free, most=2)


def _cost(problem: Problem, model: Fit) -> float:
    return problem.total(model.effects, model.values) + prior_cost(model.free, model.values)


def _told(judged, ranked) -> tuple[tuple[str, float], ...]:
    full = [(model.effects[-1], evidence) for evidence, _, model in judged]
    rest = [(one.name, one.evidence) for one in ranked if one.name not in dict(full)]
    return (*full, *rest)


def paired_t(problem: Problem, smaller: Fit, larger: Fit) -> float:
    """Return the t value of the fall of squared residuals in blocks of recordings not fitted."""
    differences = []
    for equation in problem.system.equations:
        before = problem.residual(equation, smaller.effects, smaller.values)
        after = problem.residual(equation, larger.effects, larger.values)
        differences.append(_block_sums(problem, equation, before**2 - after**2))
    total = np.sum(differences, axis=0)
    spread = total.std(ddof=1) / np.sqrt(len(total))
    return float(total.mean() / max(spread, 1e-12))


def _block_sums(problem: Problem, equation, values: np.ndarray) -> np.ndarray:
    """Return sums over blocks of time, the equation's channels added."""
    sums, start = [], 0
    for one in problem.scored:
        length, size = one.run.recording.samples - one.warm_up, round(BLOCK / one.run.period)
        of_run = np.zeros(length)
        for _ in equation.channels:
            of_run += values[start : start + length]
            start += length
        whole = len(of_run) // size * size
        sums.append(of_run[:whole].reshape(-1, size).sum(axis=1))
    return np.concatenate(sums)


def _misfit_share(problem, base, weighted, model) -> bool:
    """Whether the effect removes a visible misfit (not only a strain on the tolerances)."""
    fall = sum(float(np.sum(b.residual**2)) for b in base.blocks.values())
    common = problem.total(model.effects, model.values)
    strain = prior_cost(base.free, base.values) - prior_cost(model.free, model.values)
    return fall - common > strain


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
        losses = {name: _loss(found, name) for name in found.final.effects}
        found.evidence.update({name: evidence for name, (evidence, _) in losses.items()})
        weakest = min(losses, key=lambda name: losses[name][0])
        if losses[weakest][0] >= settings.threshold:
            return
        tell(f"dropped {weakest}: beside the others its evidence is {losses[weakest][0]:.0f}")
        found.final = losses[weakest][1]
        found.evidence.pop(weakest)


def _loss(found: Selection, name: str) -> tuple[float, Fit]:
    problem, final = found.final_problem, found.final
    effects = tuple(other for other in final.effects if other != name)
    free = free_parameters(problem.system, effects)
    kept = [name] if name not in problem.system.shapes else []
    values = {key: value for key, value in final.values.items() if key.split(".")[0] not in kept}
    # at the weights of the full model, but not to the end: a wrong model has no good fit
    without = fit(problem, effects, values, free, most=3)
    return without.cost - final.cost - penalty(final, len(final.free) - len(free)), without
