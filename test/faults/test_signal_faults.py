# SPDX-License-Identifier: Apache-2.0
"""Faults of signals: whatever comes in, what goes out is finite and within limits, and the guards tell."""

import math
from copy import copy
from pathlib import Path

import campaign_path  # noqa: F401
import numpy as np
import pytest
from fault_campaign import signals
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.control.guard import SignalGuard
from pam_orthosis.control.guarded import GuardedPosition, GuardedPressure, GuardedValve
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import load

P = load()
BAGS = Path(__file__).parents[2] / "bags"
ANY = st.floats(allow_nan=True, allow_infinity=True)
SENSIBLE = st.floats(-1e6, 1e6)
NUMBER = ANY | SENSIBLE
PRESSURE = NUMBER | st.floats(5e4, 9e5)
CASES = settings(max_examples=60, deadline=None)
# compiling takes most of the time: one of each serves all examples
VALVE, PRESSURE_CONTROLLER = InverseValveModel(P, "extensor"), PressureController(P, "extensor")


def _samples(*strategies):
    return st.lists(st.tuples(*strategies), min_size=1, max_size=12)


@CASES
@given(_samples(NUMBER, PRESSURE))
def test_no_voltage_leaves_that_is_not_finite_and_in_range(samples):
    guarded = GuardedValve(P, VALVE)
    for flow, pressure in samples:
        assert P.valve.minimum_voltage <= guarded.step(flow, pressure) <= P.valve.maximum_voltage


@CASES
@given(_samples(PRESSURE, PRESSURE, NUMBER, NUMBER))
def test_every_mass_flow_is_finite(samples):
    guarded = GuardedPressure(P, copy(PRESSURE_CONTROLLER))
    for sample in samples:
        assert math.isfinite(guarded.step(*sample))


@settings(max_examples=20, deadline=None)
@given(_samples(NUMBER, PRESSURE, PRESSURE, NUMBER, NUMBER, NUMBER))
def test_every_pressure_reference_is_within_the_limits(samples):
    guarded = GuardedPosition(P, PositionController(P))
    for angle, extensor, flexor, *reference in samples:
        command = guarded.step(angle, (extensor, flexor), Reference(*reference))
        assert all(map(math.isfinite, (*command.pressures, *command[1:5])))
        for pressure in command.pressures:
            assert P.valve.ambient_pressure <= pressure <= P.control.position.maximum_pressure


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf, 99.0])
def test_a_model_that_fails_cannot_reach_the_valve(broken):
    class Broken:
        def step(self, flow, pressure, periods):
            return broken

    voltage = GuardedValve(P, Broken()).step(0.0, 3e5)
    assert P.valve.minimum_voltage <= voltage <= P.valve.maximum_voltage


CHOSEN = ("NaN now and then", "NaN for good", "frozen", "valve stuck at fill", "supply lost")


@pytest.mark.parametrize(
    ("fault", "target", "place"),
    [case for case in signals.places() if case[0].name in CHOSEN and "flexor" not in case[1]],
    ids=lambda value: getattr(value, "name", value),
)
def test_pressures_and_joint_stay_within_limits_and_the_reaction_is_told(fault, target, place):
    outcome = signals.suffer(fault, place, 1.37, 1)
    assert signals.complaints(fault, outcome, P) == []


@settings(max_examples=4, deadline=None, derandomize=True)
@given(st.sampled_from(signals.places()), st.floats(0.2, 4.0), st.integers(1, 99))
def test_limits_hold_for_any_fault_at_any_time(case, start, seed):
    fault, _, place = case
    outcome = signals.suffer(fault, place, start, seed)
    assert [words for words in signals.complaints(fault, outcome, P) if "reaction" not in words] == []


def _unguarded(loop):
    """Take the guards out of a closed loop."""
    loop._position = loop._position._controller
    loop._pressure = [each._controller for each in loop._pressure]
    loop._valves = [each._model for each in loop._valves]
    return loop


LEARNED = {
    key.removeprefix("plant."): value
    for key, value in P.flat().items()
    if key.startswith(("plant.effects.joint_friction.", "plant.effects.valve_lag."))
}


@pytest.mark.parametrize("nominal", [{}, LEARNED], ids=["paper", "learned"])
def test_without_faults_the_numbers_are_those_without_guards(nominal):
    p = load({**signals.QUICK, **nominal})
    guarded, plain = ClosedLoop(p, 1), _unguarded(ClosedLoop(p, 1))
    first, second = guarded.run(600), plain.run(600)
    assert all(np.array_equal(first[name], second[name]) for name in first)
    assert not any(any(told.values()) for told in guarded.health().values())


@pytest.mark.parametrize("name", ["walk", "person"])
def test_recorded_runs_pass_the_guards_to_the_bit(name):
    sampled = ("angle", "extensor_pressure", "flexor_pressure")
    wanted = ("reference_angle", "reference_velocity", "reference_acceleration")
    answered = ("extensor_pressure_reference", "estimate_angle", "estimate_velocity", "extensor_mass_flow")
    bag = read_bag(BAGS / name, sampled + wanted + answered)
    p = load({key: value for key, value in bag.parameters.items() if key in P.flat()})
    pairs = [
        (GuardedPosition(p, PositionController(p)), PositionController(p)),
        (GuardedPressure(p, PressureController(p, "extensor")), PressureController(p, "extensor")),
        (GuardedValve(p, InverseValveModel(p, "extensor")), InverseValveModel(p, "extensor")),
    ]
    for angle, pe, pf, q, dq, ddq, *answer, flow in np.array(aligned(*bag.series.values())[1]).T.tolist():
        arguments = [(angle, (pe, pf), Reference(q, dq, ddq)), (pe, *answer), (flow, pe)]
        for (guarded, plain), given_ in zip(pairs, arguments, strict=True):
            assert guarded.step(*given_) == plain.step(*given_)
    assert not any(any(guarded.health().values()) for guarded, _ in pairs)


def test_a_signal_that_repeats_itself_is_lost_only_if_what_it_follows_moved_meanwhile():
    guard = SignalGuard(0.0, 10.0, 1.0, hold=2, frozen=5, moved=0.5, start=3.0)
    for followed in (None, *[4.0] * 20):
        guard.step(3.0, followed)
    assert not guard.lost
    guard.step(3.0, 4.6)
    assert guard.lost == "frozen"


def test_unusable_samples_are_bridged_for_the_time_that_is_allowed():
    guard = SignalGuard(0.0, 10.0, 1.0, hold=2, frozen=5, moved=0.5, start=3.0)
    assert [guard.step(value) for value in (4.0, math.nan, 12.0, 4.5)] == [4.0, 4.0, 4.0, 4.5]
    assert not guard.lost
    for value in (9.0, 9.1, 9.2):
        guard.step(value)
    assert (guard.lost, guard.last, guard.held) == ("jumped", 4.5, 5)
