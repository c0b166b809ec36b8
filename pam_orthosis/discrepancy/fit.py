# SPDX-License-Identifier: Apache-2.0
"""Fits of a model's parameters to recordings: whitened residuals, tolerances as priors, bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from pam_orthosis.discrepancy.replay import Replay, Run
from pam_orthosis.discrepancy.system import System
from pam_orthosis.discrepancy.whitening import Whitener

MOST_STEPS = 12
CHORD_STEPS = 4
MOST_TEMPERS = 5
MOST_TEMPERED_STEPS = 3
SEGMENT = 512  # samples, of the density of residuals
ORDINARY_PEAK = 1.25  # of that density for white noise
ENOUGH = 0.05  # a fit ends when a step lowers the cost by less than this


@dataclass(frozen=True)
class Free:
    """A free parameter: scale of its steps, bounds, and sd of its prior about zero (inf: none)."""

    name: str
    scale: float
    lower: float
    upper: float
    sd: float


def ordinary(system: System) -> list[Free]:
    """Return calibrations and shape coefficients: held by their tolerances."""
    free = [Free(one.name, one.sd, -np.inf, np.inf, one.sd) for one in system.calibrations]
    for name in system.shapes:
        for q in system.catalogue[name].parameters:
            free.append(Free(f"{name}.{q.name}", q.prior, q.minimum, q.maximum, q.prior))
    return free


def of_effect(system: System, name: str) -> list[Free]:
    """Return the parameters of an effect that are estimated."""
    effect = system.catalogue[name]
    return [Free(f"{name}.{q.name}", _scale(q), q.minimum, q.maximum, np.inf) for q in effect.fitted]


def _scale(quantity) -> float:
    """Return a typical step of an effect's parameter: the typical distance from off, or the value."""
    typical = abs(quantity.typical - (quantity.neutral or 0.0))
    return typical or 0.05 * (quantity.maximum - quantity.minimum)


@dataclass(frozen=True)
class Scored:
    """A run with its whitener and the samples at its start that are not scored."""

    run: Run
    whiten: Whitener
    warm_up: int

    def white(self, channel: str, columns: np.ndarray) -> np.ndarray:
        """Return whitened columns (n, ...) without the warm-up."""
        return self.whiten(channel, columns)[self.warm_up :]


@dataclass(frozen=True)
class Block:
    """Whitened residuals of one equation over all runs, derivatives by some parameters."""

    residual: np.ndarray
    slopes: np.ndarray
    names: tuple[str, ...]


