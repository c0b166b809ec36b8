# SPDX-License-Identifier: Apache-2.0
"""Fits of a whole model: recalibration, an effect's details, the level of the shape corrections."""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.fitting.candidates import Candidate
from pam_orthosis.discrepancy.fitting.fit import Fit, fit_tempered, held, prior_cost, score
from pam_orthosis.discrepancy.fitting.free import free_parameters, nuisance, of_effect, scales_of, with_scales
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.systems.system import System, Values
from pam_orthosis.progress import Progress

LEFT_OVER = 1.3  # power density over noise that an effect leaves: its details are refined
LEANS = 20.0  # squared deviations over tolerances: nuisance parameters may do what an effect's details would


def recalibrated(problem: Problem, progress: Progress) -> tuple[Problem, Fit]:
    """Return the weighted problem and the model with its nuisance parameters fitted within tolerances."""
    free = nuisance(problem.system)
    progress("recalibrating the nuisance parameters within their tolerances")
    start = problem.replay.defaults(())
    fits = [fit_tempered(problem, (), one, free) for one in (start, *_from_simpler(problem, start))]
    return at_best_level(*better(problem, fits))


def _from_simpler(problem: Problem, start: Values) -> list[dict[str, float]]:
    """Return where the nuisance parameters lie for the model without the effects that it has already.

    Friction makes a model stick: from parameters that are off it may not find back.
    """
    if not problem.system.simpler:
        return []
    bare = Problem(Replay(problem.system.bare(), problem.replay.workers), problem.scored)
    _, fitted = fit_tempered(bare, (), bare.replay.defaults(()), nuisance(bare.system))
    return [{**start} | {key: value for key, value in fitted.values.items() if key in start}]


def estimated(system: System, model: Fit) -> Fit:
    """Return a model whose wrong parameters are values without a tolerance: its deviation is part of it."""
    wrong = {one.name: f"{n}.{VALUE}" for n in model.effects if (one := system.recalibrating(n))}
    moved = {key: model.values[key] + model.values[name] for name, key in wrong.items()}
    return replace(held(model, wrong), values={**model.values, **moved, **dict.fromkeys(wrong, 0.0)})


def better(problem: Problem, fits: list[tuple[Problem, Fit]]) -> tuple[Problem, Fit]:
    """Return the fit with the better score at common weights, with its own."""
    common = problem.weighted(
        {name: max(weighted.weights[name] for weighted, _ in fits) for name in problem.weights}
    )
    return min(fits, key=lambda one: score(common, one[1])) if len(fits) > 1 else fits[0]


def unshaped(problem: Problem, base: Fit, progress: Progress) -> tuple[Problem, Fit]:
    """Return the model recalibrated without shape corrections: where it is far off, these are led astray."""
    progress("looking again without shape corrections")
    known = [one for one in base.free if one.name.partition(".")[0] not in base.effects]
    plain = problem.replay.defaults(base.effects)
    start = {**base.values, **{one.name: plain[one.name] for one in known}}
    shapes = {one for one in known if one.name.partition(".")[0] in problem.system.shapes}
    return fit_tempered(problem, base.effects, start, [one for one in base.free if one not in shapes])


def without_last(problem: Problem, base: Fit, model: Fit, progress: Progress) -> tuple[Problem, Fit]:
    """Return the model refitted from where a fit with one more effect went."""
    progress(f"refitting without {model.effects[-1]}")
    start = {key: model.values[key] for key in base.values}
    free = with_scales(problem.system, base.free, scales_of(problem.system, model.free))
    return fit_tempered(problem, base.effects, start, free)


def _details(system: System, effects: Sequence[str]) -> list[str]:
    """Return the effects that have details to refine."""
    return [name for name in effects if any(not q.fitted for q in system.catalogue[name].parameters)]


