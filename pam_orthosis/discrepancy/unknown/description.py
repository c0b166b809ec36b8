# SPDX-License-Identifier: Apache-2.0
"""The unknown, described: what the catalogue does not explain, as curves over measured signals.

A linear spline over a signal enters an equation, the nuisance parameters move beside it, and training
recordings fit it; the signal whose curve reduces the held-out gap most is given. A description is no cause.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import permutations
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.signals import signals_of
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search.findings import QUANTILE
from pam_orthosis.discrepancy.systems.system import Entry, Equation, System, Values
from pam_orthosis.discrepancy.unknown import periodic, textbook, waves
from pam_orthosis.discrepancy.unknown.curve_fit import (
    SIMPLER,
    CurveFit,
    Fitted,
    Spline,
    Term,
)
from pam_orthosis.discrepancy.unknown.parts import CONSTANT, parts_of

LEAST_REDUCED = 0.5  # share of the held-out gap that descriptions of an equation remove, at least
LEAST_ADDED = 0.2  # of that gap: what one of several removes
NEAR = 0.05  # of that gap: signals that differ by less are told apart by the equation, not by the recordings
UNSURE = 3.0  # times the median standard deviation: places that were hardly visited
MOSTLY = 0.5  # of the samples that judge, inside the range that was fitted


@dataclass(frozen=True)
class Description:
    """What is unknown in the equation of a channel, as a function of one signal.

    Attributes:
        channel: where it enters.
        entry: how it enters.
        coordinate: the signal that it depends on.
        places, values: knots and what enters there. A mean is left to recalibration, but of a curve over
            what the equation predicts, or its rate.
        shape, covariance: the same; of such a curve without a parabola, which nuisance parameters may have
            taken or given.
        reduced: share of the held-out gap of its equation, above the noise, that it removes: of what several
            remove together, a part by what each channel's add, shared equally by two of a channel.
        runner_up: the next best signal, or two, and the share.
        period: of the curve, in the signal's unit, if it is a wave.
        harmonics: of a wave that is the same in each period; none: a curve of free values.
        moving: standard deviation of the amplitude by what further rounds of fits would change.
        level: the mean that is left to recalibration.
        shape_of: the textbook effect that has its shape, if one has.
        beside: the model's free parameters, as they were fitted with it.
    """

    channel: str
    entry: Entry
    coordinate: str
    places: np.ndarray
    values: np.ndarray
    shape: np.ndarray
    covariance: np.ndarray
    reduced: float
    runner_up: tuple[str, float] | None
    period: float | None
    level: float = 0.0
    shape_of: str | None = None
    beside: Values = field(default_factory=dict)
    harmonics: int = 0
    moving: float = 0.0

    @property
    def is_constant(self) -> bool:
        """Whether it hardly depends on its signal: what the model lacks is a constant."""
        return abs(self.level) > CONSTANT * self.amplitude[2]

    @property
    def unit(self) -> str:
        """The unit of what enters."""
        return self.entry.unit

    @property
    def amplitude(self) -> tuple[float, float, float]:
        """Half the range of the shape, or the amplitude of the wave that it is, with its 95 % interval."""
        curve = self.places, self.shape, self.covariance
        if self.period is not None and self.harmonics:
            return self._with_interval(*waves.wave_swing(*curve, self.period, self.harmonics))
        if self.period is not None:
            return self._with_interval(*waves.wave_amplitude(*curve, self.period))
        sure = self.spread <= UNSURE * np.median(self.spread)
        shown = np.where(sure, self.shape, np.nan)
        top, bottom = int(np.nanargmax(shown)), int(np.nanargmin(shown))
        size = 0.5 * float(self.shape[top] - self.shape[bottom])
        contrast = self.covariance[top] - self.covariance[bottom]
        return self._with_interval(size, 0.25 * float(contrast[top] - contrast[bottom]))

    def _with_interval(self, size: float, variance: float) -> tuple[float, float, float]:
        half = QUANTILE * float(np.sqrt(max(variance, 0.0) + self.moving**2))
        return size, size - half, size + half

    @property
    def spread(self) -> np.ndarray:
        """The standard deviations of the shape."""
        spread: np.ndarray = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return spread


def described(problem: Problem, judge: Problem, model: Fit, equation: Equation) -> tuple[Description, ...]:
    """Return the best descriptions of what a model lacks in an equation, one term a channel at most.

    Args:
        problem: recordings to fit.
        judge: recordings that choose.
        model: whose nuisance parameters and effects move with the curves.
    """
    groups = [group.weighted(dict.fromkeys(group.weights, 1.0)) for group in (problem, judge)]
    system, curves = problem.system, CurveFit(groups[0], groups[1], model, equation)
    open_ = [channel for channel in equation.channels if system.channel(channel).state is not None]
    terms = {channel: _terms(system, equation, channel, _coordinates(groups)) for channel in open_}

    def best(channels: Collection[str]) -> _Chosen:
        tried = [term for channel in channels for term in terms[channel]]
        fixed = _splines(one for name, one in chosen.items() if name not in channels)
        found = problem.replay.workers.forked(partial(curves.best, fixed), tried)
        return _best(found, curves.reduced(curves.fit(fixed)), own_signals(system, equation))

    chosen: dict[str, _Chosen] = {}
    while open_ and sum(one.share for one in chosen.values()) < 1 - LEAST_ADDED:
        more, before = best(open_), _splines(chosen.values())
        both = curves.fit((*before, *more.splines)), curves.fit(before)
        if more.share < LEAST_ADDED or not curves.confirmed(*both):
            break
        channel = more.splines[0].channel
        chosen[channel] = more
        open_.remove(channel)
    for channel in chosen if len(chosen) > 1 else ():  # the first was chosen without the others
        chosen[channel] = best([channel])
    return tuple(
        _compared(system, one) for one in _descriptions(curves, _repeating(curves, system, chosen, open_))
    )


def refitted(
    problem: Problem, judge: Problem, model: Fit, equation: Equation, told: Sequence[Description]
) -> tuple[Description, ...]:
    """Return descriptions with their curves fitted again, by a model that has them as they are.

    As they are, too, where derivatives of that model ran away: nothing can be told from them.
    """
    groups = [group.weighted(dict.fromkeys(group.weights, 1.0)) for group in (problem, judge)]
    curves = CurveFit(groups[0], groups[1], model, equation)
    found = curves.fit(periodic.with_harmonics(curves, tuple(_spline(problem.system, one) for one in told)))
    changed = [_changed(curves, found, index, one) for index, one in enumerate(told)]
    if not all(np.isfinite(one.covariance).all() for one in changed):
        return tuple(told)
    return tuple(_compared(problem.system, one) for one in changed)


def _spline(system: System, one: Description) -> Spline:
    """Return the spline of a description in a system that may hold its curve already."""
    entries = {(entry.name, entry.parameter): entry for entry in system.entries_of(one.channel)}
    entry = entries[one.entry.name, one.entry.parameter]
    spline = Spline(one.channel, entry, one.coordinate, len(one.places), one.period or 0.0)
    if not one.harmonics or one.period is None:
        return spline
    basis = waves.wave_basis(one.places, one.period, one.harmonics)
    factors = np.linalg.lstsq(basis, one.values + one.level, rcond=None)[0]
    return spline._replace(harmonics=one.harmonics, factors=tuple(factors.tolist()))


def _changed(curves: CurveFit, found: Fitted, index: int, one: Description) -> Description:
    places, change, covariance = curves.curve(found, index)
    values, spline = one.values + one.level + change, found.splines[index]
    if spline.harmonics:
        values, moved = waves.wave_moved(places, spline.period, np.array(spline.factors), change)
        spline = spline._replace(period=moved)
    own = curves.is_own(spline)
    values, shape, covariance, period, level = parts_of(places, values, covariance, own, spline)
    return replace(
        one, values=values, shape=shape, covariance=covariance, period=period, level=level, shape_of=None,
        harmonics=spline.harmonics,
    )  # fmt: skip


def _repeating(
    curves: CurveFit, system: System, chosen: Mapping[str, _Chosen], free: Sequence[str]
) -> list[_Chosen]:
    """Return what was chosen with waves in place of curves that repeat; one alone in the best channel."""
    most, found = (
        periodic.MOST_OF_FEW if system.changed is None else periodic.MOST_KNOTS,
        list(chosen.values()),
    )
    for k, one in enumerate(found):
        if len(one.splines) > 1:
            continue
        fixed, spline = _splines((*found[:k], *found[k + 1 :])), one.splines[0]
        before = curves.reduced(curves.fit((*fixed, spline)))
        wave = periodic.repeating(curves, fixed, spline, most)
        if wave is None:
            continue
        if wave.spline.harmonics and len(found) == 1:
            places = [(name, entry) for name in (spline.channel, *free) for entry in system.entries_of(name)]
            wave = periodic.best_placed(curves, fixed, wave, places)
        found[k] = one._replace(splines=(wave.spline,), share=one.share + wave.share - before)
    return found


class _Chosen(NamedTuple):
    """Splines of a channel, the share that they remove beside others, the next best signals."""

    splines: tuple[Spline, ...]
    share: float
    runner_up: tuple[str, float] | None


def own_signals(system: System, equation: Equation) -> set[str]:
    """Return the signals that an equation is about: what it predicts, the rates of that, its inputs."""
    states = {system.channel(channel).state for channel in equation.channels}
    rates = {rate for rate, of in system.derived.items() if of in states}
    return {*equation.channels, *rates, *system.needs.get(equation.name, ())}


def _terms(system: System, equation: Equation, channel: str, names: Sequence[str]) -> list[Term]:
    """Return what may enter a channel: a curve over any signal, or two over one of each of two actuators.

    What passes between actuators depends on both. A model holds one curve of each way to enter.
    """
    entries, inputs = system.entries_of(channel), system.needs.get(equation.name, ())
    found: list[Term] = [((channel, entry, name),) for entry in entries for name in names]
    for pair in (equation.channels, inputs):
        if len(pair) == len(equation.channels) == 2 and set(pair) <= set(names):
            ways = permutations(entries, 2)
            found += [((channel, one, pair[0]), (channel, other, pair[1])) for one, other in ways]
    return found


def _best(found: Sequence[tuple[float, tuple[Spline, ...]]], before: float, own: Collection[str]) -> _Chosen:
    """Return the term with the largest share, or one that comes near, over the equation's own signals."""

    def worth(one: tuple[float, tuple[Spline, ...]]) -> float:
        near = NEAR * all(spline.signal in own for spline in one[1])
        return one[0] + near - SIMPLER * (len(one[1]) - 1)

    share, splines = max(found, key=worth)
    over = _over(splines)
    others = [(_over(other), value - before) for value, other in found if _over(other) != over]
    return _Chosen(splines, share - before, max(others, key=lambda one: one[1], default=None))


