# SPDX-License-Identifier: Apache-2.0
"""The judgement on what a search found: gaps before and after, closure, verdict."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from pam_orthosis.discrepancy.answer.noise_floor import decided_and_floor, remark_on_left_out
from pam_orthosis.discrepancy.fitting import measure, structure
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.free import scales_of
from pam_orthosis.discrepancy.preparation.beginning import Beginning, strained_parameters
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search import findings
from pam_orthosis.discrepancy.search.confirmation import emptied
from pam_orthosis.discrepancy.search.findings import Named, first_accepted, named_effect, runner_up_of
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import Names, System, Values
from pam_orthosis.discrepancy.unknown.unknown import Unknown
from pam_orthosis.model.parameters import Section

LEAST_CLOSURE = 0.9  # below it named effects that leave structure are a part of the explanation
MOST_LEFT = 1.3  # gap after over the noise floor above which the residual is not called clean
MOST_OFF = 2.5  # a residual in its unit over what noise leaves: a slow one weighs little among whitened ones
NEAR = 1.5  # gap of an equation over the noise floor above which it is not explained, whatever was closed
LEAST_NAMED = 0.5  # closure of a model below which it names nothing, and
LEAST_APART = 0.75  # of the equations that an effect changes, whatever is left in others
FAR_STRAIN = 5.0  # tolerances: less likely hardware than a wrong zero, unit or mechanism
WIDE = 10.0  # times its priors: the same of a shape correction that is named, or beside a named effect
MOVED = 3.0  # tolerances that recalibration moves a parameter: a finding, whatever is left
MANY_STRAINED = 3  # nuisance parameters so far off: they bend a model to another machine
NEARLY = 0.9  # of a gap, that a description removes: it is of the machine given
SEVERAL = 2  # effects, of which one may make up for stamps that are off
MOST_KEPT = 20.0  # gap of an equation over the noise floor, whatever is described, of the machine given
OPEN = ("partial", "unexplained")
GOOD = ("none", "recalibrated", "explained")  # verdicts on a gap that is not there or explained


class Rest(NamedTuple):
    """What a model leaves of the held-out recordings.

    Attributes:
        clean: noise only.
        excess: gap over the noise, in the equation where it is largest.
        closed_by_recalibration: nothing was to be explained: what is named explains what recalibration moved.
        strained: nuisance parameters are far off in an equation in which no effect is named.
        another_machine: many are.
        shapes_strained: shape corrections are too, though not beyond what they may be once named.
        beyond_tolerance: calibrations or shape corrections lie beyond what was stated of them.
        channel_off: a channel is far off in its unit.
    """

    clean: bool
    excess: float
    closed_by_recalibration: bool
    strained: bool = False
    another_machine: bool = False
    beyond_tolerance: bool = False
    shapes_strained: bool = False
    channel_off: bool = False


@dataclass(frozen=True)
class Outcome:
    """All that the workflow found; `report` and `cli` turn it into pages and files.

    `look_alikes` and `separated_by` are those of the first effect. `from_configured` names the closures that
    count from the configured model, since recalibration closed the gap already. `surrogates` are effects of
    the model that are no explanation; `empty` the parameters (as `EFFECT.PARAMETER`) at values where effects
    are not what their names say. `unknown` describes what is left. `mistaken`: the verdict would be a better
    one, but the recordings seem to have a mistake; `skewed`: but stamps seem off, and nothing named is late.
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
    unknown: Unknown | None = None
    foreign: bool = False
    mistaken: str = ""
    skewed: bool = False

    @property
    def misled(self) -> bool:
        """Whether only surrogates are added, and they leave as much of held-out recordings as nothing."""
        worse = self.after.white[measure.OVERALL] >= self.before.white[measure.OVERALL]
        return bool(self.surrogates) and not self.effects and worse

    def of_mistaken(self, told: str) -> Outcome:
        """Return the outcome where something seems mistaken: what makes up for it is no explanation."""
        return replace(self, verdict="partial" if self.effects else "unexplained", mistaken=told)

    def of_skewed(self, told: Sequence[str], clearly: bool) -> Outcome:
        """Return the outcome of recordings whose stamps seem off: of several effects one may make up for it.

        A delay is what is off. Where no other or one effect leaves noise alone, by the stamps as they are,
        these are right, and remarks on them are left out.
        """
        names = (one.name for one in self.effects if one.name not in self.system.wrong)
        named = [self.system.catalogue[name] for name in names]
        late = any(one.late is not None or one.advance is not None or one.lag is not None for one in named)
        if late:
            return self
        if len(named) < SEVERAL:
            return replace(self, remarks=[one for one in self.remarks if one not in told])
        return replace(self, verdict="partial", skewed=True) if clearly else self

    @property
    def kept(self) -> dict[str, float]:
        """Equation -> how many times the noise is left of it by the effects that are named, if any are."""
        return measure.over_noise(self.system, self.after if self.effects else self.before, self.floor)

    @property
    def left_unknown(self) -> float:
        """How many times the noise is left in the equation of what is described."""
        assert self.unknown
        return measure.reduced(self.kept[self.unknown.equation], self.unknown.reduced)

    def described(self, left: Unknown | None) -> Outcome:
        """Return the outcome with what can be said of what is left."""
        kept = measure.over_noise(self.system, self.after, self.floor)
        known = left is not None and bool(left.descriptions)
        if left is not None:
            kept[left.equation] = measure.reduced(kept[left.equation], left.reduced)
        pushed = left is not None and bool(left.events)  # it is moved by what is no part of it
        # whatever the noise of its sensor
        known_of = left.equation if left and left.reduced > NEARLY and not self.effects else ""
        far = max((value for name, value in kept.items() if name != known_of), default=0.0)
        if self.foreign or (far > MOST_KEPT and not pushed):
            nothing: dict[str, Any] = dict.fromkeys(
                ("effects", "surrogates", "look_alikes", "separated_by"), ()
            )
            return replace(self, verdict="unexplained", runner_up=None, foreign=True, **nothing)
        others = [value for name, value in self.kept.items() if left is None or name != left.equation]
        whole = known and max(others, default=0.0) <= NEAR
        return replace(self, verdict="described" if whole else self.verdict, unknown=left)


