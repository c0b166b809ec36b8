# SPDX-License-Identifier: Apache-2.0
"""A known lag of the valves: errors are met that will be there when a command acts."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.control.anticipation import Anticipation, Pending
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import Reference, Valve
from pam_orthosis.model.parameters import load

DELAY = 0.0087
KNOWING = {"valve.delay": DELAY}
FINE = 1e-4  # s, of the integrations here


@pytest.fixture(autouse=True)
def interpreted(monkeypatch):
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")


def test_commands_on_their_way_fill_the_lag():
    pending = Pending(0.0087, 0.005)
    assert list(pending) == []
    for value in (1.0, 2.0, 3.0):
        pending.note(value)
    parts = list(pending)
    assert [value for value, _, _ in parts] == [3.0, 2.0]  # the first one has acted
    assert [duration for _, duration, _ in parts] == pytest.approx([0.005, 0.0037])
    assert [middle for _, _, middle in parts] == pytest.approx([0.0062, 0.00185])
    none = Pending(0.0, 0.005)
    none.note(1.0)
    assert list(none) == []


def test_the_error_ahead_is_the_one_that_comes():
    """A double integrator with a dead time: what is foretold agrees with its integration."""
    ahead, period = Anticipation(load(KNOWING).nominal()), 0.005
    fine, late = round(period / FINE), round(DELAY / FINE)
    corrections = np.random.default_rng(3).normal(0.0, 50.0, 12)
    acting = np.concatenate([np.zeros(late), np.repeat(corrections, fine), np.zeros(fine)])
    error, rate = [0.01], [0.2]
    for u in acting:
        error.append(error[-1] + FINE * rate[-1] - 0.5 * FINE**2 * u)
        rate.append(rate[-1] - FINE * u)
    still = Reference(0.0, 0.0, 0.0)
    horizon = round(ahead.horizon / FINE)
    for index, correction in enumerate(corrections):
        now = index * fine
        estimate = SimpleNamespace(position=-error[now], velocity=-rate[now], disturbance=0.7)
        angle, velocity, disturbance = ahead.estimate(estimate, still, still)
        # the present command acts during the second half of the period of the horizon: not yet given
        begin = now + late
        left = (horizon - late) * FINE
        assert -velocity == pytest.approx(rate[begin], abs=1e-3)
        assert -angle == pytest.approx(error[begin] + left * rate[begin], abs=1e-5)
        assert disturbance == 0.7
        ahead.note(correction)


def pressure_step(parameters, gain):
    """Return the pressures after a step of the reference, of a gas whose flow comes late, Pa."""
    controller = PressureController(load({**parameters, "control.pressure.gain": gain}), "flexor")
    flow = PressureController(load(KNOWING), "flexor")._flow
    still = float(flow(3e5, 0.0, 0.6, 0.0, 0.0)[0][0])
    slope = 1e6 / (float(flow(3e5, 1e6, 0.6, 0.0, 0.0)[0][0]) - still)
    commands, pressures = [0.0] * round(DELAY / FINE), [3.0e5]
    for _ in range(40):
        commands += [controller.step(pressures[-1], 3.2e5, 0.6, 0.0)] * round(0.005 / FINE)
        for _ in range(round(0.005 / FINE)):
            pressures.append(pressures[-1] + FINE * slope * commands.pop(0))
    return np.array(pressures)


def test_a_pressure_whose_flow_comes_late_settles_without_overshoot_if_that_is_known():
    knowing, unknowing = (pressure_step(p, 90.0) for p in (KNOWING, {"valve.delay": 0.0}))
    assert knowing.max() < 3.2e5 + 500.0
    assert abs(knowing[-1] - 3.2e5) < 100.0
    assert unknowing.max() > 3.2e5 + 3000.0


def test_closed_valves_are_a_command_too():
    controller = PressureController(load(KNOWING), "flexor")
    controller.step(3e5, 3.4e5, 0.6, 0.0)
    for _ in range(2):
        assert controller.step(3e5, Valve.CLOSED, 0.6, 0.0) == 0.0
    assert [value for value, _, _ in controller._pending] == [0.0, 0.0]
