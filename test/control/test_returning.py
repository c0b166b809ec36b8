# SPDX-License-Identifier: Apache-2.0
"""The knee that was released, or is found somewhere, follows again: whatever vented it, wherever it hangs."""

import numpy as np
import pytest

from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import PositionCommand
from pam_orthosis.control.reference import Reference
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.plant import Plant

P = load()
# s: a hand takes the knee after the stop, has it where it wants it, and frees it after the reset
GRAB, REACH, LET_GO = 0.5, 1.0, 1.0
BOUND_DEG = 1.0
STOP, RESET = 2.0, 4.0
ANGLES = np.linspace(P.leg.joint.minimum, P.leg.joint.maximum, 7)


class Stopped:
    """The plant, its valves vented for a time whatever is asked; meanwhile a hand may carry the knee."""

    def __init__(self, parameters, vented, held=(), angle=0.0):
        self._plant, self._vent = Plant(parameters, 1), parameters.valve.minimum_voltage
        self._vented, self._held, self._angle, self._from = vented, held, angle, None
        self.period_ns, self._steps = self._plant.period_ns, 0

    def measure(self):
        return self._plant.measure()

    def truth(self):
        return self._plant.truth()

    def advance(self, *voltages):
        time = self._steps * self.period_ns * 1e-9
        self._steps += 1
        if self._vented[0] <= time < self._vented[1]:
            voltages = self._vent, self._vent
        if self._held and self._held[0] <= time < self._held[1]:
            self._from = self._plant.state[0] if self._from is None else self._from
            carried = min((time - self._held[0]) / REACH, 1.0)
            self._plant.state[:2] = self._from + carried * (self._angle - self._from), 0.0
        self._plant.advance(*voltages)


def _stopped(scenario, seconds, held=(), angle=0.0, vented=(STOP, RESET), **overrides):
    p = load({**scenario_overrides(scenario), **overrides})
    loop = ClosedLoop(p, plant=Stopped(p, vented, held, angle))
    return p, loop, loop.run(round(seconds / p.scenario.control_period))


def _assert_led_back(p, run, since, settled):
    """From an instant on: pressures and speed within what is stated; the knee follows, and stays there."""
    error = np.rad2deg(np.abs(run["reference_angle"] - run["true_angle"]))
    assert error[run["time"] > settled].max() < BOUND_DEG
    way = (run["time"] > since) & (run["time"] <= settled)
    speed, own = np.abs(run["true_velocity"][way]), np.abs(run["reference_velocity"][way])
    assert speed.max() <= own.max() + 1.2 * p.control.guard.return_speed
    for muscle in ("extensor", "flexor"):
        assert run[f"{muscle}_pressure_reference"].max() <= p.control.position.maximum_pressure
        assert run[f"{muscle}_pressure"].max() < p.valve.supply_pressure
        voltage = run[f"{muscle}_voltage"]
        assert p.valve.minimum_voltage <= voltage.min() <= voltage.max() <= p.valve.maximum_voltage


@pytest.mark.parametrize("scenario", ["default", "person"])
@pytest.mark.parametrize("angle", ANGLES)
def test_after_a_stop_the_knee_follows_again_from_any_angle(scenario, angle):
    free = RESET + LET_GO
    p, loop, run = _stopped(scenario, 12.0, (STOP + GRAB, free), angle)
    _assert_led_back(p, run, free, 9.5)
    assert np.abs(run["true_angle"] - angle)[np.searchsorted(run["time"], free) - 1] < 0.02
    health = loop.health()["position"]
    assert (health["vent"], health["returns"], health["returning"]) == ("", 1, False)


@pytest.mark.parametrize("scenario", ["default", "person"])
@pytest.mark.parametrize("last", [0.5, 2.0])
@pytest.mark.parametrize("stop", [2.25, 3.1, 3.8])
def test_a_stop_at_any_phase_of_the_gait_short_or_long(scenario, stop, last):
    p, _, run = _stopped(scenario, stop + last + 8.0, vented=(stop, stop + last))
    _assert_led_back(p, run, stop + last + 0.5, stop + last + 5.0)


