# SPDX-License-Identifier: Apache-2.0
"""Fits of a model's parameters to recordings: whitened residuals, tolerances as priors, bounds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import welch

from pam_orthosis.discrepancy.replay import Replay, Run
from pam_orthosis.discrepancy.system import System
from pam_orthosis.discrepancy.together import THREADS
from pam_orthosis.discrepancy.whitening import Whitener

MOST_STEPS = 8
CHORD_STEPS = 3
CHORD_SHARE = 0.02  # of what a set of derivatives has gained: below it a new set is due
# tried in turn, as (damping, share): where friction sticks, a short step along the old way leads nowhere
STEPS = ((0.0, 1.0), (0.0, 0.3), (0.0, 0.05), (0.01, 1.0), (0.1, 1.0), (1.0, 1.0), (10.0, 1.0), (100.0, 1.0))
LOOSE = 2.0  # typical values: sd of an effect's details about them
WIDE = 10.0  # times its priors: what a shape correction may be once it is named
SEGMENT = 512  # samples, of the density of residuals
ORDINARY_PEAK = 1.25  # of that density for white noise
ENOUGH = 1.0  # a fit ends when a step lowers the cost by less than this


_POOL = ThreadPoolExecutor(THREADS)  # of its own: what `together` runs waits for it


@dataclass(frozen=True)
class Free:
    """A free parameter: scale of its steps, bounds, sd (inf: none) and centre of its prior."""

    name: str
    scale: float
    lower: float
    upper: float
    sd: float
    centre: float = 0.0

    def deviation(self, values: Mapping[str, float]) -> float:
        """Return how far the parameter is from the centre of its prior, in standard deviations."""
        return (values[self.name] - self.centre) / self.sd


def free_parameters(
    system: System,
    effects: Sequence[str],
    refined: Sequence[str] = (),
    scales: Mapping[str, float] | None = None,
) -> list[Free]:
    """Return ordinary parameters and those of effects.

    Args:
        refined: effects whose details are free.
        scales: shape correction -> multiple of its priors (1).
    """
    free = with_scales(system, ordinary(system), scales or {})
    for name in effects:
        if name not in system.shapes:
            free += of_effect(system, name, name in refined)
    return free


def with_scales(system: System, free: Sequence[Free], scales: Mapping[str, float]) -> list[Free]:
    """Return free parameters with the priors of shape corrections scaled."""
    changed = []
    for one in free:
        shape, _, quantity = one.name.partition(".")
        if shape in scales:
            prior = next(q.prior for q in system.catalogue[shape].parameters if q.name == quantity)
            changed.append(replace(one, sd=scales[shape] * prior))
        else:
            changed.append(one)
    return changed


def scales_of(system: System, free: Sequence[Free]) -> dict[str, float]:
    """Return the scales of the shape corrections' priors."""
    scales = {}
    for one in free:
        shape, _, quantity = one.name.partition(".")
        if shape in system.shapes:
            prior = next(q.prior for q in system.catalogue[shape].parameters if q.name == quantity)
            scales[shape] = one.sd / prior
    return scales


def ordinary(system: System) -> list[Free]:
    """Return calibrations and shape coefficients: held by their tolerances."""
    free = [Free(one.name, one.sd, -np.inf, np.inf, one.sd) for one in system.calibrations]
    for name in system.shapes:
        for q in system.catalogue[name].parameters:
            free.append(Free(f"{name}.{q.name}", q.prior, q.minimum, q.maximum, q.prior))
    return free


def of_effect(system: System, name: str, refined: bool = False) -> list[Free]:
    """Return the parameters of an effect that are estimated.

    Refined, the details of its shape are free too, loosely held at their typical values.
    """
    effect = system.catalogue[name]
    free = []
    for q in effect.parameters:
        if refined and not q.fitted:
            size = abs(q.typical) or q.maximum - q.minimum
            held = (q.minimum, q.maximum, LOOSE * size, q.typical)
            free.append(Free(f"{name}.{q.name}", 0.3 * size, *held))
    return free + [Free(f"{name}.{q.name}", _scale(q), q.minimum, q.maximum, np.inf) for q in effect.fitted]


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

    @property
    def samples(self) -> int:
        """The number of samples that are scored."""
        return self.run.recording.samples - self.warm_up

    def white(self, channel: str, columns: np.ndarray) -> np.ndarray:
        """Return whitened columns (n, ...) without the warm-up."""
        return self.whiten(channel, columns)[self.warm_up :]


