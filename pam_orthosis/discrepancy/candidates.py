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

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pam_orthosis.discrepancy.fit import Fit, Problem, bounded_step, normal_equations, of_effect, prior_cost

DIFFERENCE = 0.01  # of a parameter's scale
MOST_STEPS = 8
ENOUGH = 0.5
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
    """

    name: str
    gain: float
    values: Mapping[str, float]
    evidence: float

    @property
    def price(self) -> float:
        """What the parameters cost."""
        return self.gain - self.evidence


class Projection:
    """The present fit with its ordinary parameters free to follow, linearly."""

    def __init__(self, problem: Problem, base: Fit):
        self.problem, self.base = problem, base
        self.hessian, self._gradient = normal_equations(base.blocks, base.free, base.values)
        self._factor = cho_factor(self.hessian + 1e-9 * np.diag(np.diag(self.hessian)))
        self._index = {one.name: i for i, one in enumerate(base.free)}
        self._scale = np.array([one.scale for one in base.free])
        self.prior = np.array([one.scale / one.sd for one in base.free])
        self._prior_gradient = self.prior * np.array([base.values[o.name] / o.sd for o in base.free])
        self.prior_cost = prior_cost(base.free, base.values)
        self._matrices = {name: self._scaled(block) for name, block in base.blocks.items()}
        self._squares = {name: float(np.sum(b.residual**2)) for name, b in base.blocks.items()}
        self._unchanged = {name: self.correlated(name, b.residual) for name, b in base.blocks.items()}
        self.floor = self.cost({})

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

    def cost(self, residuals: Mapping[str, np.ndarray]) -> float:
        """Return the least cost over the ordinary parameters, given residuals of changed equations."""
        right, squares = self.state(residuals)
        return squares + self.prior_cost - float(right @ self.solve(right))

    def state(self, residuals: Mapping[str, np.ndarray]) -> tuple[np.ndarray, float]:
        """Return the gradient by the ordinary parameters and the sum of squares."""
        right, squares = self._prior_gradient.copy(), 0.0
        for name in self.base.blocks:
            if name in residuals:
                squares += float(residuals[name] @ residuals[name])
                right += self.correlated(name, residuals[name])
            else:
                squares += self._squares[name]
                right += self._unchanged[name]
        return right, squares

    def solve(self, columns: np.ndarray) -> np.ndarray:
        """Return the inverse Hessian times columns."""
        return cho_solve(self._factor, columns)

    def follow(self, residuals: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Return the ordinary parameters that go with residuals of changed equations."""
        right, _ = self.state(residuals)
        step = -self.solve(right) * self._scale
        return {
            one.name: self.base.values[one.name] + float(s)
            for one, s in zip(self.base.free, step, strict=True)
        }


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

    def values(self, position: np.ndarray) -> dict[str, float]:
        """Return all parameters at a scaled position, the ordinary ones as in the base."""
        own = {one.name: float(x * s) for one, x, s in zip(self.free, position, self.scale, strict=True)}
        return {**self.projection.base.values, **self._rest, **own}

    def residuals(self, position: np.ndarray) -> dict[str, np.ndarray]:
        """Return the whitened residuals of the equations that the effect changes."""
        values, problem = self.values(position), self.projection.problem
        with np.errstate(all="ignore"):
            return {e.name: problem.residual(e, self.effects, values) for e in self.equations}

    def starts(self) -> list[np.ndarray]:
        """Return the scaled start positions: typical values and the effect's other starts."""
        effect = self.projection.problem.system.catalogue[self.name]
        first = {q.name: q.typical for q in effect.fitted}
        positions = [first, *({**first, **other} for other in effect.starts)]
        return [np.array([p[q.name] for q in effect.fitted]) / self.scale for p in positions]

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
    right, _ = projection.state({})
    shared = sum(projection.correlated(name, d) for name, d in signature.items())
    slope = sum(float(d @ base[name].residual) for name, d in signature.items())
    slope -= float(shared @ projection.solve(right))
    curvature = sum(float(d @ d) for d in signature.values()) - float(shared @ projection.solve(shared))
    if curvature <= 0 or (slope >= 0 and not _two_sided(projection, trial)):
        return 0.0
    return slope**2 / curvature


def _two_sided(projection: Projection, trial: Trial) -> bool:
    size = projection.problem.system.catalogue[trial.name].fitted[0]
    return size.neutral is not None and size.minimum < size.neutral < size.maximum


