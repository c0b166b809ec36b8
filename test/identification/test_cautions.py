# SPDX-License-Identifier: Apache-2.0
"""`identify` cautions of a reversed direction, and of points that were measured again without a repeat."""

import numpy as np
import pytest
from muscle_rig import LENGTH, LEVELS, static_force, write

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.identify import identify

RUNS = 4


def static_runs(hysteresis=10.0, order="F"):
    """Return rows p, L, F, direction, repeat: points measured in several runs, whole or each by each."""
    random = np.random.default_rng(5)
    grid = np.meshgrid(np.arange(RUNS), [1.0, -1.0], LEVELS, np.linspace(0.001, 0.075, 9), indexing="ij")
    run, way, p, x = (one.ravel(order) for one in grid)
    drift = 4.0 * random.standard_normal(RUNS)[run.astype(int)]
    force = static_force(x, p)
    shown = force + drift - hysteresis / 2 * way + random.standard_normal(len(p))
    p = np.round(p + 300.0 * random.standard_normal(len(p)))
    return np.column_stack([p, LENGTH - x, shown, way, run])[force > 20]


@pytest.fixture
def remarks(tmp_path):
    """Return what is remarked on rows with so many of the columns."""

    def of(rows, count=5):
        names = ",".join(["p_Pa_gauge", "L_m", "F_N", "direction", "repeat"][:count])
        path = write(tmp_path / "t.csv", rows[:, :count], names)
        return "\n".join(identify(read_data([path], "dmsp_20", LENGTH)).remarks)

    return of


def test_a_reversed_direction_is_a_caution(remarks):
    rows = static_runs()
    assert "direction" not in remarks(rows)
    found = remarks(rows * [1, 1, 1, -1, 1])
    assert "caution: the hysteresis is negative (-10." in found or "negative (-9." in found
    assert found.endswith("stretched or vented: is the direction reversed?")


def test_no_hysteresis_is_no_reversed_direction(remarks):
    assert "reversed" not in remarks(static_runs(hysteresis=0.0))
    assert "reversed" not in remarks(static_runs(hysteresis=-0.5))


@pytest.mark.parametrize("order", ["C", "F"])
def test_points_measured_again_without_a_repeat_are_a_caution(remarks, order):
    rows = static_runs(order=order)
    assert "measured up to" not in remarks(rows)
    found = remarks(rows, 4)
    assert f"measured up to {RUNS} times, and no column repeat tells the runs apart" in found
    assert found.endswith("the intervals are too narrow; give repeat (number of the run)")
    assert remarks(rows, 3).endswith(", or direction (1, -1) if they are two ways")


def test_points_measured_once_and_sweeps_are_no_repeats(remarks):
    rows = static_runs()
    assert "measured up to" not in remarks(rows[rows[:, 4] == 0], 4)
    random = np.random.default_rng(6)
    x, p = 0.001 + 0.07 * random.random(900), np.repeat(LEVELS, 150)
    swept = np.column_stack([p, LENGTH - x, static_force(x, p)])
    assert "measured up to" not in remarks(swept[swept[:, 2] > 20], 3)


def test_a_copy_of_a_table_is_no_repeat(tmp_path):
    """Its rows may have another repeat's number, and the table another name."""
    rows, names = static_runs(), "p_Pa_gauge,L_m,F_N,direction,repeat"
    first, second = (write(tmp_path / f"{name}.csv", rows, names) for name in "ab")
    other = write(tmp_path / "c.csv", rows + np.array([0, 0, 0.1, 0, 0]), names)
    assert len(read_data([first, other], "dmsp_20", LENGTH).samples) == 2 * len(rows)
    write(second, rows + np.array([0, 0, 0, 0, RUNS]), names)
    with pytest.raises(OrthosisError, match=r"b\.csv holds the samples of .*a\.csv: a copy is no repeat"):
        read_data([first, second], "dmsp_20", LENGTH)
