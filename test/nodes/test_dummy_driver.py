# SPDX-License-Identifier: Apache-2.0
"""The emulated hardware of the example of a driver; what all drivers do is in test_driver.py."""

import pytest

pytest.importorskip("rclpy")

from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.dummy_driver import EmulatedHardware

PERIOD_NS = 5_000_000


@pytest.fixture
def hardware():
    return EmulatedHardware(load())


def test_it_lives_up_to_the_nearest_period(hardware):
    for at_ns in (0, 2_400_000, 2_600_000, 17_400_000):
        hardware.read(at_ns)
        assert hardware.plant.time_ns == round(at_ns / PERIOD_NS) * PERIOD_NS


def test_a_valve_that_is_opened_fills_its_muscle_and_venting_empties_it(hardware):
    _, before, _ = hardware.read(0)
    hardware.write(0, 0.5, 0)
    _, filled, other = hardware.read(300_000_000)
    assert filled > before + 1e5
    hardware.vent(300_000_000)
    _, vented, _ = hardware.read(900_000_000)
    assert vented < other < filled


def test_a_command_counts_from_the_instant_at_which_it_comes(hardware):
    later = EmulatedHardware(load())
    hardware.write(0, 0.5, 0)
    later.write(0, 0.5, 3_100_000)
    assert hardware.read(50_000_000)[1] > later.read(50_000_000)[1] + 1e3
