# SPDX-License-Identifier: Apache-2.0
"""The verdict's figures on signals whose answer is known."""

import json

import numpy as np
import pytest

from bags import PERIOD_NS, STORE, joint_state, reference, write, write_tracking_bag
from pam_orthosis.bag.read import Bag, Series
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import SECOND_NS, Topics, resolve
from pam_orthosis.bag.tracking import (
    CATCH_UP_SECONDS,
    cycle_table,
    not_led,
    steady_state_error,
    total_variation_rate,
    velocity_lag,
)
from pam_orthosis.bag.verdict import Bound, _closed, judge
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

TIME_NS = np.arange(1000, dtype=np.int64) * PERIOD_NS
TIME = TIME_NS * 1e-9


def test_error_is_reference_minus_angle_joined_by_stamp(tmp_path):
    angle = 0.3 * np.sin(TIME)
    reference = angle + np.radians(np.where(TIME_NS == 500 * PERIOD_NS, 2.0, 0.5))
    bag = write_tracking_bag(tmp_path / "bag", TIME_NS, reference, angle, drop_angle={3, 4, 700})
    verdict = judge(bag, Bound(1.9))
    assert verdict.samples == 997
    assert verdict.max_abs_error == pytest.approx(2.0)
    assert verdict.rms_error == pytest.approx(np.sqrt((996 * 0.25 + 4.0) / 997))
    assert verdict.duration_s == pytest.approx(999 * PERIOD_NS * 1e-9)
    assert not verdict.passed
    assert judge(bag, Bound(2.1)).passed


def test_a_bound_of_a_joint_needs_joints(tmp_path, capsys):
    bag = _tracking(tmp_path / "walk")
    assert main(["check", str(bag), "--bound-deg", "1,knee=2"]) == 2
    assert capsys.readouterr().err.endswith("no knee to bound; it has one joint; give one bound\n")


def test_an_error_of_exactly_the_bound_passes(tmp_path):
    bag = write_tracking_bag(tmp_path / "bag", TIME_NS, np.full_like(TIME, 0.05), np.zeros_like(TIME))
    largest = judge(bag).max_abs_error
    assert judge(bag, Bound(largest)).passed
    assert not judge(bag, Bound(np.nextafter(largest, 0.0))).passed


def test_skipped_seconds_are_not_judged(tmp_path):
    angle = np.zeros_like(TIME)
    reference = np.radians(np.where(TIME < 1.0, 9.0, 0.1))
    bag = write_tracking_bag(tmp_path / "bag", TIME_NS, reference, angle)
    assert judge(bag, skip_s=1.0).max_abs_error == pytest.approx(0.1)
    assert judge(bag, skip_s=0.99).max_abs_error == pytest.approx(9.0)
    with pytest.raises(OrthosisError, match="no sample after"):
        judge(bag, skip_s=1e3)


def test_first_cycle_is_known_from_the_run_metadata(tmp_path):
    reference = np.radians(np.where(TIME < 3.0, 4.0, 0.2))
    parameters = {"scenario.start_hold": 1.0, "scenario.cycle_time": 2.0}
    angle = np.zeros_like(TIME)
    bag = write_tracking_bag(tmp_path / "a", TIME_NS, reference, angle, parameters=parameters)
    verdict = judge(bag)
    assert verdict.max_abs_error_after_first_cycle == pytest.approx(0.2)
    assert [cycle.start_s for cycle in verdict.cycles] == [0.0, 1.0, 3.0]
    foreign = judge(write_tracking_bag(tmp_path / "b", TIME_NS, reference, angle))
    assert foreign.max_abs_error_after_first_cycle is None
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
    assert [(row.number, row.start_s, row.max_abs_error) for row in table] == [
        (1, 0, 1),
        (2, 2, 3),
        (3, 4, 3),
    ]


def test_the_rest_before_the_motion_is_one_row_however_long_it_is():
    table = cycle_table(TIME, np.where(TIME < 0.3, 2.0, 1.0), hold_s=3.1, cycle_s=1.0)
    assert [(row.number, row.start_s, row.max_abs_error) for row in table[:2]] == [
        (0, 0.0, 2.0),
        (1, 3.1, 1.0),
    ]
    assert len(table) == 3


def _two_rates(folder, wanted, angle, every=5, lost=()):
    """Write a bag whose reference has each fifth of its samples, but for the lost ones."""
    count = len(wanted)
    stamps = np.arange(count, dtype=np.int64) * PERIOD_NS
    velocity = np.gradient(wanted, stamps * 1e-9)
    rates = {"control.position.every": every, "scenario.control_period": PERIOD_NS * 1e-9}
    with BagWriter(folder, {"parameters": json.dumps(rates)}) as writer:
        for topic in ("joint_states", "reference"):
            writer.add_topic(resolve(topic), TABLE.by_name[topic].type)
        for k in range(count):
            write(writer, "joint_states", int(stamps[k]), joint_state(int(stamps[k]), "knee", [angle[k]]))
            if k % every == 0 and k not in lost:
                asked = reference(int(stamps[k]), (wanted[k], velocity[k]))
                write(writer, "reference", int(stamps[k]), asked)
    return folder


