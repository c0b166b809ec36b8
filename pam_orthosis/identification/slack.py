# SPDX-License-Identifier: Apache-2.0
"""Rows in which the muscle hangs slack or is buckled: Eq. (14) does not hold there."""

from __future__ import annotations

import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.force import fit_force, rms_and_max
from pam_orthosis.identification.samples import Samples

START_SHARE = 0.08  # of the largest force: what is above it is taut, whatever the model
LEAST_SHARE = 2.0e-3  # of the largest force, that a taut muscle shows at least
ROUNDS = 20


def taut(s: Samples, damping: float, degrees: tuple[int, int]) -> np.ndarray:
    """Return which rows are of a taut muscle.

    A slack muscle shows the same small force whatever the pressure, and where it buckles even pushes. Rows of
    large force are fitted; a row is slack where their model or the load cell shows no more than the scatter.
    This is repeated with what is taut by then.
    """
    largest = float(s.force.max())
    large = s.force >= START_SHARE * largest
    kept, least = large, LEAST_SHARE * largest
    for _ in range(ROUNDS):
        try:
            model = fit_force(s.where(kept), damping, degrees).model
        except OrthosisError:  # the fit of what is left will say what is missing
            return s.force >= least
        scatter = max(least, rms_and_max(model.residual(s.where(large)))[0])
        before, kept = kept, large | (np.minimum(model.force(s), s.force) >= scatter)
        if (before == kept).all():
            break
    return kept
