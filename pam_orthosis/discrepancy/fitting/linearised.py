# SPDX-License-Identifier: Apache-2.0
"""A model near where it was differentiated: an equation that a step hardly moves is not replayed for it."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting.free import Free
from pam_orthosis.discrepancy.replay.problem import Block, Problem
from pam_orthosis.discrepancy.systems.system import Equation, Names, Values

STILL = 0.1  # squared change of weighted residuals: a fit ends at ten times that
SHORT = 0.3  # of a nuisance parameter's scale, and
SHORTER = 0.01  # of that of an effect's, which may begin to act where it had no derivative


class Linearised:
    """Residuals and derivatives of all equations, each of them from its own last derivatives where near.

    Args:
        problem: recordings; its weights are left aside.
        effects: that are on.
        free: by what it is differentiated.
    """

    def __init__(self, problem: Problem, effects: Names, free: Sequence[Free]):
        self._problem = problem.weighted({equation.name: 1.0 for equation in problem.system.equations})
        self._effects, self._names = effects, tuple(one.name for one in free)
        own = {one.name for one in free if one.name.partition(".")[0] in effects}
        self._short = {one.name: (SHORTER if one.name in own else SHORT) * one.scale for one in free}
        self._found: dict[str, tuple[Values, Block]] = {}

    def blocks(self, values: Values, weights: Values) -> dict[str, Block]:
        """Return the linearisation at some values, unweighted; `weights` say what is near."""
        near = self._near(values, weights)
        far = self._problem.blocks(self._effects, values, self._names, self._others(near))
        self._found |= {name: (values, block) for name, block in far.items()}
        kept = {name: replace(self._found[name][1], residual=row) for name, row in near.items()}
        return {one.name: {**far, **kept}[one.name] for one in self._problem.system.equations}

    def residuals(self, values: Values, weights: Values) -> dict[str, np.ndarray]:
        """Return the weighted residuals at some values."""
        near = self._near(values, weights)
        rows = {**self._problem.residuals(self._effects, values, self._others(near)), **near}
        return {one.name: weights[one.name] * rows[one.name] for one in self._problem.system.equations}

    def _near(self, values: Values, weights: Values) -> dict[str, np.ndarray]:
        """Return the residuals of the equations that are near their last derivatives."""
        near = {}
        for name, (known, block) in self._found.items():
            step = np.array([values[one] - known[one] for one in block.names])
            if (np.abs(step) > [self._short[one] for one in block.names]).any():
                continue
            change = block.slopes @ step
            if (weights[name] * change) @ (weights[name] * change) < STILL:
                near[name] = block.residual + change
        return near

    def _others(self, near: dict[str, np.ndarray]) -> list[Equation]:
        return [one for one in self._problem.system.equations if one.name not in near]
