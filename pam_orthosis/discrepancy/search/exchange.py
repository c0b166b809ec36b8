# SPDX-License-Identifier: Apache-2.0
"""What resembles an effect is tried in its place once a larger effect is known, which may have bent it."""

from collections.abc import Sequence

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import Candidate, Trial, candidate
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.free import scales_of
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.fitting.refit import fitted_with
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search.acceptance import accepted
from pam_orthosis.discrepancy.search.confirmation import MOST_AGAINST, confirmed, weighed
from pam_orthosis.discrepancy.search.elimination import loss
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import Progress

ALIKE = 0.5  # of an effect's gain that another one had where it was added
MOST_RIVALS = 2


def exchanged(
    found: Selection, known: Sequence[str], held_out: Problem, settings: Section, progress: Progress
) -> Step | None:
    """Return the step in which an effect takes the place of one that was added before a larger one was.

    Without the larger one the fit of the first was bent, and so was the choice among what resembles it.
    `known` are the effects that the model had before those that were added now.
    """
    effects = found.final.effects
    largest = max((found.entered[name] for name in effects if name not in known), default=0.0)
    for name in effects:
        if name in known and found.entered[name] < largest and (rivals := _rivals(found, name)):
            progress(f"trying {', '.join(rivals)} in place of {name}")
            step = _in_place(found, held_out, name, rivals, settings)
            if step is not None and step.accepted:
                return step
    return None


def _rivals(found: Selection, name: str) -> list[str]:
    """Return what would have done nearly as well where an effect was added, the best first."""
    system = found.problem.system
    taken = system.taken(found.final.effects) | {*system.shapes}
    alike = found.alike[name].items()
    shares = {other: share for other, share in alike if other not in taken and share > ALIKE}
    return sorted(shares, key=lambda other: -shares[other])[:MOST_RIVALS]


def _in_place(
    found: Selection, held_out: Problem, name: str, rivals: list[str], settings: Section
) -> Step | None:
    """Return the step with the best of some effects in place of one, if it has more evidence by a name's.

    Held-out recordings have to confirm it, and must not speak for the one whose place it takes.
    """
    problem, final = found.final_problem, found.final
    _, base = loss(found, name)
    if not np.isfinite(base.hessian).all():  # its replay goes astray: nothing takes the place
        return None
    tried = [one for rival in rivals for one in _candidates(problem, base, rival)]
    models = [fitted_with(problem, base, one) for one in tried]
    (own, *_), *judged = weighed(problem, base, [(problem, final), *models])
    judged.sort(key=lambda one: one[0])
    evidence, weighted, model = judged[-1]
    if evidence < max(own, 0.0) + settings.threshold:
        return None
    common = problem.weighted(weighted.weights), held_out.weighted(weighted.weights)
    if confirmed(*common, final, model).fall < -MOST_AGAINST:
        return None
    ranked = {name: own, **{fit.effects[-1]: value for value, _, fit in judged}}
    gains = {other: share * evidence for other, share in found.alike[name].items()}
    gains |= {name: max(own, 0.0), model.effects[-1]: evidence}
    best_first = tuple(sorted(ranked.items(), key=lambda item: -item[1]))
    return accepted(problem, base, held_out, judged[-1:], best_first, gains)


def _candidates(problem: Problem, base: Fit, name: str) -> list[Candidate]:
    """Return an effect beside a base, from its nuisance parameters and from theirs at rest."""
    projection = Projection(problem, base)
    trial = Trial(projection, name)
    starts = trial.starts()
    near = candidate(projection, trial, starts)
    values = {**near.values, **_at_rest(problem.system, base)}
    return [near, Candidate(name, 0.0, values, 0.0, scales_of(problem.system, base.free), trial.added)]


def _at_rest(system: System, base: Fit) -> dict[str, float]:
    """Return the nuisance parameters of a fit where their tolerances hold them."""
    effects = {*base.effects} - {*system.shapes}
    return {one.name: one.centre for one in base.free if one.name.partition(".")[0] not in effects}
