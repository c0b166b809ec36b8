# SPDX-License-Identifier: Apache-2.0
"""Fits of a model's parameters to recordings: tolerances as priors, bounds, tempered weights."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import spectrogram

from pam_orthosis.discrepancy.fitting.free import Free
from pam_orthosis.discrepancy.fitting.linearised import Linearised
from pam_orthosis.discrepancy.replay.problem import Block, Problem, sum_of_squares
from pam_orthosis.discrepancy.systems.system import Equation, Names, Values

MOST_STEPS = 8
CHORD_STEPS = 3
CHORD_SHARE = 0.02  # of what a set of derivatives has gained: below it a new set is due
# tried in turn, as (damping, share): where friction sticks, a short step along the old way leads nowhere
STEPS = ((0.0, 1.0), (0.0, 0.3), (0.0, 0.05), (0.01, 1.0), (0.1, 1.0), (1.0, 1.0), (10.0, 1.0), (100.0, 1.0))
SEGMENT = 512  # samples, of the density of residuals
ORDINARY_PEAK = 1.25  # of that density for white noise
ENOUGH = (
    1.0  # a fit ends when a step lowers the cost by less: the derivatives, which are costly, are the same
)


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

    effects: Names
    values: Values
    cost: float
    hessian: np.ndarray
    free: Sequence[Free]
    samples: int
    blocks: Mapping[str, Block]


def held(model: Fit, names: Collection[str]) -> Fit:
    """Return a fit as if some of its free parameters had been known at their values."""
    kept = [i for i, one in enumerate(model.free) if one.name not in names]
    if len(kept) == len(model.free):
        return model
    free = tuple(model.free[i] for i in kept)
    return replace(model, free=free, hessian=model.hessian[np.ix_(kept, kept)])


def normal_equations(
    blocks: Mapping[str, Block], free: Sequence[Free], values: Values
) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient (halves) by the scaled parameters, priors included."""
    normal = _Normal(blocks, free)
    return normal.hessian, normal.gradient({name: block.residual for name, block in blocks.items()}, values)


def prior_cost(free: Sequence[Free], values: Values) -> float:
    """Return the squared deviations over their tolerance."""
    return float(sum(one.deviation(values) ** 2 for one in free))


def bounded_step(
    hessian: np.ndarray,
    gradient: np.ndarray,
    position: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    damping: float = 0.0,
) -> np.ndarray:
    """Return the step to the minimum of the quadratic model inside the bounds, by an active set.

    A parameter held at its bound is left out of the prediction too (else the prediction is absurd).
    """
    step: np.ndarray = np.zeros(len(gradient))
    active = np.zeros(len(gradient), dtype=bool)
    damped = hessian + np.diag(damping * np.diag(hessian) + 1e-12)
    for _ in range(len(gradient) + 1):
        rest = ~active
        rhs = -(gradient[rest] + damped[np.ix_(rest, active)] @ step[active])
        wanted: np.ndarray = step.copy()
        wanted[rest] = _solved(damped[np.ix_(rest, rest)], rhs)
        bound = np.where(wanted > step, upper, lower) - position
        over = rest & (np.abs(wanted - step) > np.abs(bound - step) + 1e-12)
        if not over.any():
            return wanted
        # hold the one that meets its bound first: the others may then stay inside theirs
        share = np.where(over, (bound - step) / np.where(over, wanted - step, 1.0), np.inf)
        first = int(np.argmin(share))
        step = np.where(active, step, step + share[first] * (wanted - step))
        step[first], active[first] = bound[first], True
    return step