def _over(splines: Sequence[Spline]) -> str:
    return " and ".join(spline.signal for spline in splines)


def _splines(chosen: Iterable[_Chosen]) -> tuple[Spline, ...]:
    return tuple(spline for one in chosen for spline in one.splines)


def _descriptions(curves: CurveFit, chosen: Collection[_Chosen]) -> tuple[Description, ...]:
    """Return the curves of some terms, fitted together; none if they remove too little."""
    found = curves.fit(_splines(chosen))
    whole, added = curves.reduced(found), sum(one.share for one in chosen)
    if whole < LEAST_REDUCED:
        return ()
    unit = whole / added
    parts = [
        (unit * one.share / len(one.splines), one.runner_up if len(one.splines) == 1 else None)
        for one in chosen
        for _ in one.splines
    ]
    return tuple(_description(curves, found, k, *part) for k, part in enumerate(parts))


def _description(
    curves: CurveFit, found: Fitted, index: int, share: float, runner_up: tuple[str, float] | None
) -> Description:
    spline = found.splines[index]
    places, values, covariance = curves.curve(found, index)
    parts = parts_of(places, values, covariance, curves.is_own(spline), spline)
    return Description(
        spline.channel, spline.entry, spline.signal, places, *parts[:3], share, runner_up, *parts[3:],
        beside=curves.moved(found), harmonics=spline.harmonics,
    )  # fmt: skip


