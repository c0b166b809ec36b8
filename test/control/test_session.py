# SPDX-License-Identifier: Apache-2.0
"""A training session: bad programmes are refused in one line, good ones carried out to the stride."""

import numpy as np
import pytest

from pam_orthosis.control.activity import shares
from pam_orthosis.control.programme import read_programme
from pam_orthosis.control.session import STOPS_MOST, Session
from pam_orthosis.errors import OrthosisError

STAGES = """
stages:
  - {name: warm-up, strides: 1, cycle_time_s: 3.0, mode: position}
  - {pause_s: 1.5}
  - {name: training, strides: 2, cycle_time_s: 2.6, mode: assist}
"""


def programme(tmp_path, text):
    file = tmp_path / "programme.yaml"
    file.write_text(text, encoding="utf-8")
    return read_programme(file)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("stages: []", "give a list"),
        ("steps: []", "has no 'steps'; did you mean stages?"),
        ("stages: [{strides: 0}]", "strides: 0 is not an integer"),
        ("stages: [{strides: 2.5}]", "2.5 is not an integer"),
        ("stages: [{strides: true}]", "True is not an integer"),
        ("stages: [{strides: 2, pause_s: 3}]", "either strides or pause_s"),
        ("stages: [{name: nothing}]", "either strides or pause_s"),
        ("stages: [{pause_s: 3}]", "none has strides"),
        ("stages: [{pause_s: -3}, {strides: 1}]", "stage 1: pause_s: -3"),
        ("stages: [{pause_s: .nan}, {strides: 1}]", "stage 1: pause_s: nan"),
        ("stages: [{pause_s: 3, mode: assist}, {strides: 1}]", "a pause has nothing but"),
        ("stages: [{strides: 2, mode: gentle}]", "stage 1: control.cooperation.mode"),
        ("stages: [{strides: 2, cycle_time_s: 0.01}]", "stage 1: scenario.cycle_time"),
        ("stages: [{strides: 2, stiffness: 1e6}]", "stage 1: control.cooperation.stiffness"),
        ("stages: [{strides: 2, name: 5}]", "name: give a text"),
        ("stages: [{strides: 2000, cycle_time_s: 8.0}]", "at most 7200 s"),
        ("left: {control.position.c1: 30.0}\nstages: [{strides: 1}]", "no parameter of a leg"),
        ("left: {plant.nothing: 30.0}\nstages: [{strides: 1}]", "plant.nothing"),
        ("scenario: steps\nstages: [{strides: 1}]", "steps is no gait"),
        ("resume_s: 0\nstages: [{strides: 1}]", "resume_s: 0"),
    ],
)
def test_an_unusable_programme_is_refused(tmp_path, text, problem):
    with pytest.raises(OrthosisError) as refused:
        programme(tmp_path, text)
    assert problem in str(refused.value)
    assert "programme.yaml" in str(refused.value)


def test_stages_follow_each_other_and_the_share_is_that_of_each_leg(tmp_path):
    given = programme(tmp_path, "right: {plant.person.volition.share: 0.1}\n" + STAGES)
    trained = Session(given).run()
    assert [one.stage for one in trained.strides] == [0, 2, 2]
    assert not trained.trips
    assert not trained.ended
    (warm, first, last), period = trained.strides, 0.005
    assert (last.end - last.first) * period == pytest.approx(2.6, abs=period)
    assert warm.end * period == pytest.approx(1.0 + 2.0 / 2 + 3.0, abs=2 * period)  # hold, ramp, one cycle
    assert (first.first - warm.end) * period == pytest.approx(2.0 + 1.5, abs=2 * period)
    # they slow down within 2 s, and rest as long as asked for
    still = trained.signals["left"]["reference_velocity"][first.first - 290 : first.first]
    assert np.abs(still).max() < 1e-6  # it rests in the pause
    found = {
        leg: shares(run, given.legs[leg], [(last.first, last.end)])[0] for leg, run in trained.signals.items()
    }
    assert found["left"].share == pytest.approx(0.6, abs=0.1)
    assert found["right"].share == pytest.approx(0.1, abs=0.1)


def test_the_person_walks_at_the_cadence_of_the_stage(tmp_path):
    """Nobody else moves the leg: a person who keeps to a cadence of their own is far away."""
    text = "stages: [{strides: 1, cycle_time_s: 3.0, mode: transparent}]"
    will = "{plant.person.volition.share: 1.0, plant.person.volition.stiffness: 100.0}"
    trained = Session(programme(tmp_path, f"left: {will}\nright: {will}\n{text}")).run()
    assert not trained.trips
    (stride,) = trained.strides
    for run in trained.signals.values():
        error = (run["reference_angle"] - run["true_angle"])[stride.first : stride.end]
        assert np.degrees(np.sqrt(np.mean(error**2))) < 15.0


def test_after_a_trip_both_legs_stop_and_go_on_again(tmp_path):
    given = programme(
        tmp_path, "resume_s: 3.0\nleft: {control.limits.high: 0.9}\nstages: [{strides: 1, cycle_time_s: 3.0}]"
    )
    session = Session(given)
    session.begin()
    index = 0
    while not session.trips:
        session.step(index)
        index += 1
        session._watch(index)
    assert [(one.leg, one.limit) for one in session.trips] == [("left", "range of motion")]
    assert all(leg.trajectory.stopped for leg in session._legs.values())
    for _ in range(900):
        session.step(index)
        index += 1
        session._watch(index)
        if session._tripped is None:
            break
    assert index * 0.005 >= session.trips[0].time + 3.0
    assert not any(leg.trajectory.stopped for leg in session._legs.values())


def test_a_stage_that_trips_again_and_again_ends_the_session(tmp_path):
    given = programme(
        tmp_path,
        "resume_s: 3.0\nleft: {control.limits.high: 0.9}\n"
        "stages: [{name: training, strides: 9, cycle_time_s: 3.0}]",
    )
    trained = Session(given).run()
    assert [one.limit for one in trained.trips] == ["range of motion"] * STOPS_MOST
    assert trained.ended == f"{STOPS_MOST} stops by the safety monitor in the stage training"
