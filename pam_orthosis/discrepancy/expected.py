# SPDX-License-Identifier: Apache-2.0
"""What a model expects to leave of recordings, were it right: noise, and what it does not know of itself.

Most models follow what they are driven by: they leave noise. Where a knee comes to rest inside a play is
decided by less torque than its parameters are known to, so that even the true equations leave a gap there.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pam_orthosis.discrepancy.fit import Fit, Problem
from pam_orthosis.discrepancy.replay import Run

DRAWS = 16


def left_by_itself(
    problem: Problem, model: Fit, spread: np.ndarray, noise: Mapping[str, float], cutoff: float
) -> dict[str, float]:
    """Return channel -> rms of the whitened residuals that a model expects, 1 for fresh noise alone.

    Recordings are replayed with noise added and parameters drawn from what the fit leaves open; what
    changes is what two recordings of the same apparatus would differ by.

    Args:
        problem: recordings to replay, with their whiteners.
        spread: covariance of the scaled free parameters.
        noise: channel -> sd, SI.
        cutoff: Hz, of the neighbours' smoothing.
    """
    rng = np.random.default_rng(0)
    power: dict[str, list[float]] = {}
    for _ in range(DRAWS):
        values = _drawn(rng, model, spread)
        for one in problem.scored:
            added = {key: sd * rng.standard_normal(one.run.recording.samples) for key, sd in noise.items()}
            noisy = Run(problem.system, one.run.recording, cutoff, added)
            for equation in problem.system.equations:
                change = problem.replay.residuals(noisy, equation, model.effects, values)
                change = change - problem.replay.residuals(one.run, equation, model.effects, model.values)
                for i, channel in enumerate(equation.channels):
                    white = one.white(channel, change[:, i])
                    power.setdefault(channel, []).append((float(white @ white), len(white)))
            problem.replay.forget(noisy)
    return {
        channel: float(np.sqrt(sum(p for p, _ in many) / sum(n for _, n in many)))
        for channel, many in power.items()
    }


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
    return min([1.0, *(end / x for end, x in zip(ends, step, strict=True) if x)])
