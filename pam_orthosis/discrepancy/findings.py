# SPDX-License-Identifier: Apache-2.0
"""What is said of an effect that was found: parameters, evidence, what resembles it, what separates them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pam_orthosis.discrepancy import intervals
from pam_orthosis.discrepancy.selection import Selection
from pam_orthosis.discrepancy.system import System
from pam_orthosis.model.parameters import Section


@dataclass(frozen=True)
class Named:
    """An effect that was found: parameters (name -> value, unit, lower, upper), evidence.

    `look_alikes` are effects that nothing told from it when it was added, `separated_by` the experiments
    that would.
    """

    name: str
    equation: str
    parameters: Mapping[str, tuple[float, str, float, float]]
    evidence: float
    look_alikes: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()


def named_effect(system: System, found: Selection, spread: np.ndarray, name: str, settings: Section) -> Named:
    """Return what is said of an effect of the final model; `spread`: covariance of its free parameters."""
    effect, final = system.catalogue[name], found.final
    parameters = {}
    known = {one.name for one in final.free}
    for q in effect.parameters:
        key = f"{name}.{q.name}"
        if key not in known:
            continue
        parameters[q.name] = (final.values[key], q.unit, *intervals.interval(final, spread, key))
    alike = _look_alikes(found, name, settings)
    apart = _separated_by(system, (name, *alike)) if alike else ()
    return Named(name, system.equation_of(name), parameters, found.evidence[name], alike, apart)


def first_accepted(found: Selection, named: Sequence[Named]) -> Named | None:
    """Return the effect that was accepted first of those that stayed."""
    order = [step.accepted for step in found.steps]
    return min(named, key=lambda one: order.index(one.name), default=None)


def _first_round(found: Selection) -> tuple[float, Sequence[tuple[str, float]]]:
    """Return `_round_of` the first accepted effect that stayed."""
    accepted = [step.accepted for step in found.steps if step.accepted in found.final.effects]
    return _round_of(found, accepted[0]) if accepted else (0.0, ())


def _round_of(found: Selection, name: str) -> tuple[float, Sequence[tuple[str, float]]]:
    """Return the evidence of an effect when it was accepted, and those of its round that are not named.

    The best effect of a round may have been refused, and the next one accepted. A round in silence ranks
    by evidence of its own.
    """
    step = next(step for step in found.steps if step.accepted == name)
    own = dict(step.ranked).get(name, step.evidence)
    return own, [item for item in step.ranked if item[0] not in found.final.effects]


def runner_up_of(found: Selection) -> tuple[str, float] | None:
    """Return the best effect that was not chosen in the first round, and how far it was behind."""
    own, others = _first_round(found)
    behind = [(name, own - evidence) for name, evidence in others]
    return min(behind, key=lambda item: item[1]) if behind else None


def _look_alikes(found: Selection, name: str, settings: Section) -> tuple[str, ...]:
    """Return the effects that were near in evidence when one was accepted, but for those that are named."""
    own, others = _round_of(found, name)
    near = max(settings.ambiguous, settings.ambiguous_share * own)
    return tuple(other for other, evidence in others if own - evidence < near)


def _separated_by(system: System, names: Sequence[str]) -> tuple[str, ...]:
    """Return the experiments that part some effects, those of the first one first."""
    return tuple(dict.fromkeys(test for name in names for test in system.experiments(name)))
