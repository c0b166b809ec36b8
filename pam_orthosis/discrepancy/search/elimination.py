# SPDX-License-Identifier: Apache-2.0
"""Effects that lose their evidence when all are refitted together, or have no size to tell, are dropped."""

import math
from collections.abc import Mapping

from pam_orthosis.discrepancy.fitting.fit import Fit, fit, fit_tempered, held, score
from pam_orthosis.discrepancy.fitting.free import free_parameters, scales_of
from pam_orthosis.discrepancy.fitting.refit import details_of, refined_in, without_details
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search import quiet, selection
from pam_orthosis.discrepancy.search.confirmation import emptied, is_slow, weighed
from pam_orthosis.discrepancy.search.findings import covariance, deviations, interval
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.implied import is_lag
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress

WHOLE = 0.9  # of its range: an interval as wide tells no size


def eliminate_weak(found: Selection, settings: Section, progress: Progress) -> None:
    """Drop effects that earn no place beside the others, or whose size cannot be told from none."""
    while found.final.effects:
        losses = _losses(found, progress) if len(found.final.effects) > 1 else {}
        weakest, reason = _empty(found, losses) or _weakest(found, losses, settings), ""
        if weakest is not None:
            reason = f"beside the others its evidence is {losses[weakest][0]:.0f}"
        elif (weakest := _unsized(found)) is not None:
            reason = "its size cannot be told from none"
        else:
            return
        progress(f"dropped {weakest}: {reason}")
        found.dropped.append(weakest)
        _drop(found, weakest, losses)


def make_plain(found: Selection, progress: Progress) -> None:
    """Give details that earn nothing their usual values: a fit that has found odd ones does not come back."""
    problem, system = found.final_problem, found.problem.system
    if not (refined := refined_in(system, found.final)):
        return

    def plain(name: str) -> tuple[Values, Fit]:
        weighted, model = without_details(problem, found.final, details_of(system, name))
        return weighted.weights, model

    tried = problem.replay.workers.forked(
        plain, refined, problem.replay, progress, f"trying {', '.join(refined)} without details"
    )
    judged = weighed(problem, found.final, [(problem.weighted(weights), model) for weights, model in tried])
    evidence, weighted, model = max(judged, key=lambda one: one[0])
    if evidence > 0:
        found.final_problem, found.final = weighted, model
        make_plain(found, progress)


def _losses(found: Selection, progress: Progress) -> dict[str, tuple[float, Fit]]:
    """Return the evidence of each effect beside the others, and the model without it."""
    effects, replay = found.final.effects, found.problem.replay
    lost = replay.workers.forked(
        lambda name: loss(found, name), effects, replay, progress, "refitting without each effect"
    )
    losses = dict(zip(effects, lost, strict=True))
    found.evidence.update({name: evidence for name, (evidence, _) in losses.items()})
    return losses


def _drop(found: Selection, name: str, losses: Mapping[str, tuple[float, Fit]]) -> None:
    found.evidence.pop(name)
    if not losses:
        found.final_problem, found.final = found.problem, found.null
        return
    left = losses[name][1]
    found.final_problem, found.final = fit_tempered(found.final_problem, left.effects, left.values, left.free)
    if len(found.final.effects) == 1:  # its last evidence was that beside a dropped one
        (name,) = found.final.effects
        found.evidence[name] = loss(found, name)[0]


def _unsized(found: Selection) -> str | None:
    """Return the least evident of the effects whose interval tells no size, if any.

    Its details are no reason: what a size is worth may depend on a detail that recordings do not show.
    """
    system = found.problem.system
    unsized = []
    for name in set(found.final.effects) - set(system.shapes):
        model = held(found.final, details_of(system, name))
        deviation = deviations(system, model, covariance(found.final_problem, model))
        effect = system.catalogue[name]
        if _tells_nothing(effect, *interval(model, deviation, f"{name}.{effect.fitted[0].name}")):
            unsized.append(name)
    return min(unsized, key=lambda name: found.evidence[name], default=None)


def _tells_nothing(effect: Effect, low: float, high: float) -> bool:
    """Whether an interval holds the size at which an effect vanishes, or nearly all that it may be."""
    size = effect.fitted[0]
    none = size.minimum if is_lag(effect) else size.neutral
    return (none is not None and low <= none <= high) or high - low >= WHOLE * (size.maximum - size.minimum)


def _empty(found: Selection, losses: Mapping[str, tuple[float, Fit]]) -> str | None:
    """Return the least evident of the effects that are not what their names say, if any."""
    problem, final = found.problem, found.final
    empty = [name for name in losses if emptied(problem.system, name, final) or is_slow(problem, name, final)]
    return min(empty, key=lambda name: losses[name][0], default=None)


def _weakest(found: Selection, losses: Mapping[str, tuple[float, Fit]], settings: Section) -> str | None:
    """Return the effect to drop first, if any: too little evidence, and none where larger ones are silent."""
    weak = {
        name: evidence / selection.threshold(found, name, settings) for name, (evidence, _) in losses.items()
    }
    for name in sorted((one for one in weak if weak[one] < 1), key=lambda one: weak[one]):
        if not _seen_in_silence(found, name, *losses[name], settings):
            return name
    return None


def _seen_in_silence(found: Selection, name: str, evidence: float, without: Fit, settings: Section) -> bool:
    """Whether an effect that larger ones would have dropped shows where they are silent."""
    large = selection.larger(found, name, settings)
    if not large or evidence < selection.least(found, name, settings) or name in found.problem.system.shapes:
        return False
    shown = quiet.evidence(found.final_problem, without, [name], large).get(name, 0.0)
    if shown < settings.threshold:
        return False
    found.apart[name] = large
    return True


def loss(found: Selection, name: str) -> tuple[float, Fit]:
    """Return the evidence of an effect beside the others, and the model without it.

    Where that model goes astray the evidence is the one with which the effect was added.
    """
    problem, final = found.final_problem, found.final
    system = problem.system
    effects = tuple(other for other in final.effects if other != name)
    refined = [other for other in refined_in(system, final) if other != name]
    scales = {**scales_of(system, final.free), **({name: 1.0} if name in system.shapes else {})}
    free = free_parameters(system, effects, refined, scales)
    gone = f"{name}." if name not in system.shapes else "\n"
    values = _counted_from(problem, final, name)
    values = {key: value for key, value in values.items() if not key.startswith(gone)}
    # at the weights of the full model, but not to the end: a wrong model has no good fit
    without = fit(problem, effects, values, free, most=3)
    evidence = score(problem, without) - score(problem, final)
    return (evidence if math.isfinite(evidence) else found.entered[name]), without


def _counted_from(problem: Problem, final: Fit, name: str) -> Values:
    """Return a model's values with delays counted from the one that is to be taken away.

    Sensors that all are late by as much are as good as inputs that act later by as much.
    """
    catalogue = problem.system.catalogue
    size = {one: f"{one}.{catalogue[one].fitted[0].name}" for one in final.effects}
    sensors = [one for one in final.effects if catalogue[one].advance is not None]
    dead_times = [one for one in final.effects if catalogue[one].is_dead_time]
    if name not in sensors or not dead_times or len(sensors) < len(problem.system.channels):
        return final.values
    common = final.values[size[name]]
    earlier = {size[one]: final.values[size[one]] - common for one in sensors}
    return {**final.values, **earlier, **{size[one]: final.values[size[one]] + common for one in dead_times}}