def _solved(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Return the solution, the shortest one where parameters have no influence of their own."""
    try:
        return np.linalg.solve(matrix, rhs)
    except np.linalg.LinAlgError:
        shortest: np.ndarray = np.linalg.lstsq(matrix, rhs, rcond=None)[0]
        return shortest


def fit(problem: Problem, effects: Names, start: Values, free: Sequence[Free], most: int = MOST_STEPS) -> Fit:
    """Return the fit of all free parameters from a start, with the problem's weights."""
    values: Values = _inside(start, free)
    line, weights = Linearised(problem, effects, free), problem.weights
    blocks = _weighted(line.blocks(values, weights), weights)
    for step in range(most):
        values, gained, residuals = _descended(line, weights, values, free, blocks)
        last = gained < ENOUGH or step == most - 1
        blocks = _with(blocks, residuals) if last else _weighted(line.blocks(values, weights), weights)
        if last:
            break
    return _finished(effects, values, free, blocks)


def fit_tempered(
    problem: Problem, effects: Names, start: Values, free: Sequence[Free]
) -> tuple[Problem, Fit]:
    """Return a fit whose weights agree with the misfit that it leaves, and the weighted problem."""
    values: Values = _inside(start, free)
    weights: dict[str, float] = {}
    plain = problem.weighted({equation.name: 1.0 for equation in problem.system.equations})
    line = Linearised(problem, effects, free)
    blocks = line.blocks(values, weights)
    for _ in range(MOST_STEPS):
        wanted = {e.name: misfit(plain, e, blocks[e.name].residual) ** -0.5 for e in plain.system.equations}
        settled = bool(weights) and all(0.85 < wanted[n] / weights[n] < 1.18 for n in wanted)
        weights = weights if settled else wanted
        weighted = _weighted(blocks, weights)
        values, gained, residuals = _descended(line, weights, values, free, weighted)
        if gained < ENOUGH:
            blocks = _with(blocks, {name: row / weights[name] for name, row in residuals.items()})
        else:
            blocks = line.blocks(values, weights)
        if settled and gained < ENOUGH:
            break
    return plain.weighted(weights), _finished(effects, values, free, _weighted(blocks, weights))


def _inside(values: Values, free: Sequence[Free]) -> dict[str, float]:
    """Return values with the free ones inside their bounds: a projection knows none."""
    return {**values, **{one.name: min(max(values[one.name], one.lower), one.upper) for one in free}}


def _weighted(blocks: Mapping[str, Block], weights: Values) -> dict[str, Block]:
    return {
        name: Block(weights[name] * b.residual, weights[name] * b.slopes, b.names, weights[name])
        for name, b in blocks.items()
    }


def _with(blocks: Mapping[str, Block], residuals: Mapping[str, np.ndarray]) -> dict[str, Block]:
    """Return a linearisation a small step later."""
    return {name: replace(block, residual=residuals[name]) for name, block in blocks.items()}


def _finished(effects: Names, values: Values, free: Sequence[Free], blocks: Mapping[str, Block]) -> Fit:
    hessian, _ = normal_equations(blocks, free, values)
    cost = sum_of_squares({name: block.residual for name, block in blocks.items()}) + prior_cost(free, values)
    samples = sum(len(block.residual) for block in blocks.values())
    return Fit(effects, values, cost, hessian, tuple(free), samples, blocks)


def _descended(
    line: Linearised, weights: Values, values: Values, free: Sequence[Free], blocks: Mapping[str, Block]
) -> tuple[Values, float, dict[str, np.ndarray]]:
    """Return values of lower cost, by how much, and residuals there; a few steps share derivatives."""
    names = [one.name for one in free]
    scale = np.array([one.scale for one in free])
    lower, upper = (np.array([getattr(one, side) for one in free]) / scale for side in ("lower", "upper"))
    matrices = _Normal(blocks, free)
    hessian = matrices.hessian
    residuals = {name: block.residual for name, block in blocks.items()}
    first = cost = sum_of_squares(residuals) + prior_cost(free, values)
    if not matrices.known:
        return values, 0.0, residuals
    for _ in range(CHORD_STEPS):
        position = np.array([values[name] for name in names]) / scale
        gradient = matrices.gradient(residuals, values)
        for damping, share in STEPS:
            step = bounded_step(hessian, gradient, position, lower, upper, damping)
            wanted = ((position + share * step) * scale).tolist()
            moved = _inside({**values, **dict(zip(names, wanted, strict=True))}, free)
            fresh = line.residuals(moved, weights)
            trial = sum_of_squares(fresh) + prior_cost(free, moved)
            if trial < cost:
                break
        else:
            break
        gained, cost, values, residuals = cost - trial, trial, moved, fresh
        if gained < max(ENOUGH, CHORD_SHARE * (first - cost)):
            break
    return values, first - cost, residuals


def scaled_slopes(block: Block, free: Sequence[Free]) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives by the scaled free parameters, transposed, and their places among these."""
    rows, scale, place = _slopes(block, free)
    return rows * scale[:, None], place


def _slopes(block: Block, free: Sequence[Free]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives by the free parameters, transposed, their scales and places among these."""
    index = {one.name: i for i, one in enumerate(free)}
    kept = [i for i, name in enumerate(block.names) if name in index]
    place = np.array([index[block.names[i]] for i in kept], dtype=int)
    rows = block.slopes.T if len(kept) == len(block.names) else block.slopes.T[kept]
    return rows, np.array([one.scale for one in free])[place], place


class _Normal:
    """Hessian of a linearisation, and gradients for other residuals with the same derivatives."""

    def __init__(self, blocks: Mapping[str, Block], free: Sequence[Free]):
        self._free = free
        self._weight = np.array([one.scale / one.sd for one in free])
        self.hessian = np.diag(self._weight**2)
        self._parts = {name: _slopes(block, free) for name, block in blocks.items()}
        with np.errstate(over="ignore", invalid="ignore"):  # a replay that went astray is not `known`
            for rows, scale, place in self._parts.values():
                self.hessian[np.ix_(place, place)] += (rows @ rows.T) * np.outer(scale, scale)
        self.known = bool(np.isfinite(self.hessian).all())

    def gradient(self, residuals: Mapping[str, np.ndarray], values: Values) -> np.ndarray:
        """Return the gradient (half) by the scaled parameters."""
        gradient: np.ndarray = self._weight * np.array([one.deviation(values) for one in self._free])
        for name, (rows, scale, place) in self._parts.items():
            gradient[place] += scale * (rows @ residuals[name])
        return gradient


def misfit(problem: Problem, equation: Equation, residual: np.ndarray) -> float:
    """Return by how much residuals exceed white noise where they do so most (power density, >= 1).

    A model in which something is missing leaves residuals that are large and correlated in time; they carry
    far less information than their number says. Weighting an equation by the inverse root of this
    keeps nuisance parameters inside their tolerances until the model is right.
    """
    raw = residual / problem.weights[equation.name]
    return max([1.0, *(peak(piece) for _, part in problem.by_run(equation, raw) for piece in part)])


def peak(residual: np.ndarray) -> float:
    """Return the largest power density of whitened residuals over what is ordinary for white noise."""
    size = min(SEGMENT, len(residual))
    # the mean over segments is Welch's estimate; SciPy's own transforms one segment after the other
    segments = spectrogram(residual, 2.0, "hann", size, size // 2, detrend=False)[2]
    density = segments.mean(axis=-1)
    return float(np.max(np.convolve(density, np.ones(5) / 5, "valid"))) / ORDINARY_PEAK


def score(problem: Problem, model: Fit) -> float:
    """Return minus twice the log evidence of a model up to a constant: cost, Occam factors, BIC.

    Of a model whose replay goes astray it is infinite.
    Nuisance parameters have priors: for them the ratio of prior and posterior volume is known. An
    effect's parameters, and a shape correction that left its priors, are charged as BIC does.
    """
    scale = {name: problem.weights[name] for name in model.blocks}
    fresh = problem.residuals(model.effects, model.values)
    own = [one for one in model.free if one.name.partition(".")[0] not in _named(problem, model)]
    blocks = {
        name: Block(fresh[name], b.slopes * (scale[name] / b.weight), b.names)
        for name, b in model.blocks.items()
    }
    normal = _Normal(blocks, own)
    if not normal.known:
        return math.inf
    weight = np.array([one.scale / one.sd for one in own])
    occam = float(np.linalg.slogdet(normal.hessian)[1]) - 2 * float(np.sum(np.log(weight)))
    shapes = sum(name in problem.system.shapes for name in model.effects)
    counted = len(model.free) - len(own) + shapes
    return (
        sum_of_squares(fresh)
        + prior_cost(model.free, model.values)
        + occam
        + counted * math.log(model.samples)
    )


def _named(problem: Problem, model: Fit) -> set[str]:
    return set(model.effects) - set(problem.system.shapes)
