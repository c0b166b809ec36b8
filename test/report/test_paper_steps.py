# SPDX-License-Identifier: Apache-2.0
"""The steady-state error at the beginning of each step, where the answer is known."""

import numpy as np
import pytest

from pam_orthosis.report.paper import tracking

TIME = 0.005 * np.arange(2400)
STAMPS = np.round(TIME * 1e9).astype(np.int64)


def test_each_rest_before_a_step_counts_by_its_end():
    """Three rests of 2 s: the error decays in each towards 0.1, 0.2 and 0.3; no step follows the last."""
    period, since = np.floor(TIME / 4), TIME % 4
    velocity = np.where(since < 2, 0.0, np.sin(np.pi * (since - 2) / 2))
    error = -0.1 * (period + 1) - 2 * np.exp(-since / 0.2)
    cut = TIME < 10.0
    found = tracking.resting_errors(STAMPS[cut], error[cut], velocity[cut])
    assert found == pytest.approx([0.1, 0.2], abs=0.001)


def test_each_heel_strike_counts_by_the_turn_next_to_it():
    """A gait of 2 s that turns 0.06 s before heel strike; the error is large everywhere else."""
    phase = TIME / 2 - 1.0
    velocity = np.sin(2 * np.pi * (phase + 0.03))
    near = np.abs((phase + 0.03 + 0.5) % 1 - 0.5) < 0.03
    error = np.where(near, 0.2 + 0.1 * np.round(phase + 0.03), 5.0)
    found = tracking.turning_errors(TIME, error, velocity, np.where(phase < 0, np.nan, phase))
    assert found[1:] == pytest.approx([0.3, 0.4, 0.5, 0.6][: len(found) - 1], abs=1e-9)
    assert len(found) == 5
