# SPDX-License-Identifier: Apache-2.0
"""A session in the graph: led by parameters and services, recorded, read by the same report."""

import json
import subprocess
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from live_runs import LIMIT_S
from rosbags.rosbag2 import Reader

from pam_orthosis.control.programme import read_programme
from pam_orthosis.control.session import Course, as_led
from pam_orthosis.report.pages.session import shown

pytest.importorskip("rclpy")
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParametersAtomically
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from pam_orthosis.nodes.session_conductor import UNDER_WAY, LedLeg, SessionConductor

PROGRAMME = """
right: {plant.person.volition.share: 0.1}
stages:
  - {name: calm, strides: 1, cycle_time_s: 2.0, mode: position}
  - {name: eager, strides: 1, cycle_time_s: 1.7, mode: assist}
  - {pause_s: 0.2}
"""
PERIOD_S = 0.005


@pytest.fixture(scope="module")
def programme(tmp_path_factory):
    file = tmp_path_factory.mktemp("session") / "programme.yaml"
    file.write_text(PROGRAMME, encoding="utf-8")
    return file


@pytest.fixture(scope="module")
def led(programme):
    bag = programme.parent / "monday"
    command = [sys.executable, "-m", "pam_orthosis.cli.main", "session", str(programme), "--graph"]
    command += ["--composed", "--json", "--out", str(bag)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout), bag


def test_the_graph_carries_the_programme_out_and_the_report_reads_it(led):
    said, bag = led
    assert said["completed"]
    assert said["strides"] == 2
    read = shown(bag)
    session = read.session
    assert [one.stage for one in session.strides] == [0, 1]
    assert [stage["mode"] for stage in session.stages] == ["position", "assist", "assist"]
    with Reader(bag) as reader:
        assert {f"/{leg}/allowed_pressure" for leg in ("left", "right")} <= set(reader.topics)
    calm, eager = session.strides
    for leg, signals in session.signals.items():
        speed = np.abs(signals["reference_velocity"])
        rests = speed[eager.end :] < 1e-6
        assert np.convolve(rests, np.ones(20)).max() > 19.5, leg  # it has been brought to rest, for 0.1 s
        assert speed[calm.first : calm.end].max() > 1.0
    # it becomes faster on the way: how soon is when the request has come, which no simulated time waits for
    assert 1.7 < (eager.end - eager.first) * PERIOD_S <= 2.0
    left, right = (read.legs[leg].share for leg in ("left", "right"))
    assert np.all(left > right)


class Answer:
    """What a service answers, when it is there."""

    def __init__(self):
        self.success, self.message, self.there = True, "", False

    def done(self):
        return self.there

    def result(self):
        return self


def test_a_led_leg_asks_for_what_changes_and_is_resumed_once(programme):
    given, asked, answer = read_programme(programme), [], Answer()

    def call(service, values):
        asked.append((service, values))
        return answer

    leg = LedLeg(given.legs["left"].changed(given.stages[0].changes), call)
    for stage in (*given.stages, given.stages[1]):
        leg.enter(stage, 0)
    assert asked == [
        ("trajectory_publisher", {"scenario.cycle_time": 1.7}),
        ("plant_simulator", {"plant.person.volition.cycle_time": 1.7}),
        ("position_controller", {"control.cooperation.mode": "assist"}),
        ("trajectory_publisher/stop", None),
        ("plant_simulator", {"plant.person.volition.resting": True}),
        ("trajectory_publisher/start", None),
        ("plant_simulator", {"plant.person.volition.resting": False}),
    ]
    report = DiagnosticStatus(level=DiagnosticStatus.ERROR, message="speed 10.5 beyond 10 at 3.000 s")
    leg.hear(report)
    assert [trip.limit for trip in leg.trips()] == ["speed"]
    asked.clear()
    assert leg.resume() == leg.resume() == UNDER_WAY
    answer.there = True
    assert leg.resume() == ""
    assert asked == [("safety_monitor/resume", None)]
    leg.hear(report)  # it was on the way meanwhile
    assert not leg.trips()


def answered(service, values, refused):
    """Return the answer of a node that refuses one service, or one key."""
    fine = refused not in (service, *(values or {}))
    if values is None:
        response = Trigger.Response(success=fine, message="" if fine else "not in this mood")
    else:
        result = SetParametersResult(successful=fine, reason="" if fine else "not with this law")
        response = SetParametersAtomically.Response(result=result)
    return SimpleNamespace(done=lambda: True, result=lambda: response)


@pytest.mark.parametrize(
    ("refused", "why"),
    [
        ("", ""),
        (
            "control.cooperation.mode",
            "right/position_controller refuses control.cooperation.mode = assist: not with this law",
        ),
        ("trajectory_publisher/stop", "right/trajectory_publisher/stop is refused: not in this mood"),
    ],
)
def test_a_session_of_which_a_node_refuses_something_comes_to_rest_and_says_why(programme, refused, why):
    given, asked = read_programme(programme), []

    def call(leg, service, values):
        asked.append((leg, service))
        return answered(service, values, refused * (leg == "right"))

    legs = {name: LedLeg(as_led(one, given, 1.0), partial(call, name)) for name, one in given.legs.items()}
    conductor = SessionConductor.__new__(SessionConductor)
    conductor._legs, conductor.course = legs, Course(given, legs)
    conductor.course.begin()
    for step in range(2000):
        seconds, part = divmod(step * 5_000_000, 1_000_000_000)
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = seconds, part
        conductor._on_clock(clock)
    assert conductor.course.over
    assert conductor.course.ended == why
    assert {(leg, "trajectory_publisher/stop") for leg in legs} <= set(asked)
