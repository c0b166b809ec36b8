# SPDX-License-Identifier: Apache-2.0
"""Curves over measured signals, fitted to what an equation leaves beside its free parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, scaled_slopes
from pam_orthosis.discrepancy.fitting.signals import hats, whole_signals
from pam_orthosis.discrepancy.replay.injection import Injection, injection
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.search.confirmation import LEAST_T, block_sums, t_value
from pam_orthosis.discrepancy.systems.system import Entry, Equation, System
from pam_orthosis.discrepancy.unknown.waves import wave_basis, wave_slope

KNOTS = (8, 20)  # of a curve: as few as held-out recordings allow
MORE_KNOTS = 60  # of one that a model of a user's own can hold
ENDS = (0.002, 0.998)  # quantiles of a signal between which its curve changes
BOUND = 5.0  # standard deviation of a curve's values, of the unknown's own
FREE = 1e3  # the same, of a wave, whose values are few
SIMPLER = 0.02  # of the share that a curve removes: what more knots, or a second curve, have to add
VISIBLE = 0.5  # squares over those of the noise: what more knots have to add where the gap is large
SLOW = 8.0  # Hz, below which the size of the unknown is looked at
FEW_BLOCKS_T = 2.0  # of the fall of held-out squares over blocks of time, where few hold most of it
TRANSFERRED = 0.5  # of the fall in training, that a curve has there then
FAR = 10.0  # tolerances that a parameter is moved: no curve needs that


Term: TypeAlias = tuple[tuple[str, Entry, str], ...]  # curves of a channel: each how it enters, over what


class Spline(NamedTuple):
    """A linear spline over a signal, and where it enters.

    `period`: after which it repeats, in the signal's unit, if that is known; `harmonics`: that it may have
    then, as values at its knots, which are as many as all of the signal needs; none: it is free. `factors`:
    of such a wave that a model has, whose period is fitted too.
    """

    channel: str
    entry: Entry
    signal: str
    knots: int
    period: float = 0.0
    harmonics: int = 0
    factors: tuple[float, ...] = ()


@dataclass(frozen=True)
class Fitted:
    """Free parameters and splines, fitted to the training recordings.

    Attributes:
        splines: that were fitted.
        able: of each spline, a matrix that leaves of values at its knots what they may be.
        step: of the free parameters, then of each spline's values in its unknown's own size.
        covariance: of these.
        left: whitened residuals, of the training and of the held-out recordings.
    """

    splines: tuple[Spline, ...]
    able: tuple[np.ndarray, ...]
    step: np.ndarray
    covariance: np.ndarray
    left: tuple[np.ndarray, np.ndarray]


def knots_of(system: System) -> tuple[int, ...]:
    """Return how many points the curves of a system may have, fewest first."""
    return KNOTS if system.changed is None else (*KNOTS, MORE_KNOTS)


class CurveFit:
    """Fits splines over signals to an equation's residuals beside the model's free parameters.

    Args:
        problem: recordings to fit.
        judge: recordings that choose.
        model: whose nuisance parameters and effects move with the splines.
        equation: that lacks something.
    """

    def __init__(self, problem: Problem, judge: Problem, model: Fit, equation: Equation):
        self._groups, self._model, self._equation = (problem, judge), model, equation
        names = tuple(one.name for one in model.free)
        blocks = [group.blocks(model.effects, model.values, names)[equation.name] for group in self._groups]
        self._residuals = [block.residual for block in blocks]
        self._slopes = [scaled_slopes(block, model.free) for block in blocks]
        self._weight = np.array([one.scale / one.sd for one in model.free])
        self._deviation = np.array([one.deviation(model.values) for one in model.free])
        self._signals = {
            one.run.serial: whole_signals(g.system, one) for g in self._groups for one in g.scored
        }
        self._linear: dict[tuple[int, str], Injection] = {}
        self._levers: dict[tuple[int, str, Entry], np.ndarray] = {}
        for group in self._groups:
            for one in group.scored:
                self._linearise(group, one)
        self._size = {(c, entry): self._size_of(c, entry) for _, c, entry in self._levers}
        self._without = self.fit(())
        self._knots = knots_of(problem.system)
        squares = self._without.left[1]
        over = float(squares @ squares) / len(squares) - 1
        self.simpler = min(SIMPLER, VISIBLE / over) if over > 0 else SIMPLER

    def _linearise(self, group: Problem, one: Scored) -> None:
        for channel in self._equation.channels:
            linear = injection(group.replay, one.run, self._equation, channel, self._model.values)
            if linear is None:
                continue
            self._linear[one.run.serial, channel] = linear
            for entry in group.system.entries_of(channel):
                found = lever(group, one, self._equation, channel, entry, linear)
                self._levers[one.run.serial, channel, entry] = found

    def best(self, fixed: tuple[Spline, ...], term: Term) -> tuple[float, tuple[Spline, ...]]:
        """Return the share that a term removes beside fixed splines, and its own: few knots do as well."""
        shares = []
        for knots in self._knots if len(term) == 1 else KNOTS[:1]:
            splines = tuple(Spline(*place, knots) for place in term)
            shares.append((self.reduced(self.fit((*fixed, *splines))), splines))
        most = max(share for share, _ in shares)
        return next(one for one in shares if one[0] > most - self.simpler)

    def reduced(self, found: Fitted) -> float:
        """Return the share of the held-out squares above the noise that splines remove.

        All else moves without them too: what it can follow is no unknown.
        """
        before, after = self._without.left[1], found.left[1]
        gap = float(before @ before) - len(before)
        return (float(before @ before) - float(after @ after)) / gap if gap > 0 else 0.0

    def confirmed(self, found: Fitted, fewer: Fitted) -> bool:
        """Return whether held-out recordings have what a further spline says, and not by chance.

        Their squares fall evenly over blocks of time; or, where few blocks hold most of it, nearly as much
        as those that were fitted.
        """
        seen, unseen = (
            block_sums(group, self._equation, before**2 - after**2)
            for group, before, after in zip(self._groups, fewer.left, found.left, strict=True)
        )
        t = t_value(unseen)
        return t > LEAST_T or (t > FEW_BLOCKS_T and unseen.mean() > TRANSFERRED * seen.mean())

    def curve(self, found: Fitted, index: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the knots of a spline, its values there, and their covariance."""
        spline, able = found.splines[index], found.able[index]
        first = len(self._weight) + sum(one.shape[1] for one in found.able[:index])
        own = slice(first, first + able.shape[1])
        scale = self._size[spline.channel, spline.entry]
        values, spread = able @ found.step[own], able @ self._spread(found)[own, own] @ able.T
        return self._places(spline), scale * values, scale**2 * spread

    def _spread(self, found: Fitted) -> np.ndarray:
        """Return the covariance of a fit, as wide as what it leaves, and blocks of time that disagree, ask.

        What is left may be no noise, but an error of the form.
        """
        slopes, place = self._slopes[0]
        columns, left = self._columns(0, found.splines, found.able), found.left[0]
        rows = np.zeros((len(found.step), len(left)))
        rows[place], rows[len(self._weight) :] = slopes, columns.T
        with np.errstate(over="ignore", invalid="ignore"):  # as in `_fitted`
            sums = [block_sums(self._groups[0], self._equation, row * left) for row in rows]
            moved = np.sum((found.covariance @ np.array(sums)) ** 2, axis=1)
            times = moved / np.maximum(np.diag(found.covariance), 1e-300)
            wider = np.sqrt(np.maximum(times, max(1.0, float(left @ left) / max(len(left) - len(rows), 1))))
            spread: np.ndarray = found.covariance * np.outer(wider, wider)
        return spread

    def moved(self, found: Fitted) -> dict[str, float]:
        """Return the model's free parameters where a fit has them, inside their bounds."""
        moved = {
            one.name: self._model.values[one.name] + float(step) * one.scale
            for one, step in zip(self._model.free, found.step, strict=False)
        }
        return {one.name: min(max(moved[one.name], one.lower), one.upper) for one in self._model.free}

    def fit(self, splines: tuple[Spline, ...]) -> Fitted:
        """Return splines beside the free parameters.

        A parabola over the recording of what the equation itself predicts, and parameters that undo it in
        the model, are together a gain by which the replay follows the recording, whatever is missing. A
        curve over its rate has none, nor has one over itself that would move parameters far.
        """
        own = [one.signal == one.channel for one in splines]
        flat = [one.signal in self._rates(one.channel) for one in splines]
        found = self._fitted(splines, flat)
        moved = np.abs(self._deviation + self._weight * found.step[: len(self._weight)])
        if any(own) and max(moved, default=0.0) > FAR:
            found = self._fitted(splines, [a or b for a, b in zip(own, flat, strict=True)])
        return found

    def is_own(self, spline: Spline) -> bool:
        """Whether a spline is over what its equation predicts, or over the rate of that."""
        return spline.signal == spline.channel or spline.signal in self._rates(spline.channel)

    def _rates(self, channel: str) -> set[str]:
        system = self._groups[0].system
        return {rate for rate, of in system.derived.items() if of == system.channel(channel).state}

    def _fitted(self, splines: tuple[Spline, ...], flat: Sequence[bool]) -> Fitted:
        able = tuple(self._able(one, no) for one, no in zip(splines, flat, strict=True))
        (slopes, place), count = self._slopes[0], len(self._weight)
        columns = [self._columns(of, splines, able) for of in range(2)]
        knots = columns[0].shape[1]
        matrix = np.vstack([slopes, columns[0].T])
        where = np.concatenate([place, count + np.arange(knots)])
        bounds = [
            np.full(one.shape[1], FREE if s.harmonics else BOUND)
            for one, s in zip(able, splines, strict=True)
        ]
        weight = np.concatenate([self._weight, *[1 / bound for bound in bounds]])
        hessian = np.diag(weight**2 + 1e-12)
        gradient = np.concatenate([self._weight * self._deviation, np.zeros(knots)])
        with np.errstate(over="ignore", invalid="ignore"):
            hessian[np.ix_(where, where)] += matrix @ matrix.T
            gradient[where] += matrix @ self._residuals[0]
        if not np.isfinite(hessian).all():  # derivatives ran away: nothing can be told from them
            hessian, gradient = np.diag(weight**2), np.zeros(len(weight))
        covariance = np.linalg.pinv(hessian, hermitian=True)
        step = -covariance @ gradient
        left = [
            residual + slopes.T @ step[place] + own @ step[count:]
            for residual, (slopes, place), own in zip(self._residuals, self._slopes, columns, strict=True)
        ]
        return Fitted(splines, able, step, covariance, (left[0], left[1]))

    def _columns(self, of: int, splines: tuple[Spline, ...], able: tuple[np.ndarray, ...]) -> np.ndarray:
        """Return what each knot of splines, of the unknowns' own sizes, changes in a group's residuals."""
        own = [self._column(self._groups[of], *both) for both in zip(splines, able, strict=True)]
        return np.hstack([np.zeros((len(self._residuals[of]), 0)), *own])

    def _column(self, group: Problem, spline: Spline, able: np.ndarray) -> np.ndarray:
        channel, entry = spline.channel, spline.entry
        size, rows = self._size[channel, entry], []
        for one in group.scored:
            signal = self._signals[one.run.serial][spline.signal]
            parts = size * np.column_stack(hats(signal, *self.ends(spline), spline.knots)) @ able
            acting = parts * self._levers[one.run.serial, channel, entry][:, None]
            changed = self._linear[one.run.serial, channel].response(acting)
            for other in self._equation.channels:
                felt = changed.get(other)
                rows.append(one.white(other, -changed[channel] * 0.0 if felt is None else -felt))
        return np.vstack(rows)

    def ends(self, spline: Spline) -> tuple[float, float]:
        """Return the first and the last knot of a spline: what repeats goes on where little was fitted."""
        repeats = spline.harmonics > 0
        seen = [one for group in self._groups[: 1 + repeats] for one in group.scored]
        values = np.concatenate([self._signals[one.run.serial][spline.signal][one.warm_up :] for one in seen])
        low, high = np.quantile(values, (0.0, 1.0) if repeats else ENDS)
        return float(low), float(high)

    def _places(self, spline: Spline) -> np.ndarray:
        return np.linspace(*self.ends(spline), spline.knots)

    def _able(self, spline: Spline, flat: bool) -> np.ndarray:
        if spline.harmonics:
            basis = wave_basis(self._places(spline), spline.period, spline.harmonics)
            known = np.array(spline.factors)
            slope = wave_slope(self._places(spline), spline.period, known)
            return np.hstack([basis, slope]) if len(known) else basis
        knots = spline.knots
        return without_parabola(np.linspace(0.0, 1.0, knots), np.ones(knots)) if flat else np.eye(knots)

    def _size_of(self, channel: str, entry: Entry) -> float:
        """Return the size of the unknown, root mean square, in the training recordings."""
        group = self._groups[0]
        missing, levers = [], []
        for one in group.scored:
            linear, model = self._linear[one.run.serial, channel], self._model
            raw = group.replay.residuals(one.run, self._equation, model.effects, model.values)
            missing.append(np.mean(linear.added(raw, SLOW)[one.warm_up :] ** 2))
            levers.append(np.mean(self._levers[one.run.serial, channel, entry][one.warm_up :] ** 2))
        return float(np.sqrt(np.mean(missing) / max(float(np.mean(levers)), 1e-300)))


def lever(
    group: Problem, one: Scored, equation: Equation, channel: str, entry: Entry, linear: Injection
) -> np.ndarray:
    """Return what one unit of what enters makes of the rate, (n,)."""
    if not entry.parameter:
        return np.ones(one.run.recording.samples)
    effects = tuple(name for name in (entry.parameter.partition(".")[0],) if name in group.system.catalogue)
    values = group.replay.defaults(effects)
    neutral = [q.neutral for name in effects for q in group.system.catalogue[name].parameters[:1]]
    start = neutral[0] if neutral and neutral[0] is not None else 0.0
    seen = [
        group.replay.residuals(one.run, equation, effects, {**values, entry.parameter: start + change})
        for change in (0.0, entry.size)
    ]
    return linear.added(seen[0] - seen[1]) / entry.size


def without_parabola(places: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Return the matrix that takes the best parabola, by weights, from values at places."""
    along = (places - places.mean()) / np.ptp(places)
    base = np.column_stack([np.ones_like(along), along, along**2])
    fit: np.ndarray = np.linalg.solve(base.T @ (weight[:, None] * base), base.T * weight)
    without: np.ndarray = np.eye(len(places)) - base @ fit
    return without
