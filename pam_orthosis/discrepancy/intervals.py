# SPDX-License-Identifier: Apache-2.0
"""Intervals of fitted parameters that hold where residuals are correlated or the form is not exact."""

from __future__ import annotations

import numpy as np

from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.system import Equation

BLOCK = 1.0  # s
QUANTILE = 1.96  # two-sided 95 % of a normal distribution


def covariance(problem: Problem, model: Fit) -> np.ndarray:
    """Return the covariance of the scaled free parameters: curvature, widened by the block sandwich.

    Scores are summed over blocks of 1 s; their scatter replaces the assumption of white residuals
    (Kauermann & Carroll 2001, clustered by time).
    """
    inverse = np.linalg.pinv(model.hessian)
    index = {one.name: i for i, one in enumerate(model.free)}
    scale = np.array([one.scale for one in model.free])
    meat = np.zeros_like(inverse)
    for equation in problem.system.equations:
        block = model.blocks[equation.name]
        place = [index[name] for name in block.names if name in index]
        kept = [i for i, name in enumerate(block.names) if name in index]
        scores = block.slopes[:, kept] * scale[place] * block.residual[:, None]
        sums = _over_blocks(problem, equation, scores)
        meat[np.ix_(place, place)] += sums.T @ sums
    sandwich = inverse @ meat @ inverse
    widening = np.sqrt(np.maximum(np.diag(sandwich) / np.maximum(np.diag(inverse), 1e-300), 1.0))
    return inverse * np.outer(widening, widening)


def interval(model: Fit, spread: np.ndarray, name: str) -> tuple[float, float]:
    """Return the 95 % interval of a parameter, inside its bounds."""
    index = [one.name for one in model.free].index(name)
    one = model.free[index]
    half = QUANTILE * float(np.sqrt(spread[index, index])) * one.scale
    value = model.values[name]
    return max(value - half, one.lower), min(value + half, one.upper)


def _over_blocks(problem: Problem, equation: Equation, scores: np.ndarray) -> np.ndarray:
    sums = []
    for one, part in problem.by_run(equation, scores):
        whole = max(1, one.samples // round(BLOCK / one.run.period))
        sums += [block.sum(axis=0) for piece in part for block in np.array_split(piece, whole)]
    return np.array(sums)
