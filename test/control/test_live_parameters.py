# SPDX-License-Identifier: Apache-2.0
"""Gains that change while a controller runs."""

import pytest

from pam_orthosis.control import live
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load

PERSON = {"leg.person.present": True}
MEASURED = (0.31, (3.2e5, 3.6e5))
REFERENCE = Reference(0.35, 0.4, 1.0)


def _steps(controller, count=5):
    return [controller.step(*MEASURED, REFERENCE) for _ in range(count)]


@pytest.mark.parametrize("key", live.of_position(KNEE))
def test_a_retuned_controller_is_one_that_was_built_so(key):
    start = load(PERSON)
    other = start.changed({key: 1.3 * start.flat()[key]})
    retuned = PositionController(start)
    retuned.retune(other)
    assert _steps(retuned) == _steps(PositionController(other))
    assert _steps(retuned) != _steps(PositionController(start))


def test_the_estimate_goes_on_when_gains_change():
    start = load()
    steady, retuned = PositionController(start), PositionController(start)
    assert _steps(steady) == _steps(retuned)
    retuned.retune(start.changed({"control.position.c1": 10.0}))
    expected, command = _steps(steady, 1)[0], _steps(retuned, 1)[0]
    assert command[1:5] == expected[1:5]
    assert command.pressures != expected.pressures


@pytest.mark.parametrize("key", live.PRESSURE)
def test_a_retuned_pressure_controller_is_one_that_was_built_so(key):
    def steps(controller):
        return [controller.step(3.0e5, wanted, 0.3, 0.0) for wanted in (3.1e5, 3.2e5)]

    start = load()
    other = start.changed({key: 1.3 * start.at(key)})
    retuned = PressureController(start, "extensor")
    retuned.retune(other)
    assert steps(retuned) == steps(PressureController(other, "extensor"))
    assert steps(retuned) != steps(PressureController(start, "extensor"))


def test_the_pressure_controllers_filter_goes_on_when_gains_change():
    start = load({"valve.delay": 0.0})  # else flows on their way count for errors
    other = start.changed({"control.pressure.gain": 20.0})
    steady, retuned = (PressureController(start, "extensor") for _ in range(2))
    for controller in (steady, retuned):
        controller.step(3.0e5, 3.1e5, 0.3, 0.0)
    retuned.retune(other)
    # without a pressure error the gain does not matter, but the filter's memory does
    assert retuned.step(3.2e5, 3.2e5, 0.3, 0.0) == steady.step(3.2e5, 3.2e5, 0.3, 0.0)
    assert retuned.step(3.0e5, 3.2e5, 0.3, 0.0) != steady.step(3.0e5, 3.2e5, 0.3, 0.0)
