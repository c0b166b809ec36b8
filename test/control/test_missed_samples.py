# SPDX-License-Identifier: Apache-2.0
"""Samples that real time skips: the controllers know how much later the next one is."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.control.anticipation import Anticipation, Pending
from pam_orthosis.control.effects import AddedEffort
from pam_orthosis.control.guard import Overdue, position_guard
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.observer import Observer
from pam_orthosis.control.position import PositionCommand
from pam_orthosis.control.pressure import PressureController, mass_flow_function
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes.graph import MOST_PERIODS, GraphNode

P = load()
STEPS, GAPS, GAP = 850, (470, 590, 630, 670, 750), 3


class Sparse(ClosedLoop):
    """A loop whose controllers do not see some samples; told or not how many they missed."""

    told = True

    def step(self, index):
        measured, reference = self.plant.measure(), self._trajectory.sample(index * self.plant.period_ns)
        seen = [k for k in range(index + 1) if not any(gap <= k < gap + GAP for gap in GAPS)]
        if seen[-1] == index:
            periods = index - seen[-2] if len(seen) > 1 and self.told else 1
            self._voltages = self._answer(measured, reference, periods)
        error = reference.position - self.plant.truth().angle
        self.plant.advance(*self._voltages)
        return (error, *[0.0] * (len(self.signals) - 1))

    def _answer(self, measured, reference, periods):
        command = self._position.step(measured[0], measured[1:], reference, periods)
        voltages = []
        pairs = zip(self._pressure, self._valves, measured[1:], command.pressures, strict=True)
        for controller, valve, pressure, wanted in pairs:
            flow = controller.step(pressure, wanted, command.position, command.velocity, periods)
            voltages.append(valve.step(flow, pressure, periods))
        return voltages


def test_the_knee_follows_although_samples_are_missed():
    loop = Sparse(P, 1)
    assert np.rad2deg(np.abs(loop.run(STEPS)["time"])).max() < 1.2


def test_without_being_told_it_follows_much_worse():
    loop = Sparse(P, 1)
    loop.told = False
    assert np.rad2deg(np.abs(loop.run(STEPS)["time"])).max() > 2.5


@pytest.mark.parametrize("period", [0.002, 0.01])
@pytest.mark.parametrize("periods", [1, 3])
def test_a_steadily_rising_pressure_reference_is_followed_at_its_own_rate(period, periods):
    """V-dot = -c e^2 needs the whole rate of the reference, however many samples are missed."""
    parameters, slope = load({"scenario.control_period": period, "valve.delay": 0.0}), 1e5
    controller, late = PressureController(parameters, "flexor"), 1e4
    for k in range(0, 400 * periods, periods):
        wanted = 2e5 + slope * k * period
        flow = controller.step(wanted - late, wanted, 0.6, 0.0, periods)
    rate = slope + parameters.control.pressure.gain * late
    exact = mass_flow_function(parameters.nominal(), "flexor")(wanted - late, rate, 0.6, 0.0, 0.0)
    assert flow == pytest.approx(float(exact[0]), rel=1e-6)


def test_the_observer_takes_straight_lines_over_missed_samples():
    whole, sparse = Observer(P), Observer(P)
    for k in range(7):
        last = whole.step(0.3 + 0.01 * k, (3e5 + 1e3 * k, 2e5))
    sparse.step(0.3, (3e5, 2e5))
    assert sparse.step(0.36, (3.06e5, 2e5), periods=6) == pytest.approx(last, abs=1e-9)


def _with_effect(name):
    return load({f"effects.{name}.enabled": True})


@pytest.mark.parametrize("name", ["creep", "muscle_hysteresis", "joint_friction"])
def test_what_an_effect_remembers_lives_on_over_missed_samples(name):
    nominal = _with_effect(name).nominal()
    whole, sparse = AddedEffort(nominal), AddedEffort(nominal)
    motion = [Reference(0.3 + 0.01 * k, 2.0, 0.0) for k in range(7)]
    torques = [whole.step(reference, (3e5, 2e5)) for reference in motion]
    sparse.step(motion[0], (3e5, 2e5))
    assert sparse.step(motion[6], (3e5, 2e5), periods=6) == pytest.approx(torques[6], rel=1e-9)
    assert sparse.time == pytest.approx(6 * P.scenario.control_period)
    assert sparse.states == pytest.approx(whole.states, rel=1e-9)


def test_a_command_that_was_held_longer_acts_longer():
    whole, sparse = Pending(0.012, 0.005), Pending(0.012, 0.005)
    for value in (1.0, 4.0, 4.0, 4.0):
        whole.note(value)
    for value in (1.0, 4.0):
        sparse.note(value)
    sparse.hold(3)
    assert list(sparse) == list(whole)
    assert [value for value, _, _ in sparse] == [4.0, 4.0, 4.0]


def test_the_jerk_of_a_reference_is_per_time_not_per_sample():
    nominal = _with_effect("valve_delay").nominal()
    whole, sparse = Anticipation(nominal), Anticipation(nominal)
    steady = [Reference(0.5, 0.0, 3.0 * k) for k in range(4)]
    *_, last = [whole.reference(reference) for reference in steady]
    sparse.reference(steady[0])
    assert sparse.reference(steady[3], periods=3)[:3] == pytest.approx(last[:3])


def test_the_supply_goes_on_sagging_over_missed_samples():
    parameters = _with_effect("supply_sag")
    whole, sparse, unaware = (InverseValveModel(parameters, "flexor") for _ in range(3))
    for _ in range(5):
        *_, last = [whole.step(2e-3, 3e5)]
    for model, periods in ((sparse, 4), (unaware, 1)):
        model.step(2e-3, 3e5)
        answer = model.step(2e-3, 3e5, periods)
        assert (answer == pytest.approx(last, rel=1e-12)) == (model is sparse)


def test_what_lasts_too_long_is_counted_in_time():
    patient = Overdue(10)
    assert [patient.step(holds, periods) for holds, periods in ((True, 8), (True, 9), (True, 1))] == [
        False,
        False,
        True,
    ]
    assert not patient.step(False, 50)


def test_an_unusable_sample_behind_missed_ones_leaves_time_for_the_next():
    guard, step = position_guard(P), P.control.guard.angle_rate * P.scenario.control_period
    low = P.scenario.start_angle
    guard.step(low)
    guard.step(np.nan, periods=3)
    assert guard.step(low + 3.5 * step) == low + 3.5 * step


def test_a_guard_allows_for_the_time_that_has_passed():
    low = P.scenario.start_angle
    far = low + 2.5 * P.control.guard.angle_rate * P.scenario.control_period
    impatient, patient = position_guard(P), position_guard(P)
    for each in (impatient, patient):
        each.step(low)
    assert impatient.step(far) == low
    assert patient.step(far, periods=3) == far


def _lost_after(guard, periods, value, followed=None):
    """Return how many samples of one value a guard takes until the signal is lost."""
    for count in range(1, 99):
        guard.step(value, followed, periods)
        if guard.lost:
            return count
    raise AssertionError("never lost")


@pytest.mark.parametrize("periods", [1, 3])
def test_an_unusable_signal_is_bridged_for_a_time_however_many_samples_there_are(periods):
    guard, bridged = position_guard(P), P.control.guard.hold_time / P.scenario.control_period
    guard.step(P.scenario.start_angle)
    count = _lost_after(guard, periods, np.nan)
    assert 1 + (count - 2) * periods <= bridged < 1 + (count - 1) * periods


@pytest.mark.parametrize("periods", [1, 3])
def test_a_signal_counts_as_frozen_after_a_time_however_many_samples_there_are(periods):
    guard, frozen = position_guard(P), P.control.guard.frozen_time / P.scenario.control_period
    low, moved = P.scenario.start_angle, P.scenario.start_angle + 2 * P.control.guard.angle_motion
    guard.step(low, low)
    count = _lost_after(guard, periods, low, moved)
    assert guard.lost == "frozen"
    assert (count - 1) * periods < frozen <= count * periods


def _released_after(periods, estimated=0.0, wanted=P.scenario.start_angle):
    """Return after how many control periods a knee is released that swings, or follows what is no angle."""

    class Swinging:
        def step(self, angle, *_pressures_reference_periods):
            return PositionCommand((3e5, 3e5), angle, estimated, 0.0, 0.0, False, False)

    guarded, passed = GuardedPosition(P, Swinging()), 0
    while not guarded.health()["vent"]:
        guarded.step(P.scenario.start_angle, (3e5, 3e5), Reference(wanted, 0.0, 0.0), periods)
        passed += periods
    return passed


@pytest.mark.parametrize("periods", [1, 3])
@pytest.mark.parametrize(
    "fault", [{"estimated": 1.1 * P.control.guard.velocity_error}, {"wanted": np.nan}], ids=["swings", "NaN"]
)
def test_a_knee_is_released_after_a_time_however_many_samples_there_are(periods, fault):
    patience = P.control.guard.hold_time / P.scenario.control_period
    assert patience < _released_after(periods, **fault) <= patience + 2 * periods


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
