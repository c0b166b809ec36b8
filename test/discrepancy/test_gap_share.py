# SPDX-License-Identifier: Apache-2.0
"""A fixed share of the blind benchmark: recordings of the second plant, searched by the workflow."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.testing.case import draw, nominal

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        import bench_gap
        import gap_table
    finally:
        sys.path.remove(str(BENCHMARKS))
    return bench_gap, gap_table


@pytest.fixture(scope="module")
def tools():
    return {}


def solved(benchmark, tools, class_, effects, seed, size="medium"):
    case = {"set": class_, "class": class_, "size": size, "effects": effects, "seed": seed, "outside": False}
    return benchmark[0].solve(case, tools)


def test_maps_that_are_a_little_off_are_no_missing_effect(benchmark, tools):
    """Trap 9: force map, valve curve and volume differ in shape, nothing else is hidden."""
    result = solved(benchmark, tools, "realistic", [], 90530000)
    assert result["found"]["verdict"] == "none"


def test_a_hidden_effect_of_another_form_is_named_and_closed(benchmark, tools):
    result = solved(benchmark, tools, "realistic", ["periodic_torque"], 98490010015)
    assert benchmark[1].judged(result) == "right"
    assert result["found"]["closure"]["overall"] > 0.9
    assert not result["answer"]["same_form"]["periodic_torque"]


def test_every_part_of_a_campaign_is_a_fair_sample(benchmark):
    """Whatever time is reached, each set has its share of the cases that are asked for."""
    sets = [name for name in benchmark[1].SETS if name != "alone"]
    planned = [case for case in benchmark[0].plan(sets, 5) if case["size"] == "medium"]
    cases = benchmark[0].in_turns(planned)
    assert sorted(map(benchmark[1].which, cases)) == sorted(map(benchmark[1].which, planned))
    asked = benchmark[0].ASKED
    for part in (19, 57, 114):
        share = [sum(case["set"] == name for case in cases[:part]) / asked[name] for name in sets]
        assert np.ptp(share) <= 1 / min(asked.values()) + 1e-9


def test_tables_count_what_was_hidden_against_what_was_named(benchmark):
    def case(hidden, named, alike=(), closure=1.0, **more):
        found = {
            "verdict": "explained" if named else "none",
            "effects": [{"name": name, "parameters": {}} for name in named],
            "look_alikes": list(alike),
            "closure": {"overall": closure},
        }
        return {
            "set": "clean", "size": "medium", "effects": hidden, "found": found, "seconds": 1.0,
            "answer": {"effects": dict.fromkeys(hidden)}, **more,
        }  # fmt: skip

    judged = benchmark[1].judged
    assert judged(case(["creep"], ["creep"])) == "right"
    assert judged(case(["creep"], ["backlash"], ["creep"])) == "set"
    assert judged(case(["creep"], ["backlash"], ["creep", "leak"])) == "wrong"
    assert judged(case(["creep"], ["creep", "backlash"])) == "extra"
    assert judged(case(["creep"], [])) == "none"
    assert judged({"failed": "x"}) == "failed"
    text = benchmark[1].table([case(["creep"], ["creep"]), case(["creep"], ["backlash"])])
    assert "| clean | medium | 2 | 1 | 0 | 0 | 1 | 0 | 0 | 50% |" in text
    assert "| clean | medium | creep | backlash | 1 |" in text
    assert "1 of 2 (50%)" in text


def test_each_effect_of_a_pair_is_hidden_alone_in_the_same_plant():
    effects = ["joint_friction", "force_map_misfit", "extensor_leak"]
    both = draw(np.random.default_rng(1), nominal(), "realistic", "medium", effects)
    for name in effects:
        one = draw(np.random.default_rng(1), nominal(), "realistic", "medium", effects, alone=name)
        assert one.answer["effects"] == {name: both.answer["effects"][name]}
        assert one.deviations == both.deviations
        assert (one.hidden.coulomb == both.hidden.coulomb) == (name == "joint_friction")
        same = np.array_equal(one.misfits["force_waves"], both.misfits["force_waves"])
        assert same == (name == "force_map_misfit")
    with pytest.raises(OrthosisError, match="no effect 'creep' to hide"):
        draw(np.random.default_rng(1), nominal(), "clean", "medium", effects, alone="creep")


def test_pairs_count_by_what_was_found_of_each_effect_alone(benchmark):
    def case(name, hidden, named, seed):
        found = {"verdict": "explained", "effects": [{"name": n} for n in named], "look_alikes": []}
        return {"set": name, "size": "medium", "effects": hidden, "seed": seed, "found": found}

    pairs = [
        case("pairs", ["creep", "valve_lag"], named, seed) for seed, named in enumerate((["creep"],) * 2)
    ]
    alone = [
        case("alone", [name], [name] * (seed == 0), seed)
        for seed in (0, 1)
        for name in ("creep", "valve_lag")
    ]
    text = benchmark[1].table([*pairs, *alone])
    assert "pairs: 2 cases, both named 0" in text
    assert "of these, 1 in which each was found alone, the same but for the other: both named 0" in text


def test_a_set_of_cases_does_not_depend_on_the_others(benchmark):
    plan = benchmark[0].plan
    assert list(plan(["pairs"], 3)) == [c for c in plan(["clean", "pairs"], 3) if c["set"] == "pairs"]
