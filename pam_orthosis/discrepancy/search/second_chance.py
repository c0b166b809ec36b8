# SPDX-License-Identifier: Apache-2.0
"""What larger effects kept out: asked for in their silence, beside any form, in place of details."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search import form, quiet, selection
from pam_orthosis.discrepancy.search.acceptance import accepted
from pam_orthosis.discrepancy.search.confirmation import emptied, ranking, weighed
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress

ALIKE = 0.5  # of an effect's gain that another one had in its place
BOTH = 2e-3  # of an effect's evidence, that one like it needs beside it and its details
CLEANER = 0.6  # of the power density that was left, with an effect in place of another's details


def or_in_silence(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with what larger effects kept from being added, where it is better; note the other."""
    return _or_apart(found, held_out, step, IN_SILENCE, (settings, progress))


def or_in_any_form(
    found: Selection, held_out: Problem, step: Step, settings: Section, progress: Progress
) -> Step:
    """Return the step with what larger effects kept out and none of their forms does, where it is better."""
    return _or_apart(found, held_out, step, IN_ANY_FORM, (settings, progress))


class _Way(NamedTuple):
    """A way to see an effect apart from larger ones.

    Attributes:
        evidence: of effects beside a model, given the larger ones.
        possible: whether an effect can be seen so.
        sure: times the threshold, that it needs.
        asked: effects that are asked for, the most evident ones.
        where: words, to which the larger effects are added.
    """

    evidence: Callable[[Problem, Fit, Sequence[str], Collection[str]], Values]
    possible: Callable[[Selection, str, Collection[str]], bool]
    sure: float
    asked: int
    where: str


def _has_form(found: Selection, name: str, large: Collection[str]) -> bool:
    """Return whether larger effects may have another form, and an effect does not pass for them.

    What is left of an effect that chance decides has no form, and a shape correction is none.
    """
    system = found.problem.system
    return not any(
        system.catalogue[other].held
        or other in system.shapes
        or selection.likeness(found, other, name) > ALIKE
        for other in large
    )


IN_SILENCE = _Way(quiet.evidence, lambda *_: True, 1.0, 3, "without")
IN_ANY_FORM = _Way(form.evidence, _has_form, 2.0, 6, "beside any form of")


def _or_apart(
    found: Selection, held_out: Problem, step: Step, way: _Way, told: tuple[Section, Progress]
) -> Step:
    other = _round_apart(found, held_out, step, way, told)
    if not other.accepted:
        return step
    reason = f"{other.accepted} has more evidence {way.where} larger effects"
    found.steps.append(replace(step, accepted=None, reason=reason) if step.accepted else step)
    return other


def _round_apart(
    found: Selection, held_out: Problem, last: Step, way: _Way, told: tuple[Section, Progress]
) -> Step:
    """Return the step with the best of the effects that only larger ones kept from being added.

    It needs its evidence apart from these, and more there than what was accepted beside them.
    """
    problem, base, (settings, progress) = found.final_problem, found.final, told
    seen: dict[str, float] = {}
    for large, names in _by_larger(found, last.blocked[: way.asked], settings).items():
        possible = [name for name in names if way.possible(found, name, large)]
        if not possible:
            continue
        progress(f"looking for {', '.join(possible)} {way.where} {', '.join(sorted(large))}")
        others = [last.accepted] if last.accepted else []
        shown = way.evidence(problem, base, [*possible, *others], large)
        seen |= {name: shown[name] for name in possible if shown.get(name, 0.0) > _most(shown, others)}
    ranked = tuple(sorted(seen.items(), key=lambda one: -one[1]))
    if not ranked or ranked[0][1] < way.sure * settings.threshold:
        return Step(None, None, None, 0.0, 0.0, ranked, f"nothing shows {way.where} larger effects")
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
