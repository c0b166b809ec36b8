# SPDX-License-Identifier: Apache-2.0
"""The verdict's figures on signals whose answer is known."""

import numpy as np
import pytest

from bags import PERIOD_NS, write_tracking_bag
from pam_orthosis.bag.read import Series
from pam_orthosis.bag.verdict import (
    CATCH_UP_SECONDS,
    cycle_table,
    judge,
    not_led,
    steady_state_error,
    total_variation_rate,
    velocity_lag,
)
from pam_orthosis.errors import OrthosisError

TIME_NS = np.arange(1000, dtype=np.int64) * PERIOD_NS
TIME = TIME_NS * 1e-9


def test_error_is_reference_minus_angle_joined_by_stamp(tmp_path):
    angle = 0.3 * np.sin(TIME)
    reference = angle + np.radians(np.where(TIME_NS == 500 * PERIOD_NS, 2.0, 0.5))
    bag = write_tracking_bag(tmp_path / "bag", TIME_NS, reference, angle, drop_angle={3, 4, 700})
    verdict = judge(bag, bound_deg=1.9)
    assert verdict.samples == 997
    assert verdict.max_abs_error_deg == pytest.approx(2.0)
    assert verdict.rms_error_deg == pytest.approx(np.sqrt((996 * 0.25 + 4.0) / 997))
    assert verdict.duration_s == pytest.approx(999 * PERIOD_NS * 1e-9)
    assert not verdict.passed
    assert judge(bag, bound_deg=2.1).passed


def test_skipped_seconds_are_not_judged(tmp_path):
    angle = np.zeros_like(TIME)
    reference = np.radians(np.where(TIME < 1.0, 9.0, 0.1))
    bag = write_tracking_bag(tmp_path / "bag", TIME_NS, reference, angle)
    assert judge(bag, skip_s=1.0).max_abs_error_deg == pytest.approx(0.1)
    assert judge(bag, skip_s=0.99).max_abs_error_deg == pytest.approx(9.0)
    with pytest.raises(OrthosisError, match="no sample after"):
        judge(bag, skip_s=1e3)


def test_first_cycle_is_known_from_the_run_metadata(tmp_path):
    reference = np.radians(np.where(TIME < 3.0, 4.0, 0.2))
    parameters = {"scenario.start_hold": 1.0, "scenario.cycle_time": 2.0}
    angle = np.zeros_like(TIME)
    bag = write_tracking_bag(tmp_path / "a", TIME_NS, reference, angle, parameters=parameters)
    verdict = judge(bag)
    assert verdict.max_abs_error_after_first_cycle_deg == pytest.approx(0.2)
    assert [cycle.start_s for cycle in verdict.cycles] == [0.0, 1.0, 3.0]
    foreign = judge(write_tracking_bag(tmp_path / "b", TIME_NS, reference, angle))
    assert foreign.max_abs_error_after_first_cycle_deg is None
    assert foreign.cycles == []


@pytest.mark.parametrize(
    ("closed", "near", "free"),
    [
        ("000000", "101010", "000000"),
        ("011000", "000111", "011000"),  # back at once
        ("011000", "000001", "011110"),  # on its way for two samples
        ("110110", "001001", "110110"),
    ],
)
def test_a_knee_that_was_let_go_is_not_judged_until_it_is_back(closed, near, free):
    def flags(text):
        return np.array([letter == "1" for letter in text])

    assert not_led(TIME_NS[:6], flags(closed), flags(near)).tolist() == flags(free).tolist()


def test_a_knee_that_does_not_come_back_is_judged():
    closed = TIME < 1.0
    free = not_led(TIME_NS, closed, np.zeros_like(closed))
    assert TIME[free].max() == pytest.approx(1.0 + CATCH_UP_SECONDS, abs=3 * PERIOD_NS * 1e-9)


def test_steady_state_is_where_the_reference_rests_long_enough():
    velocity = np.ones_like(TIME)
    velocity[100:200] = 0.019
    velocity[300:315] = 0.0  # 75 ms: too short
    error = np.where((TIME_NS >= 100 * PERIOD_NS) & (TIME_NS < 200 * PERIOD_NS), -0.3, 5.0)
    assert steady_state_error(TIME_NS, error, velocity) == pytest.approx(0.3)
    assert steady_state_error(TIME_NS, error, np.ones_like(TIME)) is None


@pytest.mark.parametrize("lag", [-0.004, 0.0, 0.007, 0.02])
def test_velocity_lag_is_found_under_noise(lag):
    noise = np.random.default_rng(0).normal(0, 5e-4, len(TIME))
    angle = 0.5 * np.sin(3 * TIME) + noise
    velocity = 1.5 * np.cos(3 * (TIME - lag))
    found = velocity_lag(Series(TIME_NS, angle), Series(TIME_NS, velocity))
    assert found == pytest.approx(lag, abs=2e-4)


def test_velocity_lag_of_rest_is_unknown():
    rest = Series(TIME_NS, np.zeros_like(TIME))
    assert velocity_lag(rest, rest) is None


def test_total_variation_counts_every_step():
    zigzag = Series(TIME_NS, np.arange(1000) % 2 * 0.5)
    assert total_variation_rate(zigzag) == pytest.approx(0.5 / (PERIOD_NS * 1e-9))


def test_cycle_table_has_each_cycle_s_own_maximum():
    error = np.where(TIME < 2.0, 1.0, -3.0)
    table = cycle_table(TIME, error, hold_s=0.0, cycle_s=2.0)
    assert [(row.start_s, row.max_abs_error_deg) for row in table] == [(0, 1), (2, 3), (4, 3)]