@dataclass(frozen=True)
class Block:
    """Whitened residuals of one equation over all runs, derivatives by some parameters, weight of both."""

    residual: np.ndarray
    slopes: np.ndarray
    names: tuple[str, ...]
    weight: float = 1.0


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

    def __init__(
        self,
        replay: Replay,
        scored: Sequence[Scored],
        weights: Mapping[str, float] | None = None,
        shown: Mapping[str, np.ndarray] | None = None,
    ):
        self.replay, self.system, self.scored = replay, replay.system, list(scored)
        self.weights = dict(weights or {equation.name: 1.0 for equation in self.system.equations})
        self._shown = dict(shown or {})

    def weighted(self, weights: Mapping[str, float]) -> Problem:
        """Return the same problem with other weights of the equations' residuals."""
        return Problem(self.replay, self.scored, weights, self._shown)

    def shown(self, samples: Mapping[str, np.ndarray]) -> Problem:
        """Return the same problem with some samples only: equation -> choice (n,) of its row of residuals."""
        return Problem(self.replay, self.scored, self.weights, samples)

    def residual(self, equation, effects: tuple[str, ...], values: Mapping) -> np.ndarray:
        """Return the whitened residuals of one equation, all runs and channels in one row."""
        return self._joined(equation, [self._whitened(equation, one, effects, values) for one in self.scored])

    def residuals(self, effects, values) -> dict[str, np.ndarray]:
        """Return the whitened residuals of all equations."""
        tasks = [(equation, one) for equation in self.system.equations for one in self.scored]
        pieces = list(_POOL.map(lambda task: self._whitened(*task, effects, values), tasks))
        return {
            equation.name: self._joined(
                equation, [piece for task, piece in zip(tasks, pieces, strict=True) if task[0] is equation]
            )
            for equation in self.system.equations
        }

    def by_run(self, equation, row: np.ndarray) -> Iterator[tuple[Scored, np.ndarray]]:
        """Yield each run with its part, (channels, samples, ...), of a row of an equation's residuals."""
        start, count = 0, len(equation.channels)
        for one in self.scored:
            end = start + count * one.samples
            yield one, row[start:end].reshape(count, one.samples, *row.shape[1:])
            start = end

    def blocks(self, effects, values, names: tuple[str, ...]) -> dict[str, Block]:
        """Return residuals and derivatives by those of `names` that matter, of every equation."""
        tasks = [(equation, one) for equation in self.system.equations for one in self.scored]
        pieces = list(_POOL.map(lambda task: self._linearised(*task, effects, values, names), tasks))
        blocks = {}
        for equation in self.system.equations:
            own = [piece for task, piece in zip(tasks, pieces, strict=True) if task[0] is equation]
            weight = self.weights[equation.name]
            blocks[equation.name] = Block(
                weight * self._chosen(equation, [row for piece in own for row in piece[0]]),
                weight * self._chosen(equation, [matrix for piece in own for matrix in piece[1]]),
                own[0][2],
                weight,
            )
        return blocks

    def _chosen(self, equation, pieces: Sequence[np.ndarray]) -> np.ndarray:
        """Return the samples that are shown of an equation's pieces, joined."""
        whole = np.concatenate(pieces)
        return whole[self._shown[equation.name]] if equation.name in self._shown else whole

    def _whitened(self, equation, one: Scored, effects, values) -> list[np.ndarray]:
        """Return whitened residuals, one entry a channel, of one run."""
        raw = self.replay.residuals(one.run, equation, effects, values)
        return [one.white(c, raw[:, i]) for i, c in enumerate(equation.channels)]

    def _joined(self, equation, pieces: Sequence[list[np.ndarray]]) -> np.ndarray:
        """Return the weighted residuals of an equation from those of its runs and channels."""
        return self.weights[equation.name] * self._chosen(
            equation, [row for piece in pieces for row in piece]
        )

    def _linearised(self, equation, one: Scored, effects, values, names):
        """Return whitened residuals and derivatives, one entry a channel, of one run."""
        lagging = self._lagging(equation, effects) & set(names)
        smooth = tuple(name for name in names if name not in lagging)
        raw, by, relevant = self.replay.sensitivities(one.run, equation, effects, values, smooth)
        columns = [by]
        for name in sorted(lagging):
            step = 0.02 * max(abs(values[name]), 1e-12)
            moved = {**values, name: values[name] + step}
            change = self.replay.residuals(one.run, equation, effects, moved) - raw
            columns.append(change[:, :, None] / step)
        slopes = np.concatenate(columns, axis=2)
        white = [
            one.white(c, np.column_stack([raw[:, i], slopes[:, i]])) for i, c in enumerate(equation.channels)
        ]
        return [w[:, 0] for w in white], [w[:, 1:] for w in white], (*relevant, *sorted(lagging))

    def total(self, effects, values) -> float:
        """Return the squared whitened residuals of all equations."""
        return _sum(self.residuals(effects, values))

    def _lagging(self, equation, effects) -> set[str]:
        """Return parameters that shift what an equation sees in time: differentiated by differences."""
        return {
            f"{name}.{q.name}"
            for name in effects
            if self.replay.shifts(name, equation)
            for q in self.system.catalogue[name].fitted
        }