@pytest.mark.parametrize("scenario", ["default", "person"])
@pytest.mark.parametrize("angle", ANGLES[:-1])
def test_a_controller_that_starts_far_from_its_reference_leads_the_knee_there(scenario, angle):
    trajectory = make_trajectory(load(scenario_overrides(scenario)))
    p = load({**scenario_overrides(scenario), "scenario.start_angle": float(angle)})
    run = ClosedLoop(p, 1, trajectory=trajectory).run(round(9.0 / p.scenario.control_period))
    _assert_led_back(p, run, 0.0, 7.0)


@pytest.mark.parametrize("scenario", ["default", "person"])
@pytest.mark.parametrize("last", [0.5, 2.0, 10.0])
def test_after_a_stop_the_knee_follows_again_though_empty_muscles_read_the_same_for_long(scenario, last):
    still = {"plant.sensor.pressure_noise": 0.0, "plant.sensor.angle_noise": 0.0}
    p, loop, run = _stopped(scenario, STOP + last + 8.0, vented=(STOP, STOP + last), **still)
    _assert_led_back(p, run, STOP + last + 0.5, STOP + last + 6.5)
    assert {each["vent"] for each in loop.health().values()} == {""}


class Blind(Stopped):
    """The extensor's pressure sensor shows that of the stop for ever after."""

    seen = None

    def measure(self):
        measured = super().measure()
        if self._steps * self.period_ns * 1e-9 > RESET - 0.5:
            self.seen = measured[1] if self.seen is None else self.seen
            measured = measured._replace(extensor_pressure=self.seen)
        return measured


def test_a_muscle_whose_sensor_shows_it_empty_for_ever_is_not_filled():
    p = load()
    plant, true = Blind(p, (STOP, RESET)), []
    measure = plant.measure
    plant.measure = lambda: true.append(plant.truth().extensor_pressure) or measure()
    loop = ClosedLoop(p, plant=plant)
    run = loop.run(round((RESET + 10.0) / p.scenario.control_period))
    since = run["time"] - RESET
    first, last = np.array(true)[(since > 0.0) & (since < 3.0)], np.array(true)[since > 7.0]
    assert last.max() < 1.05 * first.max()  # asked for a moment, again and again
    assert last.min() < 1.01 * p.valve.ambient_pressure
    assert loop.health()["position"]["vent"]


def test_a_knee_that_is_blocked_is_given_up_and_follows_after_the_next_stop():
    p = load()
    freed, second = 30.0, (31.0, 32.0)
    plant = Stopped(p, (STOP, RESET), (STOP + GRAB, freed), 0.4)
    loop = ClosedLoop(p, plant=plant)
    first = loop.run(round(freed / p.scenario.control_period))
    health = loop.health()["position"]
    assert health["vent"] == f"knee does not follow, given up after {p.control.guard.returns} returns"
    assert health["returns"] == p.control.guard.returns
    late = first["time"] > 25.0
    lowest = p.control.position.minimum_pressure
    for muscle in ("extensor", "flexor"):
        assert (first[f"{muscle}_pressure_reference"][late] == lowest).all()
        assert first[f"{muscle}_pressure"][late].max() < 1.05 * lowest
    plant._vented = second
    rest = loop.run(round(12.0 / p.scenario.control_period))
    error = np.rad2deg(np.abs(rest["reference_angle"] - rest["true_angle"]))
    assert error[-400:].max() < BOUND_DEG
    assert loop.health()["position"]["vent"] == ""


class Steady:
    """A position controller that asks for the same pressures in each sample."""

    def restart(self):
        pass

    def step(self, position, pressures, reference, periods=1):
        return PositionCommand((3e5, 1.6e5), position, 0.0, 0.0, 0.0, False, False)


@pytest.mark.parametrize(("lag", "reason"), [(0.06, ""), (np.inf, "pressure does not follow")])
def test_pressures_that_begin_to_rise_may_lag_but_not_stay_away(lag, reason):
    guarded, ambient = GuardedPosition(P, Steady()), P.valve.ambient_pressure
    rest = Reference(P.at(P.declared.start), 0.0, 0.0)
    asked, reasons = [(ambient, ambient)], []
    for k in range(round(1.2 / P.scenario.control_period)):
        late = k - min(lag, 1e3) / P.scenario.control_period
        command = guarded.step(rest.position, asked[max(0, round(late))], rest)
        asked.append(command.pressures)
        reasons.append(guarded.released())
    assert next(filter(None, reasons), "") == reason