def outcome_of(start: Beginning, found: Selection, settings: Section, remarks: Sequence[str] = ()) -> Outcome:
    """Return the judgement on what a search found, by the held-out recordings; `remarks` on it."""
    system, judge, final = start.system, start.held_out, found.final
    spread = findings.covariance(found.final_problem, final)
    judged, floor = decided_and_floor(start, found, spread, settings)
    configured = start.configured(judged)
    before, after = start.recalibrated(judged), measure.gap(judge, final, judged)
    where, left = start.where(), structure.locate(judge, final, judged)
    gone = _is_gone(before, floor, where)
    base = configured if gone else before
    closed = _closures(configured, base, after, floor)
    counted = _from_configured(floor if gone else base, floor, closed)
    empty = tuple(key for name in final.effects for key in emptied(system, name, final))
    rest = _rest(system, final, left, after, floor, gone)
    deviation = findings.deviations(system, final, spread)
    every = tuple(named_effect(system, found, deviation, name, settings.evidence) for name in final.effects)
    first = first_accepted(found, every)
    # a name that leaves most of the gap open is no name
    trusted = _trusted(closed[measure.OVERALL])
    able = [one for one in final.effects if trusted or _closes_own(found, one, base, closed)]
    meant = () if rest.another_machine else _meant(able, empty)
    verdict = verdict_on(final.effects, closed[measure.OVERALL], rest, empty)
    return Outcome(
        system=system,
        verdict="partial" if meant and not trusted else verdict,
        effects=tuple(one for one in every if one.name in meant),
        surrogates=tuple(one for one in every if one.name not in meant),
        look_alikes=first.look_alikes if first else (),
        separated_by=first.separated_by if first else (),
        runner_up=runner_up_of(found),
        configured=configured,
        before=before,
        after=after,
        floor=floor,
        closure=closed,
        from_configured=counted,
        where=where,
        left=left,
        strained=strained_parameters(final),
        empty=empty,
        steps=tuple(found.steps),
        remarks=(*start.remarks, *remarks, *remark_on_left_out(judged)),
        selection=found,
        held_out=judge,
        foreign=rest.another_machine,
    )


def _rest(
    system: System,
    final: Fit,
    left: Sequence[structure.Where],
    after: measure.Gap,
    floor: measure.Gap,
    closed_by_recalibration: bool,
) -> Rest:
    """Return what a final model leaves."""
    return Rest(
        clean=structure.clean(left) and not beyond(after, floor),
        excess=max(measure.over_noise(system, after, floor).values()),
        closed_by_recalibration=closed_by_recalibration,
        strained=bool(_astray(system, final)),
        another_machine=len(_far_off(system, final)) >= MANY_STRAINED,
        beyond_tolerance=bool(moved_beyond(system, final)),
        shapes_strained=len(_far_off(system, final, FAR_STRAIN)) >= MANY_STRAINED,
        channel_off=bool(off(after, floor)),
    )


