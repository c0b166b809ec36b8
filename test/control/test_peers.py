# SPDX-License-Identifier: Apache-2.0
"""Laws by name in the place of backstepping: each by itself, in the loop, and where they are refused."""

import math

import numpy as np
import pytest

from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.laws import Adrc, Pid, ProxySlidingMode, Sample
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.peers import PEERS, PeerController, make_controller
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.reference import Reference
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load, scenario_overrides

LAW, MODE = "control.position.controller", "control.cooperation.mode"
PERIOD, FREE = 0.005, (-1e9, 1e9)
STILL = Reference(0.0, 0.0, 0.0)


def pulled(law, start, steps, room=FREE, outside=0.0):
    """Let a law lead a double integrator to zero; return positions and asked accelerations."""
    position, velocity, rows = start, 0.0, []
    law.begin(position, velocity, 0.0)
    for _ in range(steps):
        asked = law.step(Sample(position, velocity, STILL, room))
        rows.append((position, asked))
        acceleration = asked + outside
        position += PERIOD * velocity + 0.5 * PERIOD**2 * acceleration
        velocity += PERIOD * acceleration
    return np.array(rows).T


def test_the_integral_stands_still_while_its_output_is_cut():
    law = Pid(load({"control.pid.proportional": 0.1, "control.pid.integral": 1.0 / PERIOD,
                    "control.pid.derivative": 0.0}).nominal())  # fmt: skip
    law.begin(0.0, 0.0, 0.0)
    asked = [(-1.0, FREE), (-1.0, (-9.0, 0.5)), (0.25, (-9.0, 0.5))]  # position, room
    given = [law.step(Sample(position, 0.0, STILL, room)) for position, room in asked]
    assert given == pytest.approx([0.1, 0.5, 0.5])
    assert law.step(Sample(0.0, 0.0, STILL, FREE)) == pytest.approx(0.75)


def test_a_pid_sums_what_it_is_made_of():
    law = Pid(load({"control.pid.proportional": 100.0, "control.pid.integral": 10.0,
                    "control.pid.derivative": 3.0}).nominal())  # fmt: skip
    law.begin(0.2, 0.5, 7.0)
    reference = Reference(0.3, 0.1, 2.0)
    first = law.step(Sample(0.2, 0.5, reference, FREE))
    assert first == pytest.approx(2.0 + 7.0 + 100 * 0.1 - 3 * 0.4)
    assert law.step(Sample(0.2, 0.5, reference, FREE, 2)) == pytest.approx(first + 10 * 0.1 * PERIOD)
    assert law.step(Sample(0.2, 0.5, reference, (0.0, 5.0))) == 5.0


@pytest.mark.parametrize("name", list(PEERS))
def test_each_law_takes_a_constant_disturbance_out(name):
    position, _ = pulled(PEERS[name](load().nominal()), 0.0, 2000, outside=20.0)
    assert np.abs(position).max() > 1e-4
    assert abs(position[-1]) < 1e-6


def test_from_far_away_a_proxy_comes_back_as_slowly_as_asked_and_a_pid_overshoots():
    nominal = load({"control.proxy_sliding_mode.time": 0.2}).nominal()
    room = (-60.0, 60.0)
    proxy, asked = pulled(ProxySlidingMode(nominal), 0.5, 300, room)
    pid, _ = pulled(Pid(nominal), 0.5, 300, room)
    assert proxy.min() > -0.005
    assert pid.min() < -0.05
    assert np.abs(asked).max() <= 60.0
    later = proxy[60:140]
    times = -PERIOD / np.diff(np.log(later)).mean()
    assert times == pytest.approx(0.2, rel=0.25)


def test_a_proxy_draws_by_no_more_than_its_limit():
    nominal = load({"control.proxy_sliding_mode.limit": 30.0}).nominal()
    _, asked = pulled(ProxySlidingMode(nominal), 0.5, 50)
    assert np.abs(asked).max() == pytest.approx(30.0)


def test_near_the_reference_a_fast_proxy_is_a_pid():
    nominal = load({"control.proxy_sliding_mode.time": 0.001}).nominal()
    (proxy, _), (pid, _) = (pulled(law(nominal), 0.0, 200, outside=20.0) for law in (ProxySlidingMode, Pid))
    assert pid.max() > 5e-3
    assert proxy == pytest.approx(pid, abs=0.2 * pid.max())


def test_the_extended_state_observer_has_its_three_poles():
    nominal = load().nominal()
    pole = math.exp(-nominal.control.adrc.observer_bandwidth * PERIOD)

    def after(state):
        law = Adrc(nominal)
        law._state = tuple(state)
        return law._observed(0.0, 1)

    matrix = np.array([after(row) for row in np.eye(3)]).T
    assert np.poly(matrix) == pytest.approx(np.poly([pole] * 3), abs=1e-9)


@pytest.fixture(scope="module", params=list(PEERS))
def walked(request):
    """Return a name and a gait with a person under its law, and under backstepping."""
    overrides = scenario_overrides("person") | {"scenario.start_hold": 0.2, "scenario.start_ramp": 0.5}
    runs = [
        ClosedLoop(load({**overrides, LAW: name}), 1).run(700) for name in (request.param, "backstepping")
    ]
    return request.param, *runs


def test_each_law_walks_with_a_person(walked):
    _, run, other = walked
    error = np.degrees(np.abs(run["reference_angle"] - run["true_angle"]))
    assert error.max() < 5.0
    assert not np.array_equal(run["angle"], other["angle"])


def test_the_names_are_those_of_the_configuration():
    row = next(row for row in load().rows() if row.key == LAW)
    assert row.options == ("backstepping", *PEERS)
    assert type(make_controller(load())) is PositionController
    assert type(make_controller(load(), live=True)) is CooperativeController
    assert type(make_controller(load({MODE: "assist"}))) is CooperativeController
    assert type(make_controller(load({LAW: "adrc"}), live=True)) is PeerController


@pytest.mark.parametrize("changes", [{MODE: "assist"}, {"control.position.feedback": False}])
def test_where_a_law_makes_no_sense_it_is_refused_in_one_line(changes):
    with pytest.raises(OrthosisError, match=r"control\.position\.controller = pid ") as refused:
        load({LAW: "pid", **changes})
    assert "\n" not in str(refused.value)


def test_a_law_begins_anew_at_a_joint_that_was_led_away():
    controller = make_controller(load({LAW: "pid"}))
    for _ in range(200):
        controller.step(0.3, (3e5, 3e5), Reference(0.5, 0.0, 0.0))
    wound_up = controller.step(0.3, (3e5, 3e5), Reference(0.3, 0.0, 0.0)).effort
    controller.restart()
    fresh = controller.step(0.3, (3e5, 3e5), Reference(0.3, 0.0, 0.0)).effort
    weight = controller._load(0.3, 0.0, controller._values)[0][1]
    assert fresh == pytest.approx(weight, abs=0.5)
    assert abs(wound_up - weight) > 2.0
