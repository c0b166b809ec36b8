# SPDX-License-Identifier: Apache-2.0
"""A bag as CSV: what is read back from it is what the bag holds, to the bit."""

import csv
from pathlib import Path

import numpy as np

from pam_orthosis.bag.read import Series, read_bag
from pam_orthosis.bag.sampled import at_stamps
from pam_orthosis.bag.topics import Topics
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.recordings.data import from_bag, from_csv
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.report.table import _cell

TABLE = Topics(KNEE)

WALK = Path(__file__).parents[2] / "bags" / "walk"


def _columns(file):
    with open(file, encoding="utf-8", newline="") as stream:
        header, *rows = csv.reader(stream)
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def test_all_signals_come_back_to_the_bit_and_gap_reads_the_table(tmp_path, capsys):
    assert main(["report", str(WALK), "--only", "table", "--out", str(tmp_path)]) == 0
    file = tmp_path / "walk.csv"
    assert capsys.readouterr().out.split() == [str(file)]
    columns, bag = _columns(file), read_bag(WALK, [], optional=TABLE.signals)
    assert set(columns) == {"time", *bag.series}
    assert {"angle", "reference_angle", "extensor_voltage", "truth_flexor_force"} <= set(columns)
    for name in bag.series:
        np.testing.assert_array_equal([float(cell) for cell in columns[name]], bag[name].value, err_msg=name)
    system = knee(load())
    one, other = from_csv(file, system), from_bag(WALK, system)
    assert one.signals.keys() == other.signals.keys()
    assert all(np.array_equal(one.signals[name], other.signals[name]) for name in one.signals)


def test_where_a_topic_has_no_message_the_cell_is_empty():
    stamps = np.arange(6) * 5
    there = at_stamps(stamps, Series(np.array([5, 15, 40]), np.array([0.1, -2e-9, 3.0])))
    assert [_cell(value) for value in there.tolist()] == [
        "",
        "0.1",
        "",
        "-2e-09",
        "",
        "",
    ]