def normal_equations(
    blocks: Mapping[str, Block], free: Sequence[Free], values
) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient (halves) by the scaled parameters, priors included."""
    normal = _Normal(blocks, free)
    return normal.hessian, normal.gradient({name: block.residual for name, block in blocks.items()}, values)


def prior_cost(free: Sequence[Free], values) -> float:
    """Return the squared deviations over their tolerance."""
    return float(sum(one.deviation(values) ** 2 for one in free))


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
        wanted = step.copy()
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
        return np.linalg.lstsq(matrix, rhs, rcond=None)[0]


def fit(
    problem: Problem, effects: tuple[str, ...], start: Mapping, free: Sequence[Free], most=MOST_STEPS
) -> Fit:
    """Return the fit of all free parameters from a start, with the problem's weights."""
    values = _inside(start, free)
    names = tuple(one.name for one in free)
    blocks = problem.blocks(effects, values, names)
    for _ in range(most):
        moved, gained = _descended(problem, effects, values, free, blocks)
        if gained <= 0.0:
            break
        values = moved
        blocks = problem.blocks(effects, values, names)
        if gained < ENOUGH:
            break
    return _finished(problem, effects, values, free, blocks)


def fit_tempered(problem: Problem, effects, start, free) -> tuple[Problem, Fit]:
    """Return a fit whose weights agree with the misfit that it leaves, and the weighted problem."""
    values, weights = _inside(start, free), None
    plain = problem.weighted({equation.name: 1.0 for equation in problem.system.equations})
    names = tuple(one.name for one in free)
    blocks = plain.blocks(effects, values, names)
    for _ in range(MOST_STEPS):
        wanted = {e.name: misfit(plain, e, blocks[e.name].residual) ** -0.5 for e in plain.system.equations}
        settled = weights is not None and all(0.85 < wanted[n] / weights[n] < 1.18 for n in wanted)
        weights = weights if settled else wanted
        problem = plain.weighted(weights)
        moved, gained = _descended(problem, effects, values, free, _weighted(blocks, weights))
        if gained > 0.0:
            values = moved
            blocks = plain.blocks(effects, values, names)
        if settled and gained < ENOUGH:
            break
    return problem, _finished(problem, effects, values, free, _weighted(blocks, weights))


def _inside(values: Mapping[str, float], free: Sequence[Free]) -> dict[str, float]:
    """Return values with the free ones inside their bounds: a projection knows none."""
    return {**values, **{one.name: min(max(values[one.name], one.lower), one.upper) for one in free}}


def _weighted(blocks: Mapping[str, Block], weights) -> dict[str, Block]:
    return {
        name: Block(weights[name] * b.residual, weights[name] * b.slopes, b.names, weights[name])
        for name, b in blocks.items()
    }


