# SPDX-License-Identifier: Apache-2.0
"""Do recordings agree? A model may leave noise of those that it was fitted to, and much of another."""

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.problem import Problem

LITTLE, MUCH = 1.5, 5.0  # times the noise in the channel where it is most


def remarks_on_agreement(fitted: Problem, held_out: Problem, model: Fit) -> list[str]:
    """Return a remark on recordings that a model does not hold for, though it fits all that it should."""
    most = max(_left(fitted, model).values())
    others = {name: left for name, left in _left(held_out, model).items() if left > MUCH}
    if most > LITTLE or not others:
        return []
    much = " and ".join(f"{left:.0f} times in {name}" for name, left in others.items())
    return [
        f"the model leaves {most:.1f} times the noise in what it was fitted to, and {much}: is that of"
        " another apparatus, or of another state of it?"
    ]


def _left(problem: Problem, model: Fit) -> dict[str, float]:
    """Return recording -> root-mean-square residual over the noise, in the channel where it is largest."""
    found: dict[str, float] = {}
    for equation in problem.system.equations:
        row = problem.residual(equation, model.effects, model.values) / problem.weights[equation.name]
        for one, part in problem.by_run(equation, row):
            left = float(np.sqrt(np.mean(part**2, axis=1)).max())
            found[one.run.recording.name] = max(left, found.get(one.run.recording.name, 0.0))
    return found
