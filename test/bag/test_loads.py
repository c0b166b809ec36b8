# SPDX-License-Identifier: Apache-2.0
"""Peak and timing of a cushion's force."""

import numpy as np
import pytest

from pam_orthosis.bag.tracking import compared

TIME = np.arange(0.0, 2.0, 0.005)


def hump(late=0.0, size=200.0):
    return size * np.exp(-(((TIME - 1.0 - late) / 0.2) ** 2))


@pytest.mark.parametrize(
    ("late", "size", "passed"),
    [
        (0.0, 200, True), (0.02, 185, True), (-0.02, 215, True),
        (0.04, 200, False), (0.0, 175, False), (0.0, 225, False),
    ],
)  # fmt: skip
def test_a_load_is_good_within_a_tenth_of_its_peak_and_30_ms(late, size, passed):
    load = compared(TIME, hump(), hump(late, size))
    assert load.passed is passed
    assert load.peak_N == pytest.approx(size, rel=0.01)
    if size == 200:
        assert load.late_ms == pytest.approx(1e3 * abs(late), abs=0.5)


def test_two_humps_for_one_are_no_load_in_time():
    load = compared(TIME, hump(), hump(-0.5) + hump(0.5))
    assert (load.late_ms, load.passed) == (None, False)


def test_nothing_for_nothing_is_no_load():
    """A sole that was released is asked for nothing, and gets it."""
    assert not compared(TIME, 0 * TIME, 0 * TIME).passed