def _finished(problem, effects, values, free, blocks) -> Fit:
    hessian, _ = normal_equations(blocks, free, values)
    cost = _sum({name: block.residual for name, block in blocks.items()}) + prior_cost(free, values)
    samples = sum(len(block.residual) for block in blocks.values())
    return Fit(effects, values, cost, hessian, tuple(free), samples, blocks)


def _descended(problem: Problem, effects, values, free, blocks) -> tuple[dict, float]:
    """Return values of lower cost and by how much, reusing one set of derivatives for a few steps."""
    names = [one.name for one in free]
    scale = np.array([one.scale for one in free])
    lower, upper = (np.array([getattr(one, side) for one in free]) / scale for side in ("lower", "upper"))
    matrices = _Normal(blocks, free)
    hessian = matrices.hessian
    residuals = {name: block.residual for name, block in blocks.items()}
    first = cost = _sum(residuals) + prior_cost(free, values)
    for _ in range(CHORD_STEPS):
        position = np.array([values[name] for name in names]) / scale
        gradient = matrices.gradient(residuals, values)
        for damping, share in STEPS:
            step = bounded_step(hessian, gradient, position, lower, upper, damping)
            wanted = ((position + share * step) * scale).tolist()
            moved = _inside({**values, **dict(zip(names, wanted, strict=True))}, free)
            fresh = problem.residuals(effects, moved)
            trial = _sum(fresh) + prior_cost(free, moved)
            if trial < cost:
                break
        else:
            break
        gained, cost, values, residuals = cost - trial, trial, moved, fresh
        if gained < max(ENOUGH, CHORD_SHARE * (first - cost)):
            break
    return values, first - cost


class _Normal:
    """Hessian of a linearisation, and gradients for other residuals with the same derivatives."""

    def __init__(self, blocks: Mapping[str, Block], free: Sequence[Free]):
        self._free = free
        index = {one.name: i for i, one in enumerate(free)}
        scale = np.array([one.scale for one in free])
        self._weight = np.array([one.scale / one.sd for one in free])
        self.hessian = np.diag(self._weight**2)
        self._parts = {}
        for name, block in blocks.items():
            kept = [i for i, parameter in enumerate(block.names) if parameter in index]
            place = np.array([index[block.names[i]] for i in kept], dtype=int)
            matrix = np.ascontiguousarray((block.slopes[:, kept] * scale[place]).T)
            self.hessian[np.ix_(place, place)] += matrix @ matrix.T
            self._parts[name] = matrix, place

    def gradient(self, residuals: Mapping[str, np.ndarray], values) -> np.ndarray:
        """Return the gradient (half) by the scaled parameters."""
        gradient = self._weight * np.array([one.deviation(values) for one in self._free])
        for name, (matrix, place) in self._parts.items():
            gradient[place] += matrix @ residuals[name]
        return gradient


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
    return max([1.0, *(peak(piece) for _, part in problem.by_run(equation, raw) for piece in part)])


def peak(residual: np.ndarray) -> float:
    """Return the largest power density of whitened residuals over what is ordinary for white noise."""
    density = welch(residual, fs=2.0, nperseg=min(SEGMENT, len(residual)), detrend=False)[1]
    return float(np.max(np.convolve(density, np.ones(5) / 5, "valid"))) / ORDINARY_PEAK


def score(problem: Problem, model: Fit) -> float:
    """Return minus twice the log evidence of a model up to a constant: cost, Occam factors, BIC.

    Ordinary parameters have priors: for them the ratio of prior and posterior volume is known. An
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
    weight = np.array([one.scale / one.sd for one in own])
    occam = np.linalg.slogdet(normal.hessian)[1] - 2 * float(np.sum(np.log(weight)))
    shapes = sum(name in problem.system.shapes for name in model.effects)
    counted = len(model.free) - len(own) + shapes
    return _sum(fresh) + prior_cost(model.free, model.values) + occam + counted * math.log(model.samples)


def _named(problem: Problem, model: Fit) -> set[str]:
    return set(model.effects) - set(problem.system.shapes)
