# SPDX-License-Identifier: Apache-2.0
"""Parameters without what the noise of inputs' readings does to their fit (SIMEX; Cook & Stefanski, 1994).

A larger mass lets less of that noise through, which lowers the residuals: a fit makes masses too large, gains
too small. As much noise again moves it as far again.
"""

from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, fit
from pam_orthosis.discrepancy.replay.noisy import forget, noise_of, with_noise
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.whitening import stated

PAIRS, STEPS = 2, 4


def unbiased(problem: Problem, model: Fit) -> Fit:
    """Return a fit whose free parameters are where the inputs' noise, were there none, would leave them."""
    if not stated(problem.system):
        return model
    rng, fits = np.random.default_rng(0), []
    for _ in range(PAIRS):
        noise = noise_of(problem, rng)
        for sign in (1.0, -1.0):  # what is linear in the noise is chance, and cancels
            noisy = with_noise(problem, [{name: sign * row for name, row in one.items()} for one in noise])
            fits.append(fit(noisy, model.effects, model.values, model.free, most=STEPS).values)
            forget(noisy)
    values = dict(model.values)
    for one in model.free:
        moved = float(np.mean([fitted[one.name] for fitted in fits])) - values[one.name]
        values[one.name] = min(max(values[one.name] - moved, one.lower), one.upper)
    return replace(model, values=values)
