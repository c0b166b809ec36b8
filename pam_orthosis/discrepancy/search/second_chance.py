# SPDX-License-Identifier: Apache-2.0
"""What larger effects kept out: asked for in their silence, beside any form, in place of details."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search import form, quiet, selection
from pam_orthosis.discrepancy.search.acceptance import accepted
from pam_orthosis.discrepancy.search.confirmation import emptied, ranking, weighed
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress

ASKED_IN_SILENCE = 3
ASKED_IN_ANY_FORM = 6
SURE = 2.0  # times the threshold: what an effect needs beside a larger one whose form is free
ALIKE = 0.5  # of an effect's gain that another one had in its place
BOTH = 2e-3  # of an effect's evidence, that one like it needs beside it and its details
CLEANER = 0.6  # of the power density that was left, with an effect in place of another's details


def or_in_silence(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with what larger effects kept from being added, where it is better; note the other."""
    other = _round_in_silence(found, held_out, step, settings, progress)
    if step.accepted and not other.accepted:
        return step
    reason = f"{other.accepted} has more evidence where larger effects are silent"
    found.steps.append(replace(step, accepted=None, reason=reason) if step.accepted else step)
    return other if other.accepted else replace(other, blocked=step.blocked)


def _round_in_silence(
    found: Selection, held_out: Problem, last: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with the best of the effects that only larger ones kept from being added.

    It needs its evidence where these are silent, and more there than what was accepted beside them.
    """
    problem, base = found.final_problem, found.final
    seen: dict[str, float] = {}
    for large, names in _by_larger(found, last.blocked[:ASKED_IN_SILENCE], settings).items():
        progress(f"looking for {', '.join(names)} where {', '.join(sorted(large))} is inactive")
        others = [last.accepted] if last.accepted else []
        shown = quiet.evidence(problem, base, [*names, *others], large)
        seen |= {name: shown[name] for name in names if shown.get(name, 0.0) > _most(shown, others)}
    ranked = tuple(sorted(seen.items(), key=lambda one: -one[1]))
    if not ranked or ranked[0][1] < settings.threshold:
        return Step(None, None, None, 0.0, 0.0, ranked, "nothing shows where the larger effects are silent")
    name = ranked[0][0]
    model = refit.refitted(problem, base, quiet.beside(Projection(problem, base), name), progress)
    able = [
        one for one in weighed(problem, base, [model]) if one[0] >= selection.least(found, name, settings)
    ]
    if not able:
        return Step(
            None, None, None, ranked[0][1], 0.0, ranked, f"{name} has too little evidence in all samples"
        )
    step = accepted(problem, base, held_out, able, ranked, last.gains)
    if step.accepted:
        found.apart[name] = selection.larger(found, name, settings)
    return step


def or_in_any_form(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with an effect that larger ones kept out, where it shows whatever their form is.

    It is none that would pass for the larger one. No form is known of what chance decides, and a shape
    correction has none of its own.
    """
    problem, base = found.final_problem, found.final
    seen: dict[str, float] = {}
    for large, names in _by_larger(found, step.blocked[:ASKED_IN_ANY_FORM], settings).items():
        if unlike := [name for name in names if _has_form(found, name, large)]:
            progress(f"looking for {', '.join(unlike)} beside any form of {', '.join(sorted(large))}")
            seen |= form.evidence(problem, base, unlike, large)
    ranked = tuple(sorted(seen.items(), key=lambda one: -one[1]))
    if not ranked or ranked[0][1] < SURE * settings.threshold:
        return step
    name = ranked[0][0]
    model = refit.refitted(problem, base, quiet.beside(Projection(problem, base), name), progress)
    able = [
        one for one in weighed(problem, base, [model]) if one[0] >= selection.least(found, name, settings)
    ]
    other = accepted(problem, base, held_out, able, ranked, {name: ranked[0][1]}) if able else step
    if able and other.accepted:
        found.steps.append(step)
        found.apart[name] = selection.larger(found, name, settings)
        return other
    return step


def _has_form(found: Selection, name: str, large: Collection[str]) -> bool:
    """Return whether larger effects may have another form, and an effect does not pass for them."""
    system = found.problem.system
    return not any(
        system.catalogue[other].held or other in system.shapes or found.alike[other].get(name, 0.0) > ALIKE
        for other in large
    )


def _most(evidence: Values, names: Sequence[str]) -> float:
    return max((evidence.get(name, 0.0) for name in names), default=0.0)


def _by_larger(found: Selection, names: Sequence[str], settings: Section) -> dict[frozenset[str], list[str]]:
    """Return effects by the larger ones that kept them from being added."""
    groups: dict[frozenset[str], list[str]] = {}
    for name in names:
        groups.setdefault(frozenset(selection.larger(found, name, settings)), []).append(name)
    return groups


def or_for_details(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with an effect in place of the details of one that it resembles, where that is better.

    Details may have taken what another effect does: neither shows then beside the other. Where both would do
    as well, that is noted.
    """
    problem, base = found.final_problem, found.final
    details = _details(found)
    found.both.clear()
    for refined, name in _alike_pairs(found, details):
        progress(f"trying {name} in place of the details of {refined}")
        weighted, model = refit.without_details(problem, base, details[refined], name)
        judged = weighed(problem, base, [(weighted, model)])
        if judged[0][0] > -settings.ambiguous and not emptied(problem.system, name, model):
            found.both.setdefault(refined, {})[name] = model.values
        if judged[0][0] < settings.threshold:
            continue
        if not (_is_clean(problem, name) or _cleaner(problem, weighted, name)):
            continue
        gains = {name: judged[0][0]}
        other = accepted(problem, base, held_out, judged, ranking(judged, ()), gains)
        if other.accepted:
            found.steps.append(step)
            _keep_apart(found, refined, name, settings)
            return other
    return step


def or_for_both(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with an effect beside one like it, the details of both free, where it is there.

    Alone, one does most of what both do with its details, and leaves little. No form is left to take it for.
    """
    problem, base = found.final_problem, found.final
    details = _details(found)
    for refined, name in _alike_pairs(found, details):
        progress(f"trying {name} beside {refined} with the details of both")
        judged = weighed(problem, base, [refit.with_both(problem, base, details[refined], name)])
        if judged[0][0] < max(settings.threshold, BOTH * found.evidence[refined]):
            continue
        other = accepted(problem, base, held_out, judged, ranking(judged, ()), {name: judged[0][0]})
        if other.accepted:
            found.steps.append(step)
            _keep_apart(found, refined, name, settings)
            return other
    return step


def _keep_apart(found: Selection, refined: str, name: str, settings: Section) -> None:
    """Note that two effects that resemble each other were told apart: neither needs more beside the other."""
    found.apart[name] = selection.larger(found, name, settings)
    found.apart[refined] = found.apart.get(refined, frozenset()) | {name}


def _details(found: Selection) -> dict[str, dict[str, float]]:
    """Return the effects whose details are free, each with these at their typical values."""
    system = found.problem.system
    return {one: refit.details_of(system, one) for one in refit.refined_in(system, found.final)}


def _alike_pairs(found: Selection, refined: Collection[str]) -> list[tuple[str, str]]:
    """Return effects whose details are free, each with the one that would have done nearly as well.

    What changes other equations alone was nearly as good for another reason.
    """
    known, touched = {*found.final.effects, *found.problem.system.shapes}, found.problem.replay.touched
    others = {
        one: {n: s for n, s in found.alike[one].items() if n not in known and touched(one) & touched(n)}
        for one in refined
    }
    best = {one: max(shares, key=lambda name: shares[name]) for one, shares in others.items() if shares}
    return [(one, name) for one, name in best.items() if others[one][name] > ALIKE]


def _is_clean(problem: Problem, name: str) -> bool:
    """Return whether nothing could leave much less in each of an effect's equations: noise alone is left."""
    return max(problem.weights[n] ** 2 for n in problem.replay.touched(name)) >= CLEANER


def _cleaner(problem: Problem, weighted: Problem, name: str) -> bool:
    """Return whether an effect leaves much less structure in each of its equations."""
    ratio = [(problem.weights[n] / weighted.weights[n]) ** 2 for n in problem.replay.touched(name)]
    return max(ratio) < CLEANER
