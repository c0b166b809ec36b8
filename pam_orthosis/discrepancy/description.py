# SPDX-License-Identifier: Apache-2.0
"""The unknown, described: what the catalogue does not explain, as a curve over one measured signal.

A linear spline over a signal is added to an equation, the nuisance parameters move beside it, and training
recordings fit it; the signal whose curve reduces the held-out gap most is given. A description is no cause.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.confirmation import LEAST_T, block_sums
from pam_orthosis.discrepancy.fit import Fit, scaled_slopes
from pam_orthosis.discrepancy.injection import Injection, injection
from pam_orthosis.discrepancy.problem import Problem, Scored
from pam_orthosis.discrepancy.structure import signals_of
from pam_orthosis.discrepancy.system import Equation, System

KNOTS = (8, 20)  # of a curve: as few as held-out recordings allow
ENDS = (0.002, 0.998)  # quantiles of a signal between which its curve changes
BOUND = 5.0  # standard deviation of a curve's values, of the unknown's own
LEAST_REDUCED = 0.5  # share of the held-out gap that a description removes, at least
SIMPLER = 0.02  # of that share: what more knots have to add
CYCLES, FITS = 1.8, 0.7  # a curve is periodic if so many waves are in its range and explain so much of it
SLOW = 8.0  # Hz, below which the size of the unknown is looked at
FAR = 10.0  # tolerances that a parameter is moved: no curve needs that
UNSURE = 3.0  # times the median standard deviation: places that were hardly visited
ROUNDING = 1e-9  # of a curve's squares: what is smaller is a line
QUANTILE = 1.96  # two-sided 95 % of a normal distribution


@dataclass(frozen=True)
class Description:
    """What is unknown in an equation, as a function of one signal.

    Attributes:
        equation, channel: where it is added.
        coordinate: the signal that it depends on.
        places, values: knots and what is added there.
        shape, covariance: the same without a parabola, which nuisance parameters may have taken or given.
        unit: of these: what `System.pushes` names, or that of the rate which is missing.
        reduced: share of the held-out gap of its equation, above the noise, that it removes.
        runner_up: the next best signal and its share.
        period: of the curve, in the signal's unit, if it is a wave.
    """

    equation: str
    channel: str
    coordinate: str
    places: np.ndarray
    values: np.ndarray
    shape: np.ndarray
    covariance: np.ndarray
    unit: str
    reduced: float
    runner_up: tuple[str, float] | None
    period: float | None

    @property
    def amplitude(self) -> tuple[float, float, float]:
        """Half the range of the shape, with its 95 % interval."""
        sure = self.spread <= UNSURE * np.median(self.spread)
        shown = np.where(sure, self.shape, np.nan)
        top, bottom = int(np.nanargmax(shown)), int(np.nanargmin(shown))
        size = 0.5 * float(self.shape[top] - self.shape[bottom])
        contrast = self.covariance[top] - self.covariance[bottom]
        half = 0.5 * QUANTILE * float(np.sqrt(max(contrast[top] - contrast[bottom], 0.0)))
        return size, size - half, size + half

    @property
    def spread(self) -> np.ndarray:
        """The standard deviations of the shape."""
        spread: np.ndarray = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return spread


def described(problem: Problem, judge: Problem, model: Fit, equation: Equation) -> Description | None:
    """Return the best description of what a model lacks in an equation; None if there is none.

    Args:
        problem: recordings to fit.
        judge: recordings that choose.
        model: whose nuisance parameters and effects move with the curve.
    """
    groups = [group.weighted(dict.fromkeys(group.weights, 1.0)) for group in (problem, judge)]
    system = problem.system
    found: dict[tuple[str, str], tuple[float, int]] = {}
    fitting = _Fitting(groups[0], groups[1], model, equation)
    for channel in equation.channels:
        if system.channel(channel).state is None:
            continue
        names = _coordinates(groups)
        best = problem.replay.workers.together(partial(fitting.best, channel), names)
        found |= {(channel, name): one for name, one in zip(names, best, strict=True)}
    order = sorted(found, key=lambda key: -found[key][0])
    if not order or found[order[0]][0] < LEAST_REDUCED:
        return None
    channel, name = order[0]
    share, knots = found[order[0]]
    if fitting.t(channel, name, knots) < LEAST_T:  # a part of the held-out recordings has it, by chance
        return None
    others = [(key[1], found[key][0]) for key in order if key[1] != name]
    places, values, covariance = fitting.curve(channel, name, knots)
    bend = _without_parabola(places, 1 / np.maximum(np.diag(covariance), 1e-300))
    shape = bend @ values
    return Description(
        equation.name, channel, name, places, values, shape, bend @ covariance @ bend.T,
        unit_of(system, channel), share, others[0] if others else None, wave_period(places, shape),
    )  # fmt: skip


def _without_parabola(places: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the matrix that takes the best parabola, by weights, from values at places."""
    along = (places - places.mean()) / np.ptp(places)
    base = np.column_stack([np.ones_like(along), along, along**2])
    fit: np.ndarray = np.linalg.solve(base.T @ (weight[:, None] * base), base.T * weight)
    without: np.ndarray = np.eye(len(places)) - base @ fit
    return without