def test_at_two_rates_the_samples_between_those_of_the_reference_are_judged_too(tmp_path):
    wanted = 0.5 + 0.3 * np.sin(2 * np.pi * np.arange(401) * PERIOD_NS * 1e-9)
    angle = wanted + 1e-3
    angle[203] += np.radians(4.0)
    verdict = judge(_two_rates(tmp_path / "walk", wanted, angle))
    assert verdict.samples == 401
    assert not verdict.passed
    assert verdict.max_abs_error == pytest.approx(4.0 + np.degrees(1e-3), abs=1e-3)
    assert verdict.rms_error == pytest.approx(np.sqrt(np.degrees(1e-3) ** 2 + 4.1**2 / 401), abs=0.01)


def test_nothing_is_made_up_where_the_reference_was_lost(tmp_path):
    wanted = np.linspace(0.2, 0.8, 101)
    verdict = judge(_two_rates(tmp_path / "walk", wanted, wanted, lost=(50,)))
    assert verdict.samples == 101 - 9
    assert verdict.max_abs_error < 1e-6


def _tracking(folder, drop=(), begun_ns=0, **parameters):
    run = {"scenario.control_period": PERIOD_NS * 1e-9, **parameters}
    return write_tracking_bag(folder, TIME_NS + begun_ns, 0.3 * np.sin(TIME), 0.3 * np.sin(TIME), run, drop)


@pytest.mark.parametrize(
    ("drop", "parameters", "said"),
    [
        (range(250, 1000), {}, "from 1.245 to 4.995 s angle and reference share no stamp"),
        (range(300, 600), {}, "from 1.495 to 3.000 s angle and reference share no stamp"),
        ([k for k in range(1000) if k % 4], {}, "angle and reference share 250 of 1000 stamps"),
        ((), {"scenario.duration": 60.0}, "the bag ends early: it can be judged up to 4.995 of 60 s"),
    ],
)
def test_what_cannot_be_judged_does_not_pass(tmp_path, drop, parameters, said, capsys):
    bag = _tracking(tmp_path / "walk", drop, **parameters)
    verdict = judge(bag)
    assert verdict.incomplete == said
    assert not verdict.passed
    assert judge(bag, partial=True).passed
    assert main(["check", str(bag)]) == 1
    told = capsys.readouterr().out.splitlines()
    assert told[-2:] == [
        f"incomplete                 {said}; `--partial` judges what is there",
        f"INCOMPLETE: maximum 0.000 deg, bound 3 deg, {verdict.samples} samples in"
        f" {verdict.duration_s:.3f} s",
    ]
    assert main(["check", str(bag), "--partial"]) == 0


def test_one_duration_is_told_where_the_hardware_goes_on_without_a_reference(tmp_path):
    verdict = judge(_tracking(tmp_path / "walk", range(900, 1000), **{"scenario.duration": 60.0}))
    assert (verdict.answer, verdict.duration_s) == ("INCOMPLETE", pytest.approx(4.495))
    assert verdict.incomplete == "the bag ends early: it can be judged up to 4.495 of 60 s"


def test_an_incomplete_bag_beyond_its_bound_has_failed(tmp_path):
    folder, parameters = tmp_path / "walk", {"scenario.duration": 60.0}
    verdict = judge(write_tracking_bag(folder, TIME_NS, 0.1 + 0.0 * TIME, 0.0 * TIME, parameters))
    assert verdict.incomplete
    assert verdict.answer == "FAILED"


@pytest.mark.parametrize(
    "drop",
    [range(1, 1000), range(150, 1000), [k for k in range(1000) if k % 10]],
    ids=["one", "0.75 s", "sparse"],
)
def test_too_few_samples_pass_nothing(tmp_path, drop, capsys):
    """Those of less than a second are no run, however many there should be."""
    bag = _tracking(tmp_path / "walk", drop)
    assert main(["check", str(bag), "--partial"]) == 2
    assert "too few to judge a run by" in capsys.readouterr().err


def test_samples_that_are_lost_here_and_there_are_no_matter_by_the_wall_clock(tmp_path):
    lost = [k for k in range(1, 1000) if k % 3 == 0 or 400 < k < 590]
    today_ns = 1_700_000_000 * SECOND_NS
    assert judge(_tracking(tmp_path / "walk", lost, today_ns, **{"scenario.duration": 5.5})).passed
    skipped = _tracking(tmp_path / "late", range(1, 300), today_ns)
    assert judge(skipped, skip_s=1.5).passed
    assert not judge(skipped, skip_s=0.4).passed


