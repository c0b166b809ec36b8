# SPDX-License-Identifier: Apache-2.0
"""Effects that lose their evidence when all are refitted together are dropped."""

from collections.abc import Mapping

from pam_orthosis.discrepancy.fitting.fit import Fit, fit, fit_tempered, score
from pam_orthosis.discrepancy.fitting.free import free_parameters, scales_of
from pam_orthosis.discrepancy.fitting.refit import refined_in
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search import quiet, selection
from pam_orthosis.discrepancy.search.confirmation import emptied
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress


def eliminate_weak(found: Selection, settings: Section, progress: Progress) -> None:
    """Drop effects that no longer earn their place beside the others."""
    while len(found.final.effects) > 1:
        effects = found.final.effects
        replay = found.problem.replay
        lost = replay.workers.together(
            lambda name: _loss(found, name), effects, replay, progress, "refitting without each effect"
        )
        losses = dict(zip(effects, lost, strict=True))
        found.evidence.update({name: evidence for name, (evidence, _) in losses.items()})
        weakest = _empty(found, losses) or _weakest(found, losses, settings)
        if weakest is None:
            return
        progress(f"dropped {weakest}: beside the others its evidence is {losses[weakest][0]:.0f}")
        left = losses[weakest][1]
        found.final_problem, found.final = fit_tempered(
            found.final_problem, left.effects, left.values, left.free
        )
        found.evidence.pop(weakest)
        if len(found.final.effects) == 1:  # its last evidence was that beside a dropped one
            (name,) = found.final.effects
            found.evidence[name] = _loss(found, name)[0]


def _empty(found: Selection, losses: Mapping[str, tuple[float, Fit]]) -> str | None:
    """Return the least evident of the effects that are not what their names say, if any."""
    empty = [name for name in losses if emptied(found.problem.system, name, found.final)]
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


def _loss(found: Selection, name: str) -> tuple[float, Fit]:
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
    return score(problem, without) - score(problem, final), without


def _counted_from(problem: Problem, final: Fit, name: str) -> Values:
    """Return a model's values with delays counted from the one that is to be taken away.

    Sensors that all are late by as much are as good as inputs that act later by as much.
    """
    catalogue = problem.system.catalogue
    size = {one: f"{one}.{catalogue[one].fitted[0].name}" for one in final.effects}
    sensors = [one for one in final.effects if catalogue[one].advance is not None]
    dead_times = [one for one in final.effects if catalogue[one].late is not None]
    if name not in sensors or not dead_times or len(sensors) < len(problem.system.channels):
        return final.values
    common = final.values[size[name]]
    earlier = {size[one]: final.values[size[one]] - common for one in sensors}
    return {**final.values, **earlier, **{size[one]: final.values[size[one]] + common for one in dead_times}}
