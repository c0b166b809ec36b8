# SPDX-License-Identifier: Apache-2.0
"""The campaign of the safety monitor: its margins follow from the mechanics, its tables from the rows."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import safety

from pam_orthosis.model.parameters import load, scenario_overrides


def test_the_margin_of_the_range_is_where_the_stop_holds_the_heaviest_person():
    def deepest(mass):
        parameters = load({**scenario_overrides("person"), "leg.person.mass": mass})
        return safety.deepest(parameters, safety.SIZES[-1])

    assert deepest(110.0) == pytest.approx(safety.MARGINS["range of motion"], abs=0.005)
    assert 0.4 < deepest(35.0) < deepest(110.0)


def test_spasms_are_counted_by_size():
    row = {"against": True, "torque": 26.0, "seen": True, "beyond": {"range of motion": 0.2}}
    rows = [
        row,
        row | {"seen": False},
        row | {"against": False},
        row | {"torque": 31.0},
        {"kind": "nonsense"},
    ]
    *_, small, large, _ = list(safety.sizes(rows))
    assert small == "| 25 to 30 N m | 2 | 1 | 0.2 rad |"
    assert large == "| 30 to 35 N m | 1 | 1 | 0.2 rad |"
