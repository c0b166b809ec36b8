# SPDX-License-Identifier: Apache-2.0
"""A knee that is much faster or slower than its reference is released, wherever it is."""

import pytest

from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.position import PositionCommand
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import load

P = load()
LIMIT = P.control.guard.velocity_error
HELD = round(P.control.guard.hold_time / P.scenario.control_period)
MEAN = P.control.position.mean_pressure


class Controller:
    """A controller that asks for the mean pressure; its estimate is the knee where it is, at a velocity."""

    velocity = 0.0

    def step(self, angle, *_):
        return PositionCommand((MEAN, MEAN), angle, self.velocity, 0.0, 0.0, False, False)


def released(velocities, wanted=0.0):
    """Return why the knee is released after samples of these velocities, rad/s; empty if it is not."""
    controller = Controller()
    guarded = GuardedPosition(P, controller)
    for controller.velocity in velocities:
        command = guarded.step(0.6, (MEAN, MEAN), Reference(0.6, wanted, 0.0, MEAN))
    told = guarded.health()["vent"]
    assert bool(told) == (command.pressures != (MEAN, MEAN))
    return told


@pytest.mark.parametrize("wanted", [0.0, -3.0, 3.0])
@pytest.mark.parametrize("sign", [-1, 1])
def test_what_is_faster_or_slower_for_longer_than_samples_are_held_is_released(wanted, sign):
    off, near = (wanted + sign * share * LIMIT for share in (1.02, 0.98))
    assert released([off] * (HELD + 1), wanted) == "knee does not follow"
    assert released([off] * HELD + [near] + [off] * HELD, wanted) == ""
    assert released([near] * 100, wanted) == ""