def _compared(system: System, one: Description) -> Description:
    """Return a description that says which textbook effect has its shape."""
    kind = textbook.kind_of(system, one.channel, one.entry, one.coordinate)
    if kind is None or one.is_constant:
        return one
    unit = system.unit(one.coordinate)
    return replace(one, shape_of=textbook.shape_of(kind, one.places, one.shape, one.covariance, unit))


def _coordinates(groups: list[Problem]) -> list[str]:
    """Return the signals that all recordings have, and that judge mostly where they were fitted.

    A phase is no signal: each recording has its own. Of time a last quarter shows what was not fitted.
    """
    seen = [[signals_of(group.system, one) for one in group.scored] for group in groups]
    names = set.intersection(*(set(each) for many in seen for each in many)) - {"phase"}

    def fitted(name: str) -> bool:
        own, judging = (np.concatenate([each[name] for each in many]) for many in seen)
        return bool(np.mean((judging >= own.min()) & (judging <= own.max())) > MOSTLY)

    return sorted(name for name in names if fitted(name))


def holder(system: System, one: Description) -> tuple[str, str] | None:
    """Return what of the nominal model can hold a description, and the name there of its coordinate.

    None if nothing can, or if it holds an earlier one.
    """
    states = {channel.name: channel.state for channel in system.channels}
    coordinate = states.get(one.coordinate, one.coordinate)
    if not one.entry.held or coordinate is None:
        return None
    return one.entry.held, coordinate
