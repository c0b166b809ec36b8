# SPDX-License-Identifier: Apache-2.0
"""The judgement on what a search found: gaps before and after, closure, verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from pam_orthosis.discrepancy import findings, measure, structure
from pam_orthosis.discrepancy.beginning import Beginning, strained_parameters
from pam_orthosis.discrepancy.findings import Named, first_accepted, named_effect, runner_up_of
from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.noise_floor import decided_and_floor, remark_on_left_out
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.selection import Selection, Step
from pam_orthosis.discrepancy.system import System, Values
from pam_orthosis.model.parameters import Section

LEAST_CLOSURE = 0.9  # below it named effects that leave a gap are no explanation
MOST_LEFT = 1.3  # gap after over the noise floor above which the residual is not called clean
MOST_KEPT = 3.0  # gap of an equation over the noise floor above which it is unexplained, whatever was closed
LEAST_NAMED = 0.5  # closure of a model below which it names nothing


@dataclass(frozen=True)
class Outcome:
    """All that the workflow found; `report` and `cli` turn it into pages and files.

    `look_alikes` and `separated_by` are those of the first effect. `from_configured` names the closures that
    count from the configured model, since recalibration closed the gap already. `empty` are parameters of
    the effects (as `EFFECT.PARAMETER`) at values where these are not what their names say.
    """

    system: System
    verdict: str
    effects: tuple[Named, ...]
    surrogates: tuple[Named, ...]
    look_alikes: tuple[str, ...]
    separated_by: tuple[str, ...]
    runner_up: tuple[str, float] | None
    configured: measure.Gap
    before: measure.Gap
    after: measure.Gap
    floor: measure.Gap
    closure: Mapping[str, float | None]
    from_configured: tuple[str, ...]
    where: Sequence[structure.Where]
    left: Sequence[structure.Where]
    strained: Values
    empty: tuple[str, ...]
    steps: Sequence[Step]
    remarks: Sequence[str]
    selection: Selection = field(repr=False)
    held_out: Problem = field(repr=False)


def outcome_of(start: Beginning, found: Selection, settings: Section) -> Outcome:
    """Return the judgement on what a search found, by the held-out recordings."""
    system, judge, final = start.system, start.held_out, found.final
    spread = findings.covariance(found.final_problem, final)
    judged, floor = decided_and_floor(start, found, spread, settings)
    configured = start.configured(judged)
    before, after = start.recalibrated(judged), measure.gap(judge, final, judged)
    left = structure.locate(judge, final)
    closed = _closures(configured, before, after, floor)
    kept, empty = max(measure.over_noise(system, after, floor).values()), _empty(system, final)
    verdict = _verdict(final, structure.clean(left) and not beyond(after, floor), closed, kept, empty)
    named = tuple(named_effect(system, found, spread, name, settings.evidence) for name in final.effects)
    first = first_accepted(found, named)
    trusted = _trusted(closed[measure.OVERALL])  # a name that leaves most of the gap open is no name
    return Outcome(
        system=system,
        verdict=verdict,
        effects=named if trusted else (),
        surrogates=() if trusted else named,
        look_alikes=first.look_alikes if first else (),
        separated_by=first.separated_by if first else (),
        runner_up=runner_up_of(found),
        configured=configured,
        before=before,
        after=after,
        floor=floor,
        closure=closed,
        from_configured=_from_configured(before, floor, closed),
        where=start.where(),
        left=left,
        strained=strained_parameters(final),
        empty=empty if trusted else (),
        steps=tuple(found.steps),
        remarks=(*start.remarks, *remark_on_left_out(judged)),
        selection=found,
        held_out=judge,
    )


def _closures(
    configured: measure.Gap, before: measure.Gap, after: measure.Gap, floor: measure.Gap
) -> dict[str, float | None]:
    """Return closure per channel and overall, of whitened residuals, from the recalibrated model.

    Where recalibration alone hides the gap (an effect that resembles an ordinary parameter), closure
    counts from the configured model.
    """
    closed: dict[str, float | None] = {}
    for name, after_white in after.white.items():
        closed[name] = measure.closure(before.white[name], after_white, floor.white[name])
        if closed[name] is None:
            closed[name] = measure.closure(configured.white[name], after_white, floor.white[name])
    return closed


def _from_configured(
    before: measure.Gap, floor: measure.Gap, closed: Mapping[str, float | None]
) -> tuple[str, ...]:
    """Return the closures that `_closures` counts from the configured model."""
    return tuple(
        name
        for name, share in closed.items()
        if share is not None and measure.closure(before.white[name], 0.0, floor.white[name]) is None
    )


def _trusted(share: float | None) -> bool:
    """Return whether a model closes enough of the gap to be one; None: there is hardly any gap."""
    return share is None or share >= LEAST_NAMED


def beyond(after: measure.Gap, floor: measure.Gap) -> bool:
    """Return whether a gap is left, however well free parameters that are moved again would follow it."""
    return after.white[measure.OVERALL] > MOST_LEFT * floor.white[measure.OVERALL]


def _verdict(
    final: Fit, clean: bool, closed: Mapping[str, float | None], kept: float, empty: Sequence[str]
) -> str:
    """Return the verdict on a model that leaves a `clean` residual or not.

    Args:
        kept: the gap over the noise, in the equation where it is largest.
        empty: parameters at which effects of the model are not what their names say.
    """
    share = closed[measure.OVERALL]
    if clean and not final.effects:
        return "none"
    if not final.effects or empty or kept > MOST_KEPT or not _trusted(share):
        return "unexplained"
    return "explained" if clean or (share is not None and share >= LEAST_CLOSURE) else "unexplained"


def _empty(system: System, final: Fit) -> tuple[str, ...]:
    """Return the parameters at which effects are not what their names say."""
    return tuple(
        f"{name}.{q.name}"
        for name in final.effects
        for q in system.catalogue[name].parameters
        if q.is_empty(final.values[f"{name}.{q.name}"])
    )
