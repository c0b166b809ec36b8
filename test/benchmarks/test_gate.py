# SPDX-License-Identifier: Apache-2.0
"""The gate of a change that is to keep every answer: it sees a last bit, a byte, a name."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import gate
import gate_gap
import gate_model

KEPT = {"knee plant": {"angle": [0.5, 0.25, 0.0], "torque": [1.0, 2.0, 3.0]}}


@pytest.mark.parametrize(
    ("case", "said"),
    [
        (
            {"angle": [0.5, np.nextafter(0.25, 1.0), 0.0]},
            "angle differs in 1 of 3 values, first at 1: 0.25 ->",
        ),
        ({"angle": [0.5, 0.25, -0.0]}, "angle differs in 1 of 3 values, first at 2: 0.0 -> -0.0"),
        ({"angle": [0.5, 0.25]}, "angle has 2 values, not 3"),
        ({"angle": [0.5, float("nan"), 0.0]}, "angle differs in 1 of 3"),
        ({}, "angle is missing"),
    ],
)
def test_one_number_that_is_not_the_same_is_seen(case, said):
    (line,) = gate_model.differences(KEPT, {"knee plant": {"torque": KEPT["knee plant"]["torque"], **case}})
    assert said in line


def test_what_is_new_is_no_difference():
    more = {name: {**table, "more": [1.0]} for name, table in KEPT.items()}
    assert gate_model.differences(KEPT, {**more, "another plant": {"angle": [1.0]}}) == []
    assert len(gate_model.differences(KEPT, {})) == 2


@pytest.mark.parametrize(
    ("after", "lines"),
    [
        ({"a": [b"1", b"2"]}, 0),
        ({"a": [b"1", b"3"]}, 1),
        ({"a": [b"1"]}, 1),
        ({"a": [b"1", b"2", b"3"]}, 1),
        ({"a": [b"1", b"2"], "b": [b"1"]}, 1),
        ({}, 1),
    ],
)
def test_a_payload_that_is_not_the_same_is_seen(after, lines):
    assert len(gate.different_topics({"a": [b"1", b"2"]}, after)) == lines


def test_the_payloads_of_a_reference_bag_are_all_read():
    payloads = gate.payloads(gate.ROOT / "bags" / "walk")
    assert len(payloads["/joint_states"]) == 1400
    assert sum(map(len, payloads.values())) == 27176


def test_answers_are_the_same_by_name_and_within_a_tolerance():
    kept = {
        "verdict": "explained",
        "effects": {"leak": {"coefficient": 2.0}},
        "closure": None,
        "alike": ["a"],
    }
    assert gate_gap.different(kept, kept, 0.0) == []
    near = kept | {"effects": {"leak": {"coefficient": 2.0 * (1 + 1e-7)}}}
    assert gate_gap.different(kept, near, 1e-6) == []
    assert len(gate_gap.different(kept, near, 0.0)) == 1
    for other in (
        {"effects": {"creep": {"coefficient": 2.0}}},
        {"verdict": "none"},
        {"closure": 0.9},
        {"alike": []},
    ):
        assert len(gate_gap.different(kept, kept | other, 1e-6)) == 1