@pytest.mark.parametrize(
    ("drop", "said"),
    [
        ((700,), "1 of 1000 samples are missing, the first at 3.500 s"),
        (range(20), "20 of 1000 samples are missing, the first at 0.000 s"),
        ([*range(100, 130), *range(500, 530)], "60 of 1000 samples are missing, the first at 0.500 s"),
    ],
)
def test_a_run_in_lockstep_that_lost_samples_does_not_pass(tmp_path, drop, said):
    bag = _tracking(tmp_path / "walk", drop)
    verdict = judge(bag)
    assert (verdict.incomplete, verdict.passed) == (said, False)
    assert judge(bag, partial=True).passed
    assert judge(bag, skip_s=4.0).passed


def test_a_leg_that_the_run_had_and_the_bag_has_not_is_named(tmp_path, capsys):
    with BagWriter(tmp_path / "walk", {"legs": '{"left": {}, "right": {}}'}) as writer:
        for topic in ("joint_states", "reference"):
            writer.add_topic(resolve(topic, "/left"), TABLE.by_name[topic].type)
        for stamp_ns in range(0, 10 * PERIOD_NS, PERIOD_NS):
            for topic, message in (
                ("joint_states", joint_state(stamp_ns, "knee", [0.1])),
                ("reference", reference(stamp_ns, (0.1, 0.0))),
            ):
                data = STORE.serialize_cdr(message, TABLE.by_name[topic].type)
                writer.write(resolve(topic, "/left"), stamp_ns, bytes(data))
    assert main(["check", str(tmp_path / "walk")]) == 2
    assert "the run had a leg right, and the bag has no /right/joint_states" in capsys.readouterr().err


def test_an_observer_that_diverged_leaves_the_verdict_of_the_knee(tmp_path, capsys):
    folder = tmp_path / "walk"
    with BagWriter(folder) as writer:
        for topic in ("joint_states", "reference", "estimate"):
            writer.add_topic(resolve(topic), TABLE.by_name[topic].type)
        for k in range(100):
            stamp_ns = k * PERIOD_NS
            write(writer, "joint_states", stamp_ns, joint_state(stamp_ns, "knee", [0.3]))
            write(writer, "reference", stamp_ns, reference(stamp_ns, (0.4, 0.0)))
            write(writer, "estimate", stamp_ns, joint_state(stamp_ns, "knee", [0.3], [-(9.0**k)]))
    assert main(["check", str(folder)]) == 1
    told = capsys.readouterr().out
    assert "estimate_velocity" in told
    assert "FAILED: maximum 5.730 deg" in told


@pytest.mark.parametrize(
    ("trajectory", "extensor", "flexor", "excused"),
    [
        ("closed", 0.0, 0.0, True),
        ("gait", 0.0, 0.0, False),
        ("closed", 0.0, 3e5, False),
        (None, 0.0, 0.0, True),
    ],
)
def test_only_a_scenario_lets_the_knee_go_and_no_controller(tmp_path, trajectory, extensor, flexor, excused):
    stamps = TIME_NS[:400]
    references = {
        f"{muscle}_pressure_reference": Series(stamps, np.where(stamps > stamps[200], pressure, 3e5))
        for muscle, pressure in (("extensor", extensor), ("flexor", flexor))
    }
    known = {} if trajectory is None else {"scenario.trajectory": trajectory}
    bag = Bag(tmp_path, {"reference_angle": Series(stamps, 0.0 * stamps), **references}, {}, known, KNEE)
    assert _closed(bag, stamps).tolist() == (excused & (stamps > stamps[200])).tolist()


def test_a_leg_among_others_can_be_judged_alone(tmp_path, capsys):
    with BagWriter(tmp_path / "walk") as writer:
        for leg, topics in (("/left", ("joint_states", "reference")), ("/arm", ("joint_states",))):
            for topic in topics:
                writer.add_topic(resolve(topic, leg), TABLE.by_name[topic].type)
                for stamp_ns in range(0, 10 * PERIOD_NS, PERIOD_NS):
                    told = {"joint_states": joint_state(stamp_ns, "knee", [0.1]),
                            "reference": reference(stamp_ns, (0.1, 0.0))}[topic]  # fmt: skip
                    data = STORE.serialize_cdr(told, TABLE.by_name[topic].type)
                    writer.write(resolve(topic, leg), stamp_ns, bytes(data))
    assert main(["check", str(tmp_path / "walk")]) == 0
    assert "left leg" in capsys.readouterr().out
    assert main(["check", str(tmp_path / "walk"), "--namespace", "/left"]) == 0
    assert main(["report", str(tmp_path / "walk"), "--only", "table", "--out", str(tmp_path / "out")]) == 2
    assert "it has the legs left: give one by --namespace" in capsys.readouterr().err
    assert main(["check", str(tmp_path / "walk"), "--skip-s", "1e300"]) == 2
    assert main(["check", str(tmp_path / "walk"), "--bound-deg", "-1"]) == 2
    assert "'-1' is no number of 0 or more" in capsys.readouterr().err
