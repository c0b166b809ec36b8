# SPDX-License-Identifier: Apache-2.0
"""What a larger model filters of the noise with which inputs were read: no misfit of the smaller one.

What is driven by a reading has its noise in the residuals. A lag, a friction that holds, or a larger mass
lets less of it through, though nothing in the apparatus does.
"""

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.noisy import forget, noise_of, with_noise
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import stated, step_of

DRAWS = 4
LOOKS_LIKE = 0.1  # of what inputs change that are off by half a step of their readings: an effect may look so


def noise_squares(problem: Problem, model: Fit) -> dict[str, np.ndarray]:
    """Return the mean squares of what the inputs' noise alone leaves of a model, equation -> row."""
    rng, plain = np.random.default_rng(0), problem.residuals(model.effects, model.values)
    squares = {name: np.zeros(len(row)) for name, row in plain.items()}
    for _ in range(DRAWS):
        noisy = with_noise(problem, noise_of(problem, rng))
        for name, row in noisy.residuals(model.effects, model.values).items():
            squares[name] += (row - plain[name]) ** 2 / DRAWS
        forget(noisy)
    return squares


def is_rounding(problem: Problem, smaller: Fit, larger: Fit) -> bool:
    """Return whether a larger model changes hardly what inputs do that are off by half a step of readings."""
    steps = [_half_steps(problem, one.run) for one in problem.scored]
    if not any(steps):
        return False
    rounded = with_noise(problem, steps)
    plain = problem.residuals(smaller.effects, smaller.values)
    changed = _apart(problem.residuals(larger.effects, larger.values), plain)
    by_step = _apart(rounded.residuals(smaller.effects, smaller.values), plain)
    forget(rounded)
    return changed < LOOKS_LIKE * by_step


def _apart(one: dict[str, np.ndarray], other: dict[str, np.ndarray]) -> float:
    return sum(float(np.sum((one[name] - row) ** 2)) for name, row in other.items())


def _half_steps(problem: Problem, run: Run) -> dict[str, np.ndarray]:
    """Return half the step between readings of each input that is said to have noise, for each sample."""
    read = {name: run.recording.signals.get(name) for name in stated(problem.system)}
    return {name: np.full(len(row), 0.5 * step_of(row)) for name, row in read.items() if row is not None}
