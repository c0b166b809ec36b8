# SPDX-License-Identifier: Apache-2.0
"""What a model's equation misses: replay residuals with the observer undone."""

from __future__ import annotations

import numpy as np

from pam_orthosis.discrepancy.data import smoothed
from pam_orthosis.discrepancy.system import Equation, System


def order(system: System, channel: str) -> int:
    """Return how often a channel's signal integrates: 2 for a position, 1 for a pressure, 0 for a force."""
    state = system.channel(channel).state
    if state is None:
        return 0
    return 2 if state in system.derived.values() else 1


def missing_rate(
    system: System, equation: Equation, channel: str, residual: np.ndarray, period: float, cutoff: float
) -> np.ndarray:
    """Return the rate (or acceleration, or value: see `order`) that the equation lacks, below a cutoff, Hz.

    Args:
        residual: recorded minus predicted of the channel, (n,).
        period: s.
    """
    slow = smoothed(residual, period, cutoff)
    if order(system, channel) == 0:
        return slow
    gains = list(equation.gains[channel].values())
    slope: np.ndarray = np.gradient(slow, period)
    if order(system, channel) == 1:
        return slope + gains[0] * slow
    bend: np.ndarray = np.gradient(slope, period)
    return bend + gains[0] * slope + gains[1] * slow
