# SPDX-License-Identifier: Apache-2.0
"""Candidates: each effect of the catalogue tried as part of the model, ordinary parameters beside it.

The ordinary parameters enter linearly at the present fit (variable projection): a candidate simulates
its own few parameters only. Large effects leave the range in which that is true; `fit.fit` polishes
the best ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import find_peaks

from pam_orthosis.discrepancy.fit import WIDE, Fit, Problem, bounded_step, of_effect, with_scales

DIFFERENCE = 0.01  # of a parameter's scale
COARSE = 0.1  # the same where a finer one gave no way down: an event of the model may jump within it
PROMISED = 0.5  # of the score test's gain: a fit that finds less is tried with coarse differences
MOST_STEPS = 8
TRIES = 4  # of a step, ever shorter
QUARTERS = (0.0, 1.57, 3.14, -1.57)  # rad: phases at which a periodic effect starts
LOWEST_PEAK, HIGHEST_PEAK, MOST_PEAKS = 0.1, 20.0, 3  # Hz: where its frequency is looked for
NEAR = 0.01  # of the way from the off value to the typical one
ENOUGH = 0.5
SHAPE_SCALES = (0.05, 0.3, 1.0)  # of the shape corrections' priors: how good may the maps be?
SHAPE_WIDTHS = (2.0, 4.0, 8.0, 16.0)  # multiples of a shape correction's priors
SMALL_SHARE = 1e-3  # of the gain: what a further step must bring


@dataclass(frozen=True)
class Candidate:
    """An effect fitted beside the present model.

    Attributes:
        name: of the effect.
        gain: by how much the cost falls.
        values: all parameters, ordinary ones as the projection says.
        evidence: gain less what its parameters cost.
        scales: of the shape corrections' priors that go with it.
    """

    name: str
    gain: float
    values: Mapping[str, float]
    evidence: float
    scales: Mapping[str, float]


@dataclass(frozen=True)
class Level:
    """One assumption on how far the shape corrections may go: scales of their priors.

    Attributes:
        scales: shape -> multiple of its priors.
        weight, centre: inverse standard deviations and means of the scaled parameters.
        factor: Cholesky factor of the Hessian.
        occam: what the assumption costs: twice the log of the ratio of prior and posterior volumes.
    """

    scales: Mapping[str, float]
    weight: np.ndarray
    centre: np.ndarray
    factor: tuple
    occam: float

    def gradient(self, position: np.ndarray) -> np.ndarray:
        """Return the priors' gradient at scaled ordinary parameters."""
        return self.weight**2 * (position - self.centre)

    def cost(self, position: np.ndarray) -> float:
        """Return what the priors cost there."""
        return float(np.sum((self.weight * (position - self.centre)) ** 2))

    def solve(self, columns: np.ndarray) -> np.ndarray:
        """Return the inverse Hessian times columns."""
        return cho_solve(self.factor, columns)


