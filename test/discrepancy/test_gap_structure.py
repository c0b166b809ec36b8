# SPDX-License-Identifier: Apache-2.0
"""What is left is separated from noise, for recordings of any length."""

import numpy as np
import pytest

from pam_orthosis.discrepancy.fitting.fit import peak
from pam_orthosis.discrepancy.fitting.signals import signals_of
from pam_orthosis.discrepancy.fitting.structure import CLEAN, MARGIN, Where, _reach, clean
from pam_orthosis.discrepancy.replay.problem import Scored
from pam_orthosis.discrepancy.replay.run import Run


@pytest.mark.parametrize("length", [200, 500, 750])
def test_noise_alone_is_clean_in_short_recordings(length):
    """The density of few samples scatters: a fixed threshold calls noise a gap."""
    rng = np.random.default_rng(7)
    drawn = np.array([max(peak(rng.standard_normal(length)) for _ in range(2)) for _ in range(300)])
    threshold = _reach((length, length))
    assert np.mean(drawn > CLEAN) > 0.2
    # what a right model leaves is not quite white: the same margin as in long recordings
    assert np.mean(drawn > threshold / MARGIN) < 0.03
    assert MARGIN * np.quantile(drawn, 0.9) < threshold
    assert clean([Where("torque", 0.99 * threshold, {}, {}, threshold)])
    assert not clean([Where("torque", 1.01 * threshold, {}, {}, threshold)])


def test_long_recordings_have_the_threshold_that_was_measured():
    assert _reach((6000, 6000, 20000, 20000)) == CLEAN
    assert CLEAN < _reach((2500, 2500)) < _reach((1500, 1500, 6000)) < 1.6 * CLEAN


def test_time_and_phase_go_by_the_clock_of_the_recording(bench):
    """A part keeps the time of the whole, and both begin behind their warm-up."""
    whole = bench.recording(1)
    at, warm_up, cycle = 1234, 500, 1000
    part = whole.part(at, whole.samples, "part")
    of_whole, of_part = (
        signals_of(bench.system, Scored(Run(bench.system, one, 40.0), None, warm_up)) for one in (whole, part)
    )
    assert of_whole["time"][0] == pytest.approx(warm_up * whole.period)
    assert of_part["time"][0] == pytest.approx((at + warm_up) * whole.period)
    assert of_part["time"][-1] == pytest.approx(of_whole["time"][-1])
    assert of_whole["phase"][0] == pytest.approx(warm_up / cycle, abs=0.02)
    assert of_part["phase"][0] == pytest.approx((at + warm_up) % cycle / cycle, abs=0.02)
