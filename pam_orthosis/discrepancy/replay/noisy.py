# SPDX-License-Identifier: Apache-2.0
"""Recordings with the noise of their inputs' readings once more, to see what it does."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.run import Noise
from pam_orthosis.discrepancy.replay.whitening import drawn, stated


def noise_of(problem: Problem, rng: np.random.Generator) -> list[Noise]:
    """Return noise as that with which a user says that inputs were read, for each run."""
    return [drawn(rng, problem.system, one.run, stated(problem.system)) for one in problem.scored]


def with_noise(problem: Problem, noise: Sequence[Noise]) -> Problem:
    """Return the same problem with noise added to what each run was recorded with."""
    pairs = zip(problem.scored, noise, strict=True)
    return problem.on([replace(one, run=one.run.noisy(added)) for one, added in pairs])


def forget(problem: Problem) -> None:
    """Forget the replays of such a problem."""
    for one in problem.scored:
        problem.replay.forget(one.run)