class Projection:
    """The present fit with its ordinary parameters free to follow, linearly.

    How good the static maps are is not known beforehand: each evaluation takes the level of the shape
    corrections' priors that has the largest marginal likelihood (empirical Bayes).
    """

    def __init__(self, problem: Problem, base: Fit):
        self.problem, self.base = problem, base
        self._index = {one.name: i for i, one in enumerate(base.free)}
        self._scale = np.array([one.scale for one in base.free])
        self.position = np.array([base.values[one.name] / one.scale for one in base.free])
        self._matrices = {name: self._scaled(block) for name, block in base.blocks.items()}
        self._squares = {name: float(np.sum(b.residual**2)) for name, b in base.blocks.items()}
        self._unchanged = {name: self.correlated(name, b.residual) for name, b in base.blocks.items()}
        self._data_hessian = np.zeros((len(self._scale), len(self._scale)))
        for matrix, place in self._matrices.values():
            self._data_hessian[np.ix_(place, place)] += matrix @ matrix.T
        self.levels = [self.level(scales) for scales in self._assumptions()]
        self.floor = self.cost({})

    def _assumptions(self) -> list[dict[str, float]]:
        """Return combinations of scales of the shape corrections that matter; named ones are wide."""
        system, replay = self.problem.system, self.problem.replay
        shapes = [name for name in system.shapes if replay.touched(name)]
        options = [(WIDE,) if name in self.base.effects else SHAPE_SCALES for name in shapes]
        return [dict(zip(shapes, chosen, strict=True)) for chosen in product(*options)]

    def level(self, scales: Mapping[str, float]) -> Level:
        """Return what the scales of the shape corrections' priors make of the base."""
        own = with_scales(self.problem.system, self.base.free, scales)
        weight = np.array([one.scale / one.sd for one in own])
        centre = np.array([one.centre / one.scale for one in own])
        hessian = self._data_hessian + np.diag(weight**2)
        factor = cho_factor(hessian + 1e-9 * np.diag(np.diag(hessian)))
        occam = 2 * float(np.sum(np.log(np.diag(factor[0])))) - _log_weights(weight)
        return Level(scales, weight, centre, factor, occam)

    def correlated(self, equation: str, columns: np.ndarray) -> np.ndarray:
        """Return J^T columns in the scaled ordinary parameters."""
        matrix, place = self._matrices[equation]
        out = np.zeros((len(self._scale), *columns.shape[1:]))
        out[place] = matrix @ columns
        return out

    def _scaled(self, block) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives by the scaled ordinary parameters, transposed, and their places."""
        kept = [i for i, name in enumerate(block.names) if name in self._index]
        place = np.array([self._index[block.names[i]] for i in kept], dtype=int)
        return np.ascontiguousarray((block.slopes[:, kept] * self._scale[place]).T), place

    def stuck(self, level: Level) -> np.ndarray:
        """Return the gradient that the base's own fit could not follow to its end.

        Where friction sticks the way down that it shows is not there.
        """
        return self.state({})[0] + level.gradient(self.position)

    def cost(self, residuals: Mapping[str, np.ndarray]) -> float:
        """Return the least cost over ordinary parameters and levels, given residuals of changed equations."""
        return self.best(*self.state(residuals))[0]

    def best(self, right: np.ndarray, squares: float, position: np.ndarray | None = None):
        """Return the least cost (with what its level costs) and the level.

        `position`: the scaled ordinary parameters at which the residuals were got (those of the base).
        """
        found = [(self.cost_at(level, right, squares, position), level) for level in self.levels]
        return min(found, key=lambda pair: pair[0])

    def cost_at(self, level: Level, right: np.ndarray, squares: float, position=None) -> float:
        """Return the least cost over the ordinary parameters at one level."""
        position = self.position if position is None else position
        total = right + level.gradient(position)
        return squares + level.cost(position) - float(total @ level.solve(total)) + level.occam

    def state(self, residuals: Mapping[str, np.ndarray]) -> tuple[np.ndarray, float]:
        """Return the data's gradient by the ordinary parameters and the sum of squares."""
        right, squares = np.zeros(len(self._scale)), 0.0
        for name in self.base.blocks:
            if name in residuals:
                squares += float(residuals[name] @ residuals[name])
                right += self.correlated(name, residuals[name])
            else:
                squares += self._squares[name]
                right += self._unchanged[name]
        return right, squares

    def values(self, position: np.ndarray) -> dict[str, float]:
        """Return the ordinary parameters at a scaled position."""
        return {one.name: float(x * one.scale) for one, x in zip(self.base.free, position, strict=True)}


def _log_weights(weight: np.ndarray) -> float:
    """Return the log determinant of the priors that there are."""
    return 2 * float(np.sum(np.log(weight[weight > 0])))


