# SPDX-License-Identifier: Apache-2.0
"""The present fit with its nuisance parameters free to follow, linearly (variable projection)."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pam_orthosis.discrepancy.fitting.fit import Fit, scaled_slopes
from pam_orthosis.discrepancy.fitting.free import SHAPE_SCALES, WIDTHS, with_scales
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.errors import OrthosisError


@dataclass(frozen=True)
class Level:
    """One assumption on how far the shape corrections may go: scales of their priors.

    Attributes:
        scales: shape -> multiple of its priors.
        weight, centre: inverse standard deviations and means of the scaled parameters.
        factor: Cholesky factor of the Hessian.
        occam: what the assumption costs: twice the log of the ratio of prior and posterior volumes.
    """

    scales: Values
    weight: np.ndarray
    centre: np.ndarray
    factor: tuple[np.ndarray, bool]
    occam: float

    def gradient(self, position: np.ndarray) -> np.ndarray:
        """Return the priors' gradient at scaled nuisance parameters."""
        gradient: np.ndarray = self.weight**2 * (position - self.centre)
        return gradient

    def cost(self, position: np.ndarray) -> float:
        """Return what the priors cost there."""
        return float(np.sum((self.weight * (position - self.centre)) ** 2))

    def solve(self, columns: np.ndarray) -> np.ndarray:
        """Return the inverse Hessian times columns."""
        solution: np.ndarray = cho_solve(self.factor, columns)
        return solution


class Projection:
    """The present fit with its nuisance parameters free to follow, linearly.

    How good the static maps are is not known beforehand: each evaluation takes the level of the shape
    corrections' priors that has the largest marginal likelihood (empirical Bayes).
    """

    def __init__(self, problem: Problem, base: Fit):
        self.problem, self.base = problem, base
        self._scale = np.array([one.scale for one in base.free])
        self.position = np.array([base.values[one.name] / one.scale for one in base.free])
        self._lower = np.array([one.lower / one.scale for one in base.free])
        self._upper = np.array([one.upper / one.scale for one in base.free])
        self._matrices = {name: scaled_slopes(block, base.free) for name, block in base.blocks.items()}
        self._squares = {name: float(np.sum(b.residual**2)) for name, b in base.blocks.items()}
        self._unchanged = {name: self.correlated(name, b.residual) for name, b in base.blocks.items()}
        self._curvature = {name: self._own_curvature(name) for name in base.blocks}
        self._data_hessian = sum(self._curvature.values(), np.zeros((len(self._scale),) * 2))
        self.levels = [self.level(scales) for scales in self._assumptions()]
        self.floor = self.best(*self.state({}))[0]

    def _assumptions(self) -> list[dict[str, float]]:
        """Return combinations of scales of the shape corrections that matter; named ones are wide."""
        system, replay = self.problem.system, self.problem.replay
        shapes = [name for name in system.shapes if replay.touched(name)]
        options = [WIDTHS if name in self.base.effects else SHAPE_SCALES for name in shapes]
        return [dict(zip(shapes, chosen, strict=True)) for chosen in product(*options)]

    def level(self, scales: Values) -> Level:
        """Return what the scales of the shape corrections' priors make of the base."""
        own = with_scales(self.problem.system, self.base.free, scales)
        weight = np.array([one.scale / one.sd for one in own])
        centre = np.array([one.centre / one.scale for one in own])
        hessian = self._data_hessian + np.diag(weight**2)
        factor = _factor(hessian)
        priors = 2 * float(np.sum(np.log(weight[weight > 0])))
        occam = 2 * float(np.sum(np.log(np.diag(factor[0])))) - priors
        return Level(scales, weight, centre, factor, occam)

    def _own_curvature(self, equation: str) -> np.ndarray:
        """Return J^T J of an equation in the scaled nuisance parameters."""
        matrix, place = self._matrices[equation]
        out = np.zeros((len(self._scale),) * 2)
        out[np.ix_(place, place)] = matrix @ matrix.T
        return out

    def correlated(self, equation: str, columns: np.ndarray) -> np.ndarray:
        """Return J^T columns in the scaled nuisance parameters."""
        matrix, place = self._matrices[equation]
        out = np.zeros((len(self._scale), *columns.shape[1:]))
        out[place] = matrix @ columns
        return out

    def stuck(self, level: Level) -> np.ndarray:
        """Return the gradient that the base's own fit could not follow to its end.

        Where friction sticks the way down that it shows is not there.
        """
        stuck: np.ndarray = self.state({})[0] + level.gradient(self.position)
        return stuck

    def best(
        self, right: np.ndarray, squares: float, position: np.ndarray | None = None
    ) -> tuple[float, Level]:
        """Return the least cost (with what its level costs) and the level.

        `position`: the scaled nuisance parameters at which the residuals were got (those of the base).
        """
        found = [(self.cost_at(level, right, squares, position), level) for level in self.levels]
        return min(found, key=lambda pair: pair[0])

    def cost_at(
        self, level: Level, right: np.ndarray, squares: float, position: np.ndarray | None = None
    ) -> float:
        """Return the least cost over the nuisance parameters at one level."""
        position = self.position if position is None else position
        total = right + level.gradient(position)
        return squares + level.cost(position) - float(total @ level.solve(total)) + level.occam

    def state(
        self, residuals: Mapping[str, np.ndarray], position: np.ndarray | None = None
    ) -> tuple[np.ndarray, float]:
        """Return the data's gradient by the nuisance parameters and the sum of squares.

        `position`: as in `best`; equations without residuals of their own follow there linearly.
        """
        right, squares = np.zeros(len(self._scale)), 0.0
        moved = (self.position if position is None else position) - self.position
        for name in self.base.blocks:
            if name in residuals:
                squares += float(residuals[name] @ residuals[name])
                right += self.correlated(name, residuals[name])
            else:
                bent = self._curvature[name] @ moved
                squares += self._squares[name] + float(moved @ (2 * self._unchanged[name] + bent))
                right += self._unchanged[name] + bent
        return right, squares

    def inside(self, position: np.ndarray) -> np.ndarray:
        """Return scaled nuisance parameters inside their bounds."""
        inside: np.ndarray = np.clip(position, self._lower, self._upper)
        return inside

    def values(self, position: np.ndarray) -> dict[str, float]:
        """Return the nuisance parameters at a scaled position."""
        return {one.name: float(x * one.scale) for one, x in zip(self.base.free, position, strict=True)}


class RanAway(OrthosisError):
    """Derivatives of a model grow beyond all numbers: nothing can be told from them."""


def _factor(hessian: np.ndarray) -> tuple[np.ndarray, bool]:
    """Return the Cholesky factor, with as little of the diagonal added as rounding asks for."""
    if not np.isfinite(hessian).all():
        raise RanAway("derivatives of the model run away: check the recordings' columns, signs and units")
    for share in (1e-9, 1e-6):
        with suppress(np.linalg.LinAlgError):
            factor: tuple[np.ndarray, bool] = cho_factor(hessian + share * np.diag(np.diag(hessian)))
            return factor
    raise OrthosisError("a fit to these recordings has no minimum: check their columns, signs and units")