def _far_off(system: System, final: Fit, bent: float = WIDE) -> list[str]:
    """Return the nuisance parameters that are far off; `bent`: multiples of its priors of a shape correction.

    Those of a shape correction may be `WIDE` of them once it is named.
    """
    scales = scales_of(system, final.free)
    strained = strained_parameters(final)
    shape = {name: name.partition(".")[0] for name in strained}
    strain = {name: scales.get(shape[name], 1.0) * abs(value) for name, value in strained.items()}
    return [name for name in strain if strain[name] > (bent if shape[name] in scales else FAR_STRAIN)]


def moved_beyond(system: System, final: Fit, least: float = MOVED) -> dict[str, float]:
    """Return what moved by more than `least` of its tolerance, shape corrections by more than is notable."""
    own = {one.name for one in system.calibrations}
    moved = {one.name: one.deviation(final.values) for one in final.free if one.name in own}
    return {name: value for name, value in moved.items() if abs(value) > least} | strained_parameters(final)


def shares_moved(final: Fit) -> dict[str, float]:
    """Return by how many of its tolerances recalibration moved each parameter; a shape's furthest one."""
    moved: dict[str, float] = {}
    for one in final.free:
        name = one.name.partition(".")[0]
        moved[name] = max(moved.get(name, 0.0), abs(one.deviation(final.values)))
    return moved


def _astray(system: System, final: Fit) -> list[str]:
    """Return those that are far off where no effect is named whose other form may have moved them so far."""
    named = {system.equation_of(name) for name in final.effects}
    seen = {name for equation in named & set(final.blocks) for name in final.blocks[equation].names}
    own = {one.name for one in system.calibrations}
    surely = {name for name, times in strained_parameters(final).items() if name in own and abs(times) > WIDE}
    return [name for name in _far_off(system, final, FAR_STRAIN) if name not in seen - surely]


def _is_gone(before: measure.Gap, floor: measure.Gap, where: Sequence[structure.Where]) -> bool:
    """Return whether recalibration alone leaves noise: a share of so little says nothing of an effect."""
    hardly = before.white[measure.OVERALL] < (1 + measure.LEAST_EXCESS) * floor.white[measure.OVERALL]
    return hardly or (structure.clean(where) and not beyond(before, floor))


def _closures(
    configured: measure.Gap, before: measure.Gap, after: measure.Gap, floor: measure.Gap
) -> dict[str, float | None]:
    """Return closure per channel and overall, of whitened residuals, from the recalibrated model.

    Where recalibration alone hides the gap (an effect that resembles a nuisance parameter), closure
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


def _closes_own(found: Selection, name: str, before: measure.Gap, closed: Mapping[str, float | None]) -> bool:
    """Return whether the gap of the equations that an effect changes is closed, not that of others."""
    problem = found.final_problem
    touched = [one for one in problem.system.equations if one.name in problem.replay.touched(name)]
    shares = [closed[channel] for one in touched for channel in one.channels if before.white[channel] > NEAR]
    late = problem.system.catalogue[name].advance is not None  # a sensor drives the other equations too
    return bool(shares) and not late and min(share or 0.0 for share in shares) >= LEAST_APART


def _meant(effects: Sequence[str], empty: Sequence[str]) -> Names:
    """Return the effects that are what their names say."""
    return tuple(name for name in effects if not any(key.startswith(f"{name}.") for key in empty))


def beyond(after: measure.Gap, floor: measure.Gap) -> bool:
    """Return whether a gap is left, however well free parameters that are moved again would follow it."""
    return after.white[measure.OVERALL] > MOST_LEFT * floor.white[measure.OVERALL] or bool(off(after, floor))


def off(after: measure.Gap, floor: measure.Gap) -> dict[str, float]:
    """Return the channels that are far off in their unit: their residuals over what noise leaves of them."""
    times = {name: value / floor.units[name] for name, value in after.units.items()}
    return {name: value for name, value in times.items() if value > MOST_OFF}


def verdict_on(effects: Names, share: float | None, rest: Rest, empty: Sequence[str]) -> str:
    """Return the verdict on a model with effects that explains a share of the gap.

    Args:
        share: None if there is hardly a gap, be it of the nominal model.
        rest: what is left.
        empty: parameters at which effects are not what their names say.
    """
    if not effects:
        sound = rest.clean and not rest.strained and not rest.shapes_strained
        return ("recalibrated" if rest.beyond_tolerance else "none") if sound else "unexplained"
    if rest.another_machine or not _meant(effects, empty) or not _trusted(share):
        return "unexplained"
    if (
        empty
        or rest.strained
        or rest.shapes_strained
        or rest.channel_off
        or rest.excess > NEAR
        or not (rest.clean or (share is not None and share >= LEAST_CLOSURE))
    ):
        return "partial"
    return "recalibrated" if rest.closed_by_recalibration else "explained"
