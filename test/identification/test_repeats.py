# SPDX-License-Identifier: Apache-2.0
"""Which samples of several tables are one repeat of the measurement."""

import numpy as np
import pytest
from muscle_rig import LENGTH, repeat, write

from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.identify import identify
from pam_orthosis.identification.measured import numbered_repeats
from pam_orthosis.identification.samples import Samples

LOW, HIGH = (1e5, 2e5, 3e5), (4e5, 5e5, 6e5)


def table(numbers, pressures=LOW):
    """Return samples, one a pressure, of repeats with these numbers."""
    number, level = (one.ravel() for one in np.meshgrid(np.asarray(numbers, float), pressures))
    one = np.ones_like(level)
    return Samples(level, one, one, one, one, level, -one, repeat=number)


@pytest.mark.parametrize(
    ("tables", "numbers"),
    [
        ([table([1, 2, 3])], [[1, 2, 3]]),
        ([table([1, 2, 3]), table([1, 2, 3])], [[1, 2, 3], [4, 5, 6]]),
        ([table([1, 2]), table([1, 2]), table([1])], [[1, 2], [3, 4], [5]]),
        ([table([0, 1]), table([0]), table([0])], [[0, 1], [2], [3]]),
        ([table([0]), table([0])], [[0], [1]]),
        ([table([1]), table([2])], [[1], [2]]),
    ],
)
def test_tables_at_the_same_pressures_are_repeats_of_their_own(tables, numbers):
    assert [np.unique(one.repeat).tolist() for one in numbered_repeats(tables)] == numbers


@pytest.mark.parametrize(
    ("tables", "numbers"),
    [
        ([table([1, 2]), table([1, 2], HIGH)], [[1, 2], [1, 2]]),
        ([table([0], [p]) for p in LOW * 2], [[0], [0], [0], [1], [1], [1]]),
    ],
)
def test_a_repeat_may_be_spread_over_tables_of_other_pressures(tables, numbers):
    assert [np.unique(one.repeat).tolist() for one in numbered_repeats(tables)] == numbers


def test_two_tables_of_three_repeats_each_leave_out_six(tmp_path):
    random = np.random.default_rng(1)
    files = [
        write(tmp_path / f"{name}.csv", np.vstack([repeat(n, random, samples=20) for n in (1, 2, 3)]))
        for name in "ab"
    ]
    found = identify(read_data(files, "dmsp_20", LENGTH))
    assert list(found.left_out["repeat"]) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert (found.force.clustered, found.force.clusters) == ("repeats", 6)
