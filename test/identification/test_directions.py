# SPDX-License-Identifier: Apache-2.0
"""Hysteresis is alike in all repeats: what both directions leave open stands beside their intervals."""

import numpy as np
import pytest
from muscle_rig import LENGTH, write

from pam_orthosis.cli.identify import describe
from pam_orthosis.identification.damping import slip_element
from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.groups import levels
from pam_orthosis.identification.identify import identify

A, B = [2.8e-3, -2.0e-2, 5.0e-2, -2.0e-1], [3.0, 9.0e3, -1.5e5, 1.2e6, -3.0e6]  # of the emulated muscle
NAMES = "repeat,p_Pa_gauge,L_m,F_N,direction"


@pytest.fixture
def identified(tmp_path):
    """Identify three repeats of sweeps to and fro, with so much force, N at 6 bar, between the directions."""

    def of(hysteresis, ways=(1.0, -1.0)):
        random = np.random.default_rng(3)
        to_fro, way = np.r_[np.linspace(0, 1, 40), np.linspace(1, 0, 40)], np.repeat([1.0, -1.0], 40)
        rows = []
        for number, level in np.ndindex(3, 6):
            p, x = (level + 1) * 1e5 + 300 * random.standard_normal(80), 0.06 * to_fro
            force = np.polynomial.polynomial.polyval(x, A) * p - np.polynomial.polynomial.polyval(x, B)
            force -= hysteresis / 2 * p / 6e5 * slip_element(x, 3e-3) - 0.3 * random.standard_normal(80)
            rows.append(np.column_stack([np.full(80, number), p, LENGTH - x, force, way]))
        rows = np.vstack(rows)
        rows = rows[np.isin(rows[:, 4], ways) & (rows[:, 3] > 0)]
        return identify(read_data([write(tmp_path / "t.csv", rows, NAMES)], "dmsp_20", LENGTH))

    return of


def errors(found):
    return np.abs(np.concatenate([found.force.model.a - A, found.force.model.b - B]))


def test_the_truth_is_beyond_the_repeats_and_within_what_the_directions_leave_open(identified):
    found = identified(hysteresis=40.0)
    assert (errors(found) > found.force.half_width).sum() > 4
    assert (errors(found) < found.between).all()
    assert (found.between[:4] < 20 * errors(found)[:4]).all(), "not wider than of use"
    printed = describe(found)
    assert "  a_0 = " in printed
    assert printed.count(", directions +- ") == 9
    assert "of further repeats lie in it, as 3 of them show; the truth need not" in printed
    assert "samples\n" in printed, "without time neighbours are none"
    assert "(larger than +- in 9 of 9)" in printed
    assert found.as_dict()["half_between_directions"] == found.between.tolist()


def test_without_hysteresis_the_directions_leave_less_open_than_the_repeats(identified):
    found = identified(hysteresis=0.0)
    assert (found.between < found.force.half_width).all()
    assert (errors(found) < found.force.half_width).mean() > 0.8


def test_one_direction_alone_says_nothing_of_it(identified):
    found = identified(hysteresis=40.0, ways=(1.0,))
    assert found.between is None
    assert "directions" not in describe(found)


def test_stragglers_beside_a_level_are_none_of_their_own():
    """A level weighs the same however many rows it has: one of a single row would bend the fit."""
    pressure = np.r_[4e5 + np.linspace(-3e3, 3e3, 60), 4.07e5, 5e5 + np.zeros(3)]
    assert len(np.unique(levels(pressure))) == 2
    assert len(np.unique(levels(np.r_[pressure, 4.07e5 + np.zeros(20)]))) == 3, "as many rows are a level"
    assert len(np.unique(levels(np.r_[pressure, 4.2e5]))) == 3, "far away, one row is a level"