def _coordinates(groups: list[Problem]) -> list[str]:
    """Return the signals that all recordings have. A phase is no signal: each recording has its own."""
    known = [set(signals_of(group.system, one)) for group in groups for one in group.scored]
    return sorted(set.intersection(*known) - {"phase"})


class _Solved(NamedTuple):
    """Free parameters and a curve, its columns in both groups, and what leaves of values what it may be."""

    step: np.ndarray
    covariance: np.ndarray
    columns: list[np.ndarray]
    able: np.ndarray


class _Fitting:
    """Curves over signals, fitted to an equation's residuals beside the model's free parameters."""

    def __init__(self, problem: Problem, judge: Problem, model: Fit, equation: Equation):
        self._groups, self._model, self._equation = (problem, judge), model, equation
        names = tuple(one.name for one in model.free)
        blocks = [group.blocks(model.effects, model.values, names)[equation.name] for group in self._groups]
        self._residuals = [block.residual for block in blocks]
        self._slopes = [scaled_slopes(block, model.free) for block in blocks]
        weight = np.array([one.scale / one.sd for one in model.free])
        self._weight, self._count = weight, len(weight)
        self._deviation = np.array([one.deviation(model.values) for one in model.free])
        self._solved: dict[tuple[str, str, int], _Solved] = {}
        self._linear = {
            (one.run.serial, channel): injection(group.replay, one.run, equation, channel, model.values)
            for group in self._groups
            for one in group.scored
            for channel in equation.channels
        }

        self._levers = {
            (serial, channel): lever(group, one, equation, channel, linear)
            for group in self._groups
            for one in group.scored
            for (serial, channel), linear in self._linear.items()
            if serial == one.run.serial and linear is not None
        }

    def best(self, channel: str, name: str) -> tuple[float, int]:
        """Return the share that a curve removes, see `reduced`, and its knots: few do nearly as well."""
        shares = [(self.reduced(channel, name, knots), knots) for knots in KNOTS]
        return next(one for one in shares if one[0] > max(shares)[0] - SIMPLER)

    def reduced(self, channel: str, name: str, knots: int) -> float:
        """Return the share of the held-out squares above the noise that a curve removes."""
        before, after = self._judged(channel, name, knots)
        gap = float(before @ before) - len(before)
        return (float(before @ before) - float(after @ after)) / gap if gap > 0 else 0.0

    def _judged(self, channel: str, name: str, knots: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the held-out residuals without a curve and with it; all else moves in both."""
        step, _, columns, _ = self._solve(channel, name, knots)
        slopes, place = self._slopes[1]
        residual = self._residuals[1]
        before = residual + slopes.T @ self._alone()[place]
        return before, residual + slopes.T @ step[place] + columns[1] @ step[self._count :]

    def _alone(self) -> np.ndarray:
        """Return the step of the free parameters without a curve: what they can follow is no unknown."""
        slopes, place = self._slopes[0]
        hessian, gradient = np.diag(self._weight**2 + 1e-12), self._weight * self._deviation
        hessian[np.ix_(place, place)] += slopes @ slopes.T
        gradient[place] += slopes @ self._residuals[0]
        step: np.ndarray = -np.linalg.pinv(hessian, hermitian=True) @ gradient
        return step

    def t(self, channel: str, name: str, knots: int) -> float:
        """Return the t value of the fall of the held-out squares, over blocks of time."""
        before, after = self._judged(channel, name, knots)
        falls = block_sums(self._groups[1], self._equation, before**2 - after**2)
        spread = falls.std(ddof=1) / np.sqrt(len(falls)) if len(falls) > 1 else np.inf
        return float(falls.mean() / max(spread, 1e-12))

    def curve(self, channel: str, name: str, knots: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the knots, the curve there, and its covariance."""
        step, covariance, _, able = self._solve(channel, name, knots)
        scale, own = self._size(channel), slice(self._count, None)
        values, spread = able @ step[own], able @ covariance[own, own] @ able.T
        return np.linspace(*self._ends(name), knots), scale * values, scale**2 * spread

    def _solve(self, channel: str, name: str, knots: int) -> _Solved:
        """Return a curve over a signal beside the free parameters.

        A parabola over the recording of what the equation itself predicts, and parameters that undo it in
        the model, are together a gain by which the replay follows the recording, whatever is missing. A
        curve over its rate has none, nor has one over itself that would move parameters far.
        """
        key = channel, name, knots
        if key not in self._solved:
            system = self._groups[0].system
            state = system.channel(channel).state
            rates = {rate for rate, of in system.derived.items() if of == state}
            bent, flat = np.eye(knots), _without_parabola(np.linspace(0.0, 1.0, knots), np.ones(knots))
            found = self._solved_with(channel, name, flat if name in rates else bent)
            moved = np.abs(self._deviation + self._weight * found.step[: self._count])
            if name == channel and max(moved, default=0.0) > FAR:
                found = self._solved_with(channel, name, flat)
            self._solved[key] = found
        return self._solved[key]

    def _solved_with(self, channel: str, name: str, able: np.ndarray) -> _Solved:
        knots = len(able)
        columns = [self._columns(group, channel, name, able) for group in self._groups]
        slopes, place = self._slopes[0]
        matrix = np.vstack([slopes, columns[0].T])
        where = np.concatenate([place, self._count + np.arange(knots)])
        weight = np.concatenate([self._weight, np.full(knots, 1 / BOUND)])
        hessian = np.diag(weight**2 + 1e-12)
        gradient = np.concatenate([self._weight * self._deviation, np.zeros(knots)])
        hessian[np.ix_(where, where)] += matrix @ matrix.T
        gradient[where] += matrix @ self._residuals[0]
        covariance = np.linalg.pinv(hessian, hermitian=True)
        return _Solved(-covariance @ gradient, covariance, columns, able)

    def _columns(self, group: Problem, channel: str, name: str, able: np.ndarray) -> np.ndarray:
        """Return what each knot of a curve, of the unknown's own size, changes in the row of residuals."""
        size, knots, rows = self._size(channel), len(able), []
        for one in group.scored:
            linear = self._linear[one.run.serial, channel]
            assert linear is not None
            signal = whole_signal(group, one, name)
            parts = size * np.column_stack(hats(signal, *self._ends(name), knots)) @ able
            changed = linear.response(parts * self._levers[one.run.serial, channel][:, None])
            for other in self._equation.channels:
                white = one.white(other, -changed)
                rows.append(white if other == channel else 0.0 * white)
        return np.vstack(rows)

    def _ends(self, name: str) -> tuple[float, float]:
        group = self._groups[0]
        values = np.concatenate([signals_of(group.system, one)[name] for one in group.scored])
        low, high = np.quantile(values, ENDS)
        return float(low), float(high)

    def _size(self, channel: str) -> float:
        """Return the root mean square of the rate that the training recordings lack."""
        group, index = self._groups[0], self._equation.channels.index(channel)
        squares = []
        for one in group.scored:
            linear, model = self._linear[one.run.serial, channel], self._model
            assert linear is not None
            raw = group.replay.residuals(one.run, self._equation, model.effects, model.values)[:, index]
            unknown = linear.added(raw, SLOW) / self._levers[one.run.serial, channel]
            squares.append(np.mean(unknown[one.warm_up :] ** 2))
        return float(np.sqrt(np.mean(squares)))


def unit_of(system: System, channel: str) -> str:
    """Return the unit in which what is added to a channel's equation is given."""
    if push := system.push(channel):
        effect, parameter = push
        return next(q.unit for q in system.catalogue[effect].parameters if q.name == parameter)
    known = system.channel(channel)
    return f"{known.unit}/s" + ("^2" if known.state in system.derived.values() else "")


def holder(system: System, one: Description) -> tuple[str, str] | None:
    """Return what of the nominal model can hold a description, and the name there of its coordinate.

    None if nothing can, or if it holds an earlier one.
    """
    name = system.described.get(one.channel, "")
    separate = system.push(one.channel) is not None or one.channel != system.channels[0].name
    states = {channel.name: channel.state for channel in system.channels}
    coordinate = states.get(one.coordinate, one.coordinate)
    if not name or name in system.simpler or not separate or coordinate is None:
        return None
    return name, coordinate


def lever(group: Problem, one: Scored, equation: Equation, channel: str, linear: Injection) -> np.ndarray:
    """Return what one unit of what is added makes of the rate, (n,)."""
    push = group.system.push(channel)
    if push is None:
        return np.ones(one.run.recording.samples)
    effect, parameter = push
    index, values = equation.channels.index(channel), group.replay.defaults((effect,))
    seen = [
        group.replay.residuals(one.run, equation, (effect,), {**values, f"{effect}.{parameter}": size})
        for size in (0.0, 1.0)
    ]
    return linear.added((seen[0] - seen[1])[:, index], SLOW)


def whole_signal(group: Problem, one: Scored, name: str) -> np.ndarray:
    """Return a signal of a run, its warm-up filled with the first value that counts."""
    values = signals_of(group.system, one)[name]
    whole: np.ndarray = np.concatenate([np.full(one.warm_up, values[0]), values])
    return whole


def hats(values: np.ndarray, low: float, high: float, knots: int) -> list[np.ndarray]:
    """Return linear splines of values at knots between two ends: each is 1 at its own."""
    place = np.clip((values - low) / max(high - low, 1e-300), 0.0, 1.0) * (knots - 1)
    return [np.maximum(1 - np.abs(place - k), 0.0) for k in range(knots)]


def wave_period(places: np.ndarray, curve: np.ndarray) -> float | None:
    """Return the period of a curve that is a wave about a line; None if it is none, or too coarsely known."""
    width = float(places[-1] - places[0])
    if width <= 0:
        return None
    line = np.column_stack([np.ones_like(places), places])
    flat = curve - line @ np.linalg.lstsq(line, curve, rcond=None)[0]
    best: Mapping[float, float] = {
        period: _explained(places, curve, line, period)
        for period in width / np.arange(CYCLES, len(places) / 3, 0.05)
    }
    if not best or not float(flat @ flat) > ROUNDING * float(curve @ curve):
        return None
    period = max(best, key=lambda one: best[one])
    return float(period) if best[period] > FITS else None


def _explained(places: np.ndarray, curve: np.ndarray, line: np.ndarray, period: float) -> float:
    """Return the share of a curve, beside a line, that a wave of some period explains."""
    angle = 2 * np.pi * places / period
    waves = np.column_stack([line, np.sin(angle), np.cos(angle)])
    rest = [curve - m @ np.linalg.lstsq(m, curve, rcond=None)[0] for m in (line, waves)]
    return 1 - float(rest[1] @ rest[1]) / float(rest[0] @ rest[0])