class Trial:
    """One effect beside the present model: residuals by its parameters, everything else projected."""

    def __init__(self, projection: Projection, name: str):
        problem = projection.problem
        self.projection, self.name = projection, name
        self.effects = (*projection.base.effects, name)
        lags = problem.system.catalogue[name].advance is not None
        touched = problem.replay.touched(name)
        self.equations = [e for e in problem.system.equations if lags or e.name in touched]
        self.free = of_effect(problem.system, name)
        self.scale = np.array([one.scale for one in self.free])
        typical = problem.replay.defaults((name,))
        self._rest = {key: value for key, value in typical.items() if key.startswith(f"{name}.")}

    def values(self, position: np.ndarray, ordinary: np.ndarray | None = None) -> dict[str, float]:
        """Return all parameters at scaled positions of its own and of the ordinary ones (of the base)."""
        own = {one.name: float(x * s) for one, x, s in zip(self.free, position, self.scale, strict=True)}
        rest = {} if ordinary is None else self.projection.values(ordinary)
        return {**self.projection.base.values, **rest, **self._rest, **own}

    def residuals(self, position: np.ndarray, ordinary: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return whitened residuals: of the equations that change."""
        values, problem = self.values(position, ordinary), self.projection.problem
        equations = self.equations if ordinary is None else problem.system.equations
        with np.errstate(all="ignore"):
            return {e.name: problem.residual(e, self.effects, values) for e in equations}

    def starts(self) -> list[np.ndarray]:
        """Return the scaled start positions: typical values and the effect's other starts."""
        effect = self.projection.problem.system.catalogue[self.name]
        first = {q.name: q.typical for q in effect.fitted}
        positions = [first, *({**first, **other} for other in effect.starts)]
        if "frequency" in first and any(q.unit == "Hz" for q in effect.fitted):
            positions += [{**first, "frequency": f, "phase": phi} for f in self._peaks() for phi in QUARTERS]
        size = effect.fitted[0]
        if size.neutral is not None and not effect.states:
            # a signature near the off value too: far from it what resembles an ordinary parameter bends
            near = size.neutral + NEAR * (size.typical - size.neutral)
            positions.append({**first, size.name: near})
        return [np.array([p[q.name] for q in effect.fitted]) / self.scale for p in positions]

    def _peaks(self) -> list[float]:
        """Return the frequencies, Hz, at which the residuals of its equations are largest."""
        problem, found = self.projection.problem, []
        for equation in self.equations:
            one = max(problem.scored, key=lambda scored: scored.run.recording.samples)
            values = self.projection.base.values
            raw = problem.replay.residuals(one.run, equation, self.projection.base.effects, values)[:, 0]
            white = one.white(equation.channels[0], raw)
            power = np.abs(np.fft.rfft(white * np.hanning(len(white)), 4 * len(white))) ** 2
            frequency = np.fft.rfftfreq(4 * len(white), one.run.period)
            inside = (frequency > LOWEST_PEAK) & (frequency < HIGHEST_PEAK)
            peaks = find_peaks(np.where(inside, power, 0.0))[0]
            found += frequency[peaks[np.argsort(power[peaks])[::-1][:MOST_PEAKS]]].tolist()
        return found

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the scaled bounds."""
        return (
            np.array([one.lower for one in self.free]) / self.scale,
            np.array([one.upper for one in self.free]) / self.scale,
        )


def secant_gain(projection: Projection, trial: Trial, position: np.ndarray) -> float:
    """Return how far the cost would fall if the effect's signature at a position could be scaled at will.

    A score test with a finite step: it works for effects that have no slope at their off value. Where
    the signature cannot be negative, neither can the scale.
    """
    residuals = trial.residuals(position)
    base = projection.base.blocks
    if not all(np.isfinite(r).all() for r in residuals.values()):
        return 0.0
    signature = {name: row - base[name].residual for name, row in residuals.items()}
    right, squares = projection.state({})
    shared = sum(projection.correlated(name, d) for name, d in signature.items())
    slope = sum(float(d @ base[name].residual) for name, d in signature.items())
    curvature = sum(float(d @ d) for d in signature.values())
    two_sided = _two_sided(projection, trial)
    costs = []
    for level in projection.levels:
        along = slope - float(shared @ level.solve(right + level.gradient(projection.position)))
        bent = curvature - float(shared @ level.solve(shared))
        gain = along**2 / bent if bent > 0 and (along < 0 or two_sided) else 0.0
        costs.append(projection.cost_at(level, right, squares) - gain)
    return projection.floor - min(costs)


def _two_sided(projection: Projection, trial: Trial) -> bool:
    size = projection.problem.system.catalogue[trial.name].fitted[0]
    return size.neutral is not None and size.minimum < size.neutral < size.maximum


@dataclass(frozen=True)
class Point:
    """A trial at scaled positions of its own and of the ordinary parameters."""

    own: np.ndarray
    ordinary: np.ndarray
    residuals: Mapping[str, np.ndarray]
    right: np.ndarray
    level: Level
    cost: float


def _point(projection: Projection, trial: Trial, own: np.ndarray, ordinary: np.ndarray) -> Point:
    residuals = trial.residuals(own, ordinary)
    if not all(np.isfinite(row).all() for row in residuals.values()):
        return Point(own, ordinary, residuals, ordinary, projection.levels[0], math.inf)
    right, squares = projection.state(residuals)
    cost, level = projection.best(right, squares, ordinary)
    return Point(own, ordinary, residuals, right, level, cost)


def refine(projection: Projection, trial: Trial, start: np.ndarray, difference: float = DIFFERENCE) -> Point:
    """Return the trial with the least cost over its own and the ordinary parameters.

    The ordinary parameters move with the effect and the model is evaluated there; their derivatives are
    those of the base. `difference`: of the effect's own derivatives, in scales.
    """
    lower, upper = trial.bounds()
    now = _point(projection, trial, np.clip(start, lower, upper), projection.position)
    damping = 1e-3
    for _ in range(MOST_STEPS):
        if not math.isfinite(now.cost):
            break
        shared, hessian, gradient = _projected(projection, trial, now, difference)
        best = now
        for attempt in range(2 * TRIES):
            step = bounded_step(hessian, gradient, now.own, lower, upper, damping)
            step = np.clip(step, -2.0 - np.abs(now.own), 2.0 + np.abs(now.own))
            own = np.clip(now.own + step, lower, upper)
            pull = now.right + now.level.gradient(now.ordinary) + shared @ (own - now.own)
            if attempt >= TRIES:
                pull -= projection.stuck(now.level)
            best = _point(projection, trial, own, now.ordinary - now.level.solve(pull))
            if best.cost < now.cost:
                break
            damping = damping * 20 if attempt != TRIES - 1 else 1e-3
        if not best.cost < now.cost:
            break
        gained, now = now.cost - best.cost, best
        damping *= 0.1
        if gained < max(ENOUGH, SMALL_SHARE * (projection.floor - now.cost)):
            break
    return now


def _projected(projection: Projection, trial: Trial, now: Point, difference: float):
    """Return the coupling to the ordinary parameters, Hessian and gradient with these projected out."""
    columns: dict[str, list[np.ndarray]] = {equation.name: [] for equation in trial.equations}
    _, upper = trial.bounds()
    for i in range(len(now.own)):
        step = difference if now.own[i] + difference <= upper[i] else -difference
        moved = now.own.copy()
        moved[i] += step
        values = trial.values(moved, now.ordinary)
        for equation in trial.equations:
            row = projection.problem.residual(equation, trial.effects, values)
            columns[equation.name].append((row - now.residuals[equation.name]) / step)
    slopes = {name: np.nan_to_num(np.column_stack(many)) for name, many in columns.items()}
    shared = sum(projection.correlated(name, d) for name, d in slopes.items())
    hessian = sum(d.T @ d for d in slopes.values()) - shared.T @ now.level.solve(shared)
    gradient = sum(d.T @ now.residuals[name] for name, d in slopes.items())
    pull = now.right + now.level.gradient(now.ordinary)
    return shared, hessian, gradient - shared.T @ now.level.solve(pull)


def candidate(
    projection: Projection, trial: Trial, positions: list[np.ndarray], promised: float = 0.0
) -> Candidate:
    """Return the best fit of an effect from some start positions; `promised` is the score test's gain."""
    found = [refine(projection, trial, p) for p in positions]
    if projection.floor - min(one.cost for one in found) < PROMISED * promised:
        found += [refine(projection, trial, p, COARSE) for p in positions]
    best = min(found, key=lambda one: one.cost)
    gain = projection.floor - best.cost
    evidence = gain - penalty(projection.base, len(trial.free))
    values = trial.values(best.own, best.ordinary)
    return Candidate(trial.name, gain, values, evidence, best.level.scales)


def penalty(base: Fit, parameters: int) -> float:
    """Return what BIC charges for parameters."""
    return parameters * math.log(base.samples)


def widened_shape(projection: Projection, name: str) -> Candidate:
    """Return a shape correction beyond its priors as a candidate: their standard deviations grow.

    Both models are linear with normal priors, so that their marginal likelihoods are known; one more
    parameter, the width, is paid for.
    """
    right, squares = projection.state({})
    around = projection.best(right, squares)[1].scales
    found = []
    for width in SHAPE_WIDTHS:
        level = projection.level({**around, name: width})
        gain = projection.floor - projection.cost_at(level, right, squares)
        followed = projection.position - level.solve(right + level.gradient(projection.position))
        values = {**projection.base.values, **projection.values(followed)}
        price = penalty(projection.base, 1)
        found.append(Candidate(name, gain, values, gain - price, {**around, name: WIDE}))
    return max(found, key=lambda one: one.evidence)
