# SPDX-License-Identifier: Apache-2.0
"""Samples that real time skips: the controllers know how much later the next one is."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.control.guard import angle_guard
from pam_orthosis.control.loop import SIGNALS, ClosedLoop
from pam_orthosis.control.observer import Observer
from pam_orthosis.control.pressure import PressureController, mass_flow_function
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.graph import MOST_PERIODS, GraphNode

P = load()
STEPS, GAPS, GAP = 850, (470, 590, 630, 670, 750), 3


class Sparse(ClosedLoop):
    """A loop whose controllers do not see some samples; told or not how many they missed."""

    told = True

    def _step(self, index):
        measured, reference = self.plant.measure(), self._trajectory.sample(index * self.plant.period_ns)
        seen = [k for k in range(index + 1) if not any(gap <= k < gap + GAP for gap in GAPS)]
        if seen[-1] == index:
            periods = index - seen[-2] if len(seen) > 1 and self.told else 1
            self._voltages = self._answer(measured, reference, periods)
        self.plant.advance(*self._voltages)
        return (reference.angle - self.plant.truth().angle, *[0.0] * (len(SIGNALS) - 1))

    def _answer(self, measured, reference, periods):
        command = self._position.step(*measured, reference, periods)
        voltages = []
        pairs = zip(self._pressure, self._valves, measured[1:], command[:2], strict=True)
        for controller, valve, pressure, wanted in pairs:
            flow = controller.step(pressure, wanted, command.angle, command.velocity, periods)
            voltages.append(valve.step(flow, pressure, periods))
        return voltages


def test_the_knee_follows_although_samples_are_missed():
    loop = Sparse(P, 1)
    assert np.rad2deg(np.abs(loop.run(STEPS)["time"])).max() < 1.5


def test_without_being_told_it_follows_much_worse():
    loop = Sparse(P, 1)
    loop.told = False
    assert np.rad2deg(np.abs(loop.run(STEPS)["time"])).max() > 2.0


@pytest.mark.parametrize("period", [0.002, 0.01])
@pytest.mark.parametrize("periods", [1, 3])
def test_a_steadily_rising_pressure_reference_is_followed_at_its_own_rate(period, periods):
    """V-dot = -c e^2 needs the whole rate of the reference, however many samples are missed."""
    parameters, slope = load({"scenario.control_period": period}), 1e5
    controller, late = PressureController(parameters, "flexor"), 1e4
    for k in range(0, 400 * periods, periods):
        wanted = 2e5 + slope * k * period
        flow = controller.step(wanted - late, wanted, 0.6, 0.0, periods)
    rate = slope + parameters.control.pressure.gain * late
    exact = mass_flow_function(parameters.belief(), "flexor")(wanted - late, rate, 0.6, 0.0, 0.0)
    assert flow == pytest.approx(float(exact), rel=1e-6)


def test_the_observer_takes_straight_lines_over_missed_samples():
    whole, sparse = Observer(P), Observer(P)
    for k in range(7):
        last = whole.step(0.3 + 0.01 * k, 3e5 + 1e3 * k, 2e5)
    sparse.step(0.3, 3e5, 2e5)
    assert sparse.step(0.36, 3.06e5, 2e5, periods=6) == pytest.approx(last, abs=1e-9)


def test_a_guard_allows_for_the_time_that_has_passed():
    low = P.scenario.start_angle
    far = low + 2.5 * P.control.guard.angle_rate * P.scenario.control_period
    impatient, patient = angle_guard(P), angle_guard(P)
    for each in (impatient, patient):
        each.step(low)
    assert impatient.step(far) == low
    assert patient.step(far, periods=3) == far


@pytest.mark.parametrize(
    ("stamp_ns", "periods"),
    [(5_000_000, 1), (5_400_000, 1), (20_000_000, 4), (0, 1), (10**12, MOST_PERIODS)],
)
def test_periods_are_counted_from_the_last_step(stamp_ns, periods):
    node = SimpleNamespace(_origin_ns=7, time_ns=0, period_ns=5_000_000)
    assert GraphNode.periods_since(node, stamp_ns + 7) == periods


def test_the_first_step_is_one_period():
    node = SimpleNamespace(_origin_ns=None, time_ns=0, period_ns=5_000_000)
    assert GraphNode.periods_since(node, 10**18) == 1