@dataclass(frozen=True)
class Fit:
    """A fitted model.

    Attributes:
        effects: names of the effects that are on.
        values: all parameters.
        cost: squared whitened residuals plus squared deviations over tolerance.
        hessian: of half the cost by the scaled free parameters.
        free: what was fitted.
        samples: number of residuals.
        blocks: equation -> linearisation at the solution.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    cost: float
    hessian: np.ndarray
    free: Sequence[Free]
    samples: int
    blocks: Mapping[str, Block]

    def error(self, name: str) -> float:
        """Return the standard deviation of a parameter from the curvature."""
        index = [one.name for one in self.free].index(name)
        covariance = np.linalg.pinv(self.hessian)
        return float(np.sqrt(covariance[index, index])) * self.free[index].scale


class Problem:
    """Recordings to be explained by one system."""

    def __init__(self, replay: Replay, scored: Sequence[Scored], weights: Mapping[str, float] | None = None):
        self.replay, self.system, self.scored = replay, replay.system, list(scored)
        self.weights = dict(weights or {equation.name: 1.0 for equation in self.system.equations})

    def weighted(self, weights: Mapping[str, float]) -> Problem:
        """Return the same problem with other weights of the equations' residuals."""
        return Problem(self.replay, self.scored, weights)

    def residual(self, equation, effects: tuple[str, ...], values: Mapping) -> np.ndarray:
        """Return the whitened residuals of one equation, all runs and channels in one row."""
        pieces = []
        for one in self.scored:
            raw = self.replay.residuals(one.run, equation, effects, values)
            pieces += [one.white(c, raw[:, i]) for i, c in enumerate(equation.channels)]
        return self.weights[equation.name] * np.concatenate(pieces)

    def linearised(self, equation, effects, values, names: tuple[str, ...]) -> Block:
        """Return residuals and derivatives by those of `names` that the equation depends on."""
        residuals, slopes, relevant = [], [], ()
        lagging = self._lagging(effects)
        for one in self.scored:
            raw, by, relevant = self.replay.sensitivities(
                one.run, equation, effects, values, tuple(n for n in names if n not in lagging)
            )
            for i, c in enumerate(equation.channels):
                white = one.white(c, np.column_stack([raw[:, i], by[:, i]]))
                residuals.append(white[:, 0])
                slopes.append(white[:, 1:])
        weight = self.weights[equation.name]
        block = Block(weight * np.concatenate(residuals), weight * np.concatenate(slopes), relevant)
        for name in lagging & set(names):
            block = self._with_difference(block, equation, effects, values, name)
        return block

    def blocks(self, effects, values, names) -> dict[str, Block]:
        """Return the linearisation of every equation."""
        return {e.name: self.linearised(e, effects, values, names) for e in self.system.equations}

    def total(self, effects, values) -> float:
        """Return the squared whitened residuals of all equations."""
        return sum(float(np.sum(self.residual(e, effects, values) ** 2)) for e in self.system.equations)

    def _lagging(self, effects) -> set[str]:
        """Return parameters that shift recorded signals in time: differentiated by differences."""
        return {
            f"{name}.{q.name}"
            for name in effects
            if self.system.catalogue[name].advance is not None
            for q in self.system.catalogue[name].parameters
        }

    def _with_difference(self, block, equation, effects, values, name) -> Block:
        effect = name.split(".")[0]
        if equation.name not in self.replay.touched(effect) and not _has_neighbour(equation, self.system):
            return block
        step = 0.02 * max(abs(values[name]), 1e-12)
        moved = self.residual(equation, effects, {**values, name: values[name] + step})
        column = (moved - block.residual)[:, None] / step
        return Block(block.residual, np.column_stack([block.slopes, column]), (*block.names, name))


def _has_neighbour(equation, system) -> bool:
    return len(equation.channels) < len(system.channels)


