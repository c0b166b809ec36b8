# SPDX-License-Identifier: Apache-2.0
"""The example of a driver keeps the contract of docs/howto/driver.md: without a command it vents."""

import math
import os
import sys

import pytest

pytest.importorskip("rclpy")
import rclpy

from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import dummy_driver, messages

VENT, CLOSED = load().valve.minimum_voltage, load().valve.closed_voltage
OPEN, COMMAND = 7.0, 0.4  # V, position of the spool
EXTENSOR, FLEXOR = 0, 1


class Applied(dummy_driver.EmulatedHardware):
    """The emulated hardware, with a list of what its valves were set to in each period, and when."""

    def __init__(self):
        super().__init__(load())
        self.applied, self.came, self.set = [], [], [CLOSED, CLOSED]
        take, live_on = self._plant.take, self._plant.live_on

        def taken(line, voltage, at_ns):
            self.set[line] = voltage
            self.came.append(at_ns)
            take(line, voltage, at_ns)

        self._plant.take = taken
        self._plant.live_on = lambda: (self.applied.append(tuple(self.set)), live_on())


@pytest.fixture
def hardware(tmp_path, monkeypatch):
    made = Applied()
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid() % 100))
    monkeypatch.setattr(dummy_driver, "EmulatedHardware", lambda _: made)
    return made


@pytest.fixture
def driver(hardware):
    rclpy.init()
    made = dummy_driver.DummyDriver()
    yield made
    made.destroy_node()
    rclpy.shutdown()


def _told(driver, line, *position):
    driver._receiver(line)(messages.joint_state(0, ["valve"], position=position))


def test_a_muscle_without_commands_vents_both(driver, hardware):
    _told(driver, EXTENSOR, COMMAND)
    _told(driver, FLEXOR, COMMAND)
    for _ in range(dummy_driver.SILENCE_PERIODS + 1):
        _told(driver, EXTENSOR, COMMAND)
        driver._act(1)
    assert hardware.applied == [(OPEN, OPEN)] * dummy_driver.SILENCE_PERIODS + [(VENT, VENT)]
    for muscle in (EXTENSOR, FLEXOR):
        _told(driver, muscle, COMMAND)
    driver._act(1)
    assert hardware.applied[-1] == (OPEN, OPEN)


@pytest.mark.parametrize("position", [(), (math.nan,), (math.inf,)], ids=str)
def test_what_is_no_command_is_passed_over(driver, hardware, position):
    _told(driver, EXTENSOR, *position)
    driver._act(1)
    assert hardware.applied == [(CLOSED, CLOSED)]


def test_a_command_beyond_the_valves_range_is_limited(driver, hardware):
    _told(driver, EXTENSOR, 1e9)
    driver._act(1)
    assert hardware.applied == [(load().valve.maximum_voltage, CLOSED)]


def test_it_vents_at_its_end_whatever_ended_it(hardware, monkeypatch):
    class Failing:
        def add_node(self, node):
            for muscle in (EXTENSOR, FLEXOR):
                node._hardware.write(muscle, COMMAND, 0)

        def spin_once(self, timeout_sec):
            raise ValueError("a callback failed")

    monkeypatch.setattr(dummy_driver, "EventsExecutor", Failing)
    monkeypatch.setattr(sys, "argv", ["dummy_driver"])
    monkeypatch.setattr(dummy_driver.process, "caught_signals", list)
    with pytest.raises(ValueError, match="a callback failed"):
        dummy_driver.main()
    assert hardware.set == [VENT, VENT]


def test_a_voltage_is_set_when_it_comes(driver, hardware, monkeypatch):
    monkeypatch.setattr(driver, "_elapsed_ns", lambda: 3_100_000)
    _told(driver, EXTENSOR, OPEN)
    assert hardware.came == [3_100_000]
