# SPDX-License-Identifier: Apache-2.0
"""Where the force model errs most: section 6 says that it is after changes in direction."""

from __future__ import annotations

import numpy as np

from pam_orthosis.identification.identify import Identified
from pam_orthosis.identification.samples import Samples

WAY = 5.0e-3  # m after a change in direction


def errors_by_turn(found: Identified) -> tuple[float, float]:
    """Return the RMS error of the force model within `WAY` after a change in direction, and elsewhere, N.

    At the held-out pressures; NaN where there is no such sample.
    """
    s = found.held_out
    residual, after = found.force.model.residual(s), after_turns(s)
    near, far = (float(np.sqrt(np.mean(part**2))) if len(part) else np.nan
                 for part in (residual[after], residual[~after]))  # fmt: skip
    return near, far


def after_turns(s: Samples) -> np.ndarray:
    """Return which samples are within `WAY` after a change in direction of their run."""
    after = np.zeros(len(s), dtype=bool)
    for serial in np.unique(s.serial[s.serial >= 0]):
        rows = np.flatnonzero(s.serial == serial)
        ways = np.maximum.accumulate(np.where(s.direction[rows] != 0, np.arange(len(rows)), 0))
        way = s.direction[rows][ways]  # of the last motion, where it rests
        turns = np.flatnonzero(np.diff(way) * way[1:] * way[:-1] != 0) + 1
        last = np.zeros(len(rows), dtype=int)
        last[turns] = turns
        last = np.maximum.accumulate(last)
        moved = np.abs(s.contraction[rows] - s.contraction[rows][last])
        after[rows] = (last > 0) & (moved <= WAY)
    return after