def normal_equations(blocks: Iterable[Block], free: Sequence[Free], values) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient (halves) by the scaled parameters, priors included."""
    index = {one.name: i for i, one in enumerate(free)}
    scale = np.array([one.scale for one in free])
    hessian, gradient = np.zeros((len(free), len(free))), np.zeros(len(free))
    for block in blocks:
        kept = [i for i, name in enumerate(block.names) if name in index]
        if not kept:
            continue
        place = np.array([index[block.names[i]] for i in kept])
        slopes = block.slopes[:, kept] * scale[place]
        hessian[np.ix_(place, place)] += slopes.T @ slopes
        gradient[place] += slopes.T @ block.residual
    weight = np.array([one.scale / one.sd for one in free])
    hessian += np.diag(weight**2)
    gradient += weight * np.array([values[one.name] / one.sd for one in free])
    return hessian, gradient


def prior_cost(free: Sequence[Free], values) -> float:
    """Return the squared deviations over their tolerance."""
    return float(sum((values[one.name] / one.sd) ** 2 for one in free))


def bounded_step(hessian, gradient, position, lower, upper, damping=0.0) -> np.ndarray:
    """Return the step to the minimum of the quadratic model inside the bounds, by an active set.

    A parameter held at its bound is left out of the prediction too (else the prediction is absurd).
    """
    step = np.zeros(len(gradient))
    active = np.zeros(len(gradient), dtype=bool)
    damped = hessian + np.diag(damping * np.diag(hessian) + 1e-12)
    for _ in range(len(gradient) + 1):
        rest = ~active
        rhs = -(gradient[rest] + damped[np.ix_(rest, active)] @ step[active])
        step[rest] = np.linalg.solve(damped[np.ix_(rest, rest)], rhs)
        over = rest & ((position + step > upper + 1e-12) | (position + step < lower - 1e-12))
        if not over.any():
            break
        step[over] = np.clip(position + step, lower, upper)[over] - position[over]
        active |= over
    return step


def fit(
    problem: Problem, effects: tuple[str, ...], start: Mapping, free: Sequence[Free], most=MOST_STEPS
) -> Fit:
    """Return the fit of all free parameters from a start, by damped Gauss-Newton steps."""
    names = tuple(one.name for one in free)
    scale = np.array([one.scale for one in free])
    lower = np.array([one.lower for one in free]) / scale
    upper = np.array([one.upper for one in free]) / scale
    values = dict(start)
    blocks = problem.blocks(effects, values, names)
    cost = _squares(blocks) + prior_cost(free, values)
    damping = 0.0
    for _ in range(most):
        before = cost
        hessian, gradient = normal_equations(blocks.values(), free, values)
        for _ in range(CHORD_STEPS):
            position = np.array([values[name] for name in names]) / scale
            step = bounded_step(hessian, gradient, position, lower, upper, damping)
            moved = {**values, **dict(zip(names, ((position + step) * scale).tolist(), strict=True))}
            fresh = {e.name: problem.residual(e, effects, moved) for e in problem.system.equations}
            trial = _sum(fresh) + prior_cost(free, moved)
            if not trial < cost:
                break
            gained, cost, values = cost - trial, trial, moved
            if gained < ENOUGH:
                break
            # the derivatives change slowly: the next step reuses them
            blocks = {name: Block(fresh[name], b.slopes, b.names) for name, b in blocks.items()}
            _, gradient = normal_equations(blocks.values(), free, values)
        damping = 0.1 * damping if cost < before else max(10 * damping, 1e-2)
        if before - cost < ENOUGH and (cost < before or damping > 100 or trial - cost < ENOUGH):
            break
        if cost < before:
            blocks = problem.blocks(effects, values, names)
    if before != cost:
        blocks = problem.blocks(effects, values, names)
    hessian, _ = normal_equations(blocks.values(), free, values)
    samples = sum(len(block.residual) for block in blocks.values())
    return Fit(effects, values, cost, hessian, tuple(free), samples, blocks)


def _sum(residuals: Mapping[str, np.ndarray]) -> float:
    total = sum(float(row @ row) for row in residuals.values())
    return total if np.isfinite(total) else np.inf


def misfit(problem: Problem, equation, residual: np.ndarray) -> float:
    """Return by how much residuals exceed white noise where they do so most (power density, >= 1).

    A model that lacks something leaves residuals that are large and correlated in time; they carry
    far less information than their number says. Weighting an equation by the inverse root of this
    keeps ordinary parameters inside their tolerances until the model is right.
    """
    raw = residual / problem.weights[equation.name]
    worst, start = 1.0, 0
    for one in problem.scored:
        length = one.run.recording.samples - one.warm_up
        for _ in equation.channels:
            density = welch(raw[start : start + length], fs=2.0, nperseg=min(SEGMENT, length), detrend=False)[
                1
            ]
            start += length
            worst = max(worst, float(np.max(np.convolve(density, np.ones(5) / 5, "valid"))) / ORDINARY_PEAK)
    return worst


def fit_tempered(problem: Problem, effects, start, free) -> tuple[Problem, Fit]:
    """Return a fit whose weights agree with the misfit that it leaves, and the weighted problem."""
    values = start
    for _ in range(MOST_TEMPERS):
        level = {
            e.name: misfit(problem, e, problem.residual(e, effects, values)) for e in problem.system.equations
        }
        weights = {name: worst**-0.5 for name, worst in level.items()}
        ready = all(0.8 < weights[name] / problem.weights[name] < 1.25 for name in weights)
        if values is not start and ready:
            break
        problem = problem.weighted(weights)
        found = fit(problem, effects, values, free, most=MOST_TEMPERED_STEPS)
        values = found.values
    return problem, found


def _squares(blocks: Mapping[str, Block]) -> float:
    total = sum(float(np.sum(block.residual**2)) for block in blocks.values())
    return total if np.isfinite(total) else np.inf
