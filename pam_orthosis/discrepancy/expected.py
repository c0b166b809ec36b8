# SPDX-License-Identifier: Apache-2.0
"""What a model expects to leave of recordings, were it right: noise, and what it does not know of itself.

Most models follow what they are driven by: they leave noise. Where a knee comes to rest inside a play is
decided by less torque than its parameters are known to, so that even the true equations leave a gap there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.run import Run

DRAWS = 16
AROUND = 0.5  # s, over which expected squares are averaged, and kept apart from what is decided
DECIDED = 1.6  # expected squares of whitened residuals, 1 for noise, below which chance decides little
LEAST_SECONDS = 5.0  # of samples that chance does not decide

# (serial of a run, channel) -> one value a scored sample
Samples = Mapping[tuple[int, str], np.ndarray]


def expected_squares(
    problem: Problem, model: Fit, spread: np.ndarray, noise: Mapping[str, float], cutoff: float
) -> Samples:
    """Return the mean squares of the whitened residuals that a model expects, 1 for fresh noise alone.

    Recordings are replayed with noise added and parameters drawn from what the fit leaves open; what
    changes is what two recordings of the same apparatus would differ by.

    Args:
        problem: recordings to replay, with their whiteners.
        spread: covariance of the scaled free parameters.
        noise: channel -> sd, SI.
        cutoff: Hz, of the neighbours' smoothing.
    """
    rng = np.random.default_rng(0)
    squares: dict[tuple[int, str], np.ndarray] = {}
    for _ in range(DRAWS):
        values = _drawn(rng, model, spread)
        for one in problem.scored:
            added = {key: sd * rng.standard_normal(one.run.recording.samples) for key, sd in noise.items()}
            noisy = Run(problem.system, one.run.recording, cutoff, added)
            for equation in problem.system.equations:
                change = problem.replay.residuals(noisy, equation, model.effects, values)
                change = change - problem.replay.residuals(one.run, equation, model.effects, model.values)
                for i, channel in enumerate(equation.channels):
                    key = one.run.serial, channel
                    squares[key] = squares.get(key, 0.0) + one.white(channel, change[:, i]) ** 2 / DRAWS
            problem.replay.forget(noisy)
    return squares


def decided(problem: Problem, squares: Samples) -> Samples | None:
    """Return which samples chance does not decide; None if there are too few to judge by."""
    masks, seconds = {}, dict.fromkeys((channel for _, channel in squares), 0.0)
    for one in problem.scored:
        size = round(AROUND / one.run.period)
        for channel in seconds:
            local = uniform_filter1d(squares[one.run.serial, channel], size)
            mask = maximum_filter1d(local, size) < DECIDED
            masks[one.run.serial, channel] = mask
            seconds[channel] += one.run.period * float(mask.sum())
    return masks if min(seconds.values()) >= LEAST_SECONDS else None


def _drawn(rng: np.random.Generator, model: Fit, spread: np.ndarray) -> dict[str, float]:
    """Return a model's values with the free parameters drawn from their covariance, inside their bounds.

    A draw that leaves them is shortened as a whole: parameters that make up for each other still do.
    """
    root = np.linalg.svd(0.5 * (spread + spread.T), hermitian=True)
    scale = np.array([one.scale for one in model.free])
    step = scale * ((root.U * np.sqrt(root.S)) @ rng.standard_normal(len(root.S)))
    room, back = _room(model, step), _room(model, -step)
    step = room * step if room >= back else -back * step
    moved = {one.name: model.values[one.name] + float(x) for one, x in zip(model.free, step, strict=True)}
    return {**model.values, **moved}


def _room(model: Fit, step: np.ndarray) -> float:
    """Return the share of a step that stays inside all bounds."""
    ends = [
        (one.upper if x > 0 else one.lower) - model.values[one.name]
        for one, x in zip(model.free, step, strict=True)
    ]
    return float(min([1.0, *(end / x for end, x in zip(ends, step, strict=True) if x)]))
