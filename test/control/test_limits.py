# SPDX-License-Identifier: Apache-2.0
"""The safety monitor: every limit trips it, it only takes air out, and it goes on by command."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.control.limits import (
    SPASM,
    STALE,
    UNHEEDED,
    Observed,
    SafetyMonitor,
    Trip,
    restrained,
    trips_in,
)
from pam_orthosis.control.loop import ClosedLoop, Watched
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.plant import Plant

PERIOD_NS = 5_000_000
REST = (0.6, 3.4e5, 3.4e5)
OPEN, CLOSED, VENT = (10.0, 10.0), (5.0, 5.0), (0.0, 0.0)


@pytest.fixture(scope="module")
def parameters():
    return load()


class Fed:
    """A monitor that is fed with samples, one a period."""

    def __init__(self, parameters):
        self.monitor, self.index = SafetyMonitor(parameters), 0

    def __call__(self, angle, extensor, flexor, periods=1):
        self.index += periods
        return self.monitor.step(self.index * PERIOD_NS, angle, (extensor, flexor))

    def rest(self, count=30):
        for _ in range(count):
            ceilings = self(*REST)
        return ceilings

    @property
    def tripped(self):
        return self.monitor.trips[0].limit if self.monitor.trips else None


@pytest.fixture
def fed(parameters):
    monitored = Fed(parameters)
    assert monitored.rest() == OPEN
    assert monitored.tripped is None
    return monitored


def moved(fed, acceleration, count):
    """Bend the knee ever faster, as a knee moves; return the last angle before the trip, rad."""
    for step in range(1, count + 1):
        angle = REST[0] + 0.5 * acceleration * (step * 0.005) ** 2
        fed(angle, *REST[1:])
        if fed.tripped:
            return angle
    return angle


def test_a_knee_that_will_leave_its_range_trips(fed):
    assert 0.9 < moved(fed, 15.0, 100) < 1.25
    assert fed.tripped == "range of motion"
    assert fed(*REST) == VENT


@pytest.mark.parametrize(
    ("position", "velocity", "acceleration", "beyond"),
    [
        (0.063, -0.08, -70.9, []),  # a light leg as the muscles take it over: it turns back at 0.02 rad
        (0.063, -0.4, -70.9, ["range of motion"]),
        (-0.18, 0.0, 0.0, ["range of motion"]),
    ],
)
def test_who_hardly_moves_goes_nowhere_yet(parameters, position, velocity, acceleration, beyond):
    now = Observed(position, velocity, acceleration, 4e5, 0.0, 0.0, 0.0)
    assert [name for name, *_ in SafetyMonitor(parameters)._exceeded(now)] == beyond


def test_trips_are_read_as_they_are_written():
    trips = [
        Trip("range of motion", -0.25, -0.17, 1_250_000_000),
        Trip("torque", -51.0, 50.0, 10_000_000_000),
    ]
    assert trips_in(", ".join(map(str, trips))) == trips
    assert trips_in("ok") == []


def test_a_fast_knee_trips(parameters):
    wide = Fed(parameters.changed({"control.limits.high": 50.0, "control.limits.spasm": 1e5}))
    wide.rest()
    moved(wide, 80.0, 50)
    assert wide.tripped == "speed"
    assert 10.0 < wide.monitor.trips[0].value < 11.0


def test_a_large_torque_of_the_muscles_trips(parameters):
    held = Fed(parameters.changed({"control.limits.effort": 20.0}))
    for _ in range(10):
        held(0.2, 1.2e5, 6.0e5)
    assert (held.tripped, held.monitor.trips[0].allowed) == ("torque", 20.0)


def test_a_large_force_of_one_actuator_trips(parameters):
    fed = Fed(parameters.changed({"control.limits.force": 300.0}))
    for _ in range(10):
        fed(*REST[:1], 4.5e5, 4.5e5)
    assert fed.tripped == "force"
    assert 300.0 < fed.monitor.trips[0].value < 320.0


def test_the_shoe_presses_on_the_sole_no_harder_than_its_limit():
    shoe = load({}, machine_named(Path("shoe")))
    fed = Fed(shoe.changed({"control.limits.low": -9.0, "control.limits.high": 9.0}))  # nothing holds it here
    for _ in range(10):
        fed(0.0, 2e5, 5.8e5)
    assert fed.tripped is None
    for _ in range(10):
        fed(0.0, 2e5, 6.2e5)
    assert fed.tripped == "force"
    assert 300.0 < fed.monitor.trips[0].value < 320.0


def test_commands_that_fill_against_the_limits_for_long_trip(fed):
    for _ in range(20):
        fed(*REST)
        fed.monitor.heard(0, 10.0)  # all is well: any command is
    assert fed.tripped is None
    fed(0.6, 6.86e5, 3.4e5)
    for period in range(20):
        fed(*REST)
        fed.monitor.heard(0, 0.0)
        fed.monitor.heard(1, 0.0 if period % 10 == 9 else 0.1)
    assert fed.monitor.venting
    assert UNHEEDED not in [trip.limit for trip in fed.monitor.trips]
    for _ in range(12):
        fed(*REST)
        fed.monitor.heard(1, 0.1)
    assert fed.monitor.trips[-1].limit == UNHEEDED


def test_a_high_pressure_trips_from_the_first_sample_on(parameters):
    fed = Fed(parameters)
    assert fed(0.6, 3.0e5, 6.9e5) == VENT
    assert fed.tripped == "pressure"


@pytest.mark.parametrize("sample", [(np.nan, 3e5, 3e5), (0.6, np.inf, 3e5)])
def test_a_sample_that_is_no_number_trips(fed, sample):
    assert fed(*sample) == VENT
    assert fed.tripped == STALE


def test_samples_that_stay_away_trip(fed):
    assert not fed.monitor.silent((fed.index + 10) * PERIOD_NS)
    assert fed.monitor.silent((fed.index + 11) * PERIOD_NS)
    assert fed.tripped == STALE


def test_a_gap_between_samples_trips(fed):
    assert fed(*REST, periods=11) == VENT
    assert fed.tripped == STALE


def test_resuming_is_by_command_and_slow(fed):
    fed(*REST, periods=11)
    assert fed.rest() == VENT
    assert fed.monitor.resume() == ""
    assert fed(*REST) == VENT  # 3.4 bar are more than is allowed at first
    assert fed(0.6, 2.4e5, 2.4e5) == OPEN
    assert fed(*REST) == VENT
    assert fed.rest(100) == VENT
    assert fed.rest(500) == OPEN
    assert fed(0.6, 6.5e5, 6.5e5) == OPEN


def test_it_does_not_resume_beyond_a_limit(fed):
    for step in range(100):
        fed(0.6 + 0.01 * step, *REST[1:])
    for _ in range(30):
        fed(1.59, *REST[1:])
    assert fed.monitor.resume() == "range of motion"
    assert fed.tripped == "range of motion"
    fed.rest()
    assert fed.monitor.resume() == ""
    assert fed.monitor.resume() == "nothing has tripped"


@pytest.mark.parametrize("name", ["knee", "ankle", "shoe"])
def test_a_walk_of_each_machine_trips_nothing(name):
    parameters = load({}, machine_named(Path(name)))
    monitor = SafetyMonitor(parameters)
    ClosedLoop(parameters, 1, plant=Watched(Plant(parameters, 1), monitor)).run(500)
    assert monitor.trips == []


def test_it_never_adds_air():
    assert restrained((2.0, 7.0), (10.0, 5.0)) == (2.0, 5.0)


@pytest.fixture(scope="module")
def spasm():
    overrides = scenario_overrides("person-spasm") | {
        "plant.person.spasm.start": 5.75,
        "plant.person.spasm.torque": 30.0,
    }
    parameters = load(overrides)
    monitor = SafetyMonitor(parameters)
    loop = ClosedLoop(parameters, 1, plant=Watched(Plant(parameters, 1), monitor))
    run = loop.run(1400)
    return run, monitor.trips[0], monitor, loop


def test_a_spasm_softens_the_joint_within_100_ms(spasm):
    run, first, *_ = spasm
    assert first.limit == SPASM
    at = first.time_ns * 1e-9
    assert 5.75 < at < 5.85
    pressures = np.maximum(run["extensor_pressure"], run["flexor_pressure"])
    soft = run["time"][(run["time"] > at) & (pressures < 2.65e5)][0]
    assert soft - at < 0.1
    at_trip = pressures[run["time"] == at][0]
    assert pressures[run["time"] > soft].max() < 0.65 * at_trip  # the spasm compresses what is left


def test_after_a_spasm_the_knee_is_led_back_by_command(spasm):
    *_, monitor, loop = spasm
    loop.run(200)
    assert monitor.resume() == ""
    run = loop.run(1600)
    late = np.abs(run["reference_angle"] - run["angle"])[-200:]
    assert not monitor.trips
    assert np.degrees(late.max()) < 3.0
