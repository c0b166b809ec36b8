# SPDX-License-Identifier: Apache-2.0
"""What a search has found so far, and what evidence it asks of a further effect."""

from dataclasses import dataclass, field

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import Candidate, penalty
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search.screening import is_moved
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section

Ranking = tuple[tuple[str, float], ...]  # effects with their evidence, best first


@dataclass(frozen=True)
class Step:
    """One round: what was accepted, what came next, all candidates that were fitted, gains of all.

    `blocked` are effects that would have enough evidence, and more than what was accepted, were there no
    larger ones; `apart` the best candidate of other equations than those of what was accepted. `closes`: by
    which share squared residuals would be smaller with what was refused, since it is not what its name says.
    """

    accepted: str | None
    fit: Fit | None
    problem: Problem | None
    evidence: float
    held_out_t: float
    ranked: Ranking
    reason: str
    gains: Values = field(default_factory=dict)
    blocked: tuple[str, ...] = ()
    apart: Candidate | None = None
    closes: float = 0.0


@dataclass
class Selection:
    """What the search found.

    Attributes:
        problem, null: weighted problem and fit without added effects.
        final_problem, final: the same with all effects that stayed.
        steps: rounds in order.
        evidence: effect -> difference of BIC when it alone is taken away (or was added).
        entered: effect -> the same when it was added.
        alike: effect -> other one -> share of its gain that the other one had where it was added.
        fitted: effect -> other one -> share of its evidence that the other one had there, fitted too.
        apart: effect -> others, larger ones, in whose silence it was seen too.
        both: effect -> other one that does as well in place of its details -> parameters with both.
        dropped: effects that had enough evidence before others were added.
        present: effect that the model had before -> the same, and the equations that it changes.
    """

    problem: Problem
    null: Fit
    final_problem: Problem
    final: Fit
    steps: list[Step] = field(default_factory=list)
    evidence: dict[str, float] = field(default_factory=dict)
    entered: dict[str, float] = field(default_factory=dict)
    alike: dict[str, Values] = field(default_factory=dict)
    fitted: dict[str, Values] = field(default_factory=dict)
    apart: dict[str, frozenset[str]] = field(default_factory=dict)
    both: dict[str, dict[str, Values]] = field(default_factory=dict)
    dropped: list[str] = field(default_factory=list)
    present: dict[str, tuple[float, frozenset[str]]] = field(default_factory=dict)

    def forget(self, name: str) -> None:
        """Drop what is known of an effect that is no longer there."""
        for known in (self.evidence, self.entered, self.alike, self.fitted, self.apart):
            known.pop(name, None)


def threshold(found: Selection, name: str, settings: Section) -> float:
    """Return the evidence that an effect needs: more beside another one in its equation that has much.

    What the exact form of a large effect leaves over looks like a small one, most of all like one that
    would have explained the large one nearly as well.
    """
    return max([least(found, name, settings), *_asked_beside(found, name, settings).values()])


def least(found: Selection, name: str, settings: Section) -> float:
    """Return the evidence that an effect needs in any case: more beside what the model had before."""
    touched = found.problem.replay.touched
    present = [evidence for evidence, equations in found.present.values() if equations & touched(name)]
    return float(max([settings.threshold, *(settings.share * evidence for evidence in present)]))


def _asked_beside(found: Selection, name: str, settings: Section) -> dict[str, float]:
    """Return the evidence that an effect needs for each other one, if it was not seen in its silence.

    A parameter that recalibration has moved too far is moved in any case: it is only called wrong.
    """
    touched = found.problem.replay.touched
    if found.problem.system.recalibrating(name) or is_moved(found.problem.system, found.final, name):
        return {}
    return {
        other: max(
            _evidence(found, other) * _share(found, other, name, settings),
            settings.share * _taken_over(found, other, name),
        )
        for other in found.evidence
        if other != name and other not in found.apart.get(name, ()) and touched(other) & touched(name)
    }


def _taken_over(found: Selection, other: str, name: str) -> float:
    """Return how much of what an effect was added for a larger one, added later, would have explained.

    What the larger one's exact form leaves over may be all that holds the first one, and look like it.
    """
    if found.evidence[other] <= found.evidence.get(name, np.inf):
        return 0.0
    return found.entered[name] * min(1.0, found.alike[name].get(other, 0.0))


def _evidence(found: Selection, name: str) -> float:
    """Return the evidence of an effect that a smaller one is measured by.

    Its evidence beside the others is an upper limit: without it the model is not fitted to the end. It counts
    where chance decides a part of the prediction, which may look like anything.
    """
    evidence = found.evidence[name]
    return evidence if _by_chance(found, name) else min(evidence, found.entered.get(name, evidence))


def _by_chance(found: Selection, name: str) -> bool:
    """Return whether chance decides where a state of an effect comes to rest, as that of a play."""
    return bool(found.problem.system.catalogue[name].held)


def _share(found: Selection, other: str, name: str, settings: Section) -> float:
    """Return the share of another effect's evidence that an effect needs beside it."""
    alike = 1.0 if _by_chance(found, other) else min(1.0, found.alike[other].get(name, 0.0))
    return float(max(settings.least_share, settings.share * alike))


def likeness(found: Selection, other: str, name: str) -> float:
    """Return the share of what a larger effect explained that another one would have, at most.

    A gain is a promise, to first order; where the other one was fitted too, its evidence is known.
    """
    promised = found.alike[other].get(name, 0.0)
    return min(promised, found.fitted.get(other, {}).get(name, promised))


def larger(found: Selection, name: str, settings: Section) -> frozenset[str]:
    """Return the effects beside which a small one needs more evidence than alone."""
    asked = _asked_beside(found, name, settings)
    return frozenset(other for other, evidence in asked.items() if evidence > settings.threshold)


def blocked(
    found: Selection, thresholds: Values, gains: Values, ranked: Ranking, settings: Section
) -> Values:
    """Return effects that only larger ones keep from being added, most evident first, and their evidence."""
    system, base = found.problem.system, found.final
    possible = {
        name: gain - penalty(base, len(system.catalogue[name].fitted)) for name, gain in gains.items()
    } | dict(ranked)
    names = sorted((n for n in possible if n not in system.shapes), key=lambda n: -possible[n])
    return {
        n: possible[n]
        for n in names
        if least(found, n, settings) <= possible[n] < thresholds[n] and larger(found, n, settings)
    }