def with_details(problem: Problem, model: Fit, base: Fit, progress: Progress) -> tuple[Problem, Fit]:
    """Return the model with the details of its effects free, if these earn it.

    What an effect's own form leaves over must not be named as another effect. Where nuisance parameters have
    taken it, details start beside those of a base too: from the others a fit hardly finds back.
    """
    details = _details(problem.system, model.effects)
    free = free_parameters(problem.system, model.effects, details, scales_of(problem.system, model.free))
    if len(free) == len(model.free):
        return problem, model
    progress(f"refining {', '.join(details)}")
    known = _nuisance(model)
    kept = {key: value for key, value in base.values.items() if key in known}
    starts = [model.values, {**model.values, **kept}] if _leans(model) else [model.values]
    fits = [fit_tempered(problem, model.effects, start, free) for start in starts]
    weighted, refined = better(problem, fits)
    common = problem.weighted({name: max(w, weighted.weights[name]) for name, w in problem.weights.items()})
    earned = score(common, refined) < score(common, model)
    return (weighted, refined) if earned else (problem, model)


def at_best_level(problem: Problem, model: Fit) -> tuple[Problem, Fit]:
    """Return the model refitted with the most likely level of the shape corrections' priors."""
    projection = Projection(problem, model)
    level = projection.best(*projection.state({}))[1]
    if level.scales == scales_of(problem.system, model.free):
        return problem, model
    free = with_scales(problem.system, model.free, level.scales)
    return fit_tempered(problem, model.effects, model.values, free)


def refitted(problem: Problem, base: Fit, one: Candidate, progress: Progress) -> tuple[Problem, Fit]:
    """Return the model with a candidate, all parameters fitted, its details too if it leaves much."""
    progress(f"refitting everything with {one.name}")
    return refined(*fitted_with(problem, base, one), base, one.name, progress)


def fitted_with(problem: Problem, base: Fit, one: Candidate) -> tuple[Problem, Fit]:
    """Return the model with a candidate, all parameters fitted but its details."""
    effects = (*base.effects, *one.added)
    free = free_parameters(problem.system, effects, refined_in(problem.system, base), one.scales)
    return fit_tempered(problem, effects, one.values, free)


def refined(problem: Problem, model: Fit, base: Fit, name: str, progress: Progress) -> tuple[Problem, Fit]:
    """Return a model with the details of its effects free where one leaves much, or leans on tolerances."""
    left = max(1 / problem.weights[equation] ** 2 for equation in problem.replay.touched(name))
    if left > LEFT_OVER or _leans(model):
        return with_details(problem, model, base, progress)
    return problem, model


def _leans(model: Fit) -> bool:
    """Return whether a model's nuisance parameters are far from where their tolerances hold them."""
    names = _nuisance(model)
    return prior_cost([one for one in model.free if one.name in names], model.values) > LEANS


def _nuisance(model: Fit) -> set[str]:
    """Return the free parameters of a model that belong to none of its effects."""
    return {one.name for one in model.free if one.name.partition(".")[0] not in model.effects}


def details_of(system: System, name: str) -> dict[str, float]:
    """Return the details of an effect at their typical values."""
    return {f"{name}.{q.name}": q.typical for q in system.catalogue[name].parameters if not q.fitted}


def without_details(
    problem: Problem, base: Fit, details: Values, name: str | None = None
) -> tuple[Problem, Fit]:
    """Return the model with an effect's details as they usually are, and perhaps another in their place."""
    added = (name,) if name else ()
    effects, known = (*base.effects, *added), {*base.values}
    typical = {k: v for k, v in problem.replay.defaults(effects).items() if k not in known}
    free = [one for one in base.free if one.name not in details]
    free += [one for own in added for one in of_effect(problem.system, own)]
    return fit_tempered(problem, effects, {**base.values, **details, **typical}, free)


def with_both(problem: Problem, base: Fit, details: Values, name: str) -> tuple[Problem, Fit]:
    """Return the model with an effect beside one whose details are free, from these as they usually are."""
    effects = (*base.effects, name)
    typical = {k: v for k, v in problem.replay.defaults(effects).items() if k not in base.values}
    refined = [*refined_in(problem.system, base), *_details(problem.system, [name])]
    free = free_parameters(problem.system, effects, refined, scales_of(problem.system, base.free))
    return fit_tempered(problem, effects, {**base.values, **details, **typical}, free)


def refined_in(system: System, model: Fit) -> list[str]:
    """Return the effects whose details are free in a model."""
    known = {one.name for one in model.free}
    return [
        name
        for name in _details(system, model.effects)
        if any(f"{name}.{q.name}" in known for q in system.catalogue[name].parameters if not q.fitted)
    ]