def refine(projection: Projection, trial: Trial, position: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the effect's parameters that lower the projected cost most, and that cost."""
    lower, upper = trial.bounds()
    position = np.clip(position, lower, upper)
    residuals = trial.residuals(position)
    cost, damping = _cost(projection, residuals), 1e-3
    for _ in range(MOST_STEPS):
        hessian, gradient = _projected(projection, trial, position, residuals)
        moved, lowest = None, cost
        for _ in range(4):
            step = bounded_step(hessian, gradient, position, lower, upper, damping)
            step = np.clip(step, -2.0 - np.abs(position), 2.0 + np.abs(position))
            candidate = np.clip(position + step, lower, upper)
            trial_residuals = trial.residuals(candidate)
            lowest = _cost(projection, trial_residuals)
            if lowest < cost:
                moved = candidate
                break
            damping *= 20
        if moved is None:
            break
        gained, position, residuals, cost = cost - lowest, moved, trial_residuals, lowest
        damping *= 0.1
        if gained < max(ENOUGH, SMALL_SHARE * (projection.floor - cost)):
            break
    return position, cost


def _cost(projection: Projection, residuals) -> float:
    if not all(np.isfinite(row).all() for row in residuals.values()):
        return math.inf
    return projection.cost(residuals)


def _projected(projection: Projection, trial: Trial, position, residuals):
    """Return Hessian and gradient by the effect's parameters with the ordinary ones projected out."""
    columns: dict[str, list[np.ndarray]] = {name: [] for name in residuals}
    _, upper = trial.bounds()
    for i in range(len(position)):
        step = DIFFERENCE if position[i] + DIFFERENCE <= upper[i] else -DIFFERENCE
        moved = position.copy()
        moved[i] += step
        for name, row in trial.residuals(moved).items():
            columns[name].append((row - residuals[name]) / step)
    slopes = {name: np.nan_to_num(np.column_stack(many)) for name, many in columns.items()}
    right, _ = projection.state(residuals)
    shared = sum(projection.correlated(name, d) for name, d in slopes.items())
    hessian = sum(d.T @ d for d in slopes.values()) - shared.T @ projection.solve(shared)
    gradient = sum(d.T @ residuals[name] for name, d in slopes.items()) - shared.T @ projection.solve(right)
    return hessian, gradient


def candidate(projection: Projection, trial: Trial, positions: list[np.ndarray]) -> Candidate:
    """Return the best fit of an effect from some start positions."""
    best, cost = min((refine(projection, trial, p) for p in positions), key=lambda found: found[1])
    values = {**trial.values(best)}
    if math.isfinite(cost):
        values.update(projection.follow(trial.residuals(best)))
    gain = projection.floor - cost
    return Candidate(trial.name, gain, values, gain - penalty(projection.base, len(trial.free)))


def penalty(base: Fit, parameters: int) -> float:
    """Return what BIC charges for parameters."""
    return parameters * math.log(base.samples)


def widened_shape(projection: Projection, name: str) -> Candidate:
    """Return a shape correction beyond its priors as a candidate: their standard deviations grow.

    Both models are linear with normal priors, so that the price is the ratio of the determinants in
    their marginal likelihoods (Occam factor), and one more parameter, the width.
    """
    base = projection.base
    chosen = np.array([one.name.startswith(f"{name}.") for one in base.free])
    right, squares = projection.state({})
    before = np.linalg.slogdet(projection.hessian)[1]
    found = []
    for width in SHAPE_WIDTHS:
        weaker = np.where(chosen, projection.prior**2 * (1 / width**2 - 1), 0.0)
        hessian = projection.hessian + np.diag(weaker)
        position = np.array([base.values[one.name] / one.scale for one in base.free])
        step = -np.linalg.solve(hessian, right + weaker * position)
        cost = squares + projection.prior_cost + float(weaker @ position**2)
        cost += float((right + weaker * position) @ step)
        occam = np.linalg.slogdet(hessian)[1] - before + 2 * chosen.sum() * math.log(width)
        gain = projection.floor - cost
        moved = {
            o.name: base.values[o.name] + float(x) * o.scale for o, x in zip(base.free, step, strict=True)
        }
        price = occam + penalty(base, 1)
        found.append(Candidate(name, gain, {**base.values, **moved}, gain - price))
    return max(found, key=lambda one: one.evidence)
