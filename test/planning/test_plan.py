# SPDX-License-Identifier: Apache-2.0
"""Planned gaits: what the controllers' model can make, no more change than needed, and a knee that gains."""

import os
import signal
from time import sleep

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.control import effects
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.reference import Motion, Reference
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.shapes import fourier_shape
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning import plan as plan_module
from pam_orthosis.planning.plan import NODES, RESERVE, fourier, make_plan
from pam_orthosis.planning.problem import Cycle, NotFound

NARROW = 0.35e-8  # m^3/(s Pa)
LOW_SUPPLY = 5.2e5  # Pa; 75 kg take 5.8 bar at a supply of 7 bar
EFFECTS = ("joint_friction", "viscous_friction", "muscle_hysteresis", "valve_lag", "valve_dead_band")
SECONDS = 7.0


@pytest.fixture(scope="module")
def weak():
    """A person on hardware of too low a supply, which is known, as are most of its effects."""
    hardware = load(scenario_overrides("person") | {"plant.deviation.supply_pressure": LOW_SUPPLY / 7e5})
    known = {"valve.supply_pressure": LOW_SUPPLY, "control.position.maximum_pressure": LOW_SUPPLY - 1.5e4}
    return with_nominal(hardware, known | {f"effects.{name}.enabled": True for name in EFFECTS})


@pytest.fixture(scope="module")
def plan(weak):
    return make_plan(weak)


def largest(parameters):
    run = ClosedLoop(parameters, 1).run(round(SECONDS / parameters.scenario.control_period))
    return np.degrees(np.abs(run["reference_angle"] - run["angle"]).max())


def test_a_plan_halves_the_error_that_a_low_supply_leaves_and_brings_it_below_the_bound(weak, plan):
    before, after = largest(weak), largest(weak.changed(plan.overrides))
    assert before > 3.0
    assert after < 0.5 * before
    assert after < 3.0


def test_the_planned_pressures_give_the_planned_motion(weak):
    """The equations of motion hold of a plan, by the model's own function and by differences."""
    nominal = weak.nominal().changed({f"effects.{name}.enabled": False for name in EFFECTS})
    cycle = make_plan(weak.changed({f"effects.{name}.enabled": False for name in EFFECTS})).cycle
    step = nominal.scenario.cycle_time / NODES
    q, w, pe, pf = (ca.SX.sym(name) for name in ("q", "w", "pe", "pf"))
    law = ca.Function("law", [q, w, pe, pf], [Axis(nominal).acceleration(q, w, 0.0, (pe, pf))])
    before, after = np.roll(cycle.position, 1), np.roll(cycle.position, -1)
    rate, found = (after - before) / (2 * step), (after - 2 * cycle.position + before) / step**2
    given = [
        float(law(*row)) for row in zip(cycle.position, rate, *cycle.pressures, strict=True)
    ]  # fmt: skip
    assert np.std(given - found) < 0.05 * np.std(found)


@pytest.fixture(scope="module")
def narrow():
    """A person's parameters with valves that pass an eighth of the air, and the plan."""
    parameters = load(scenario_overrides("person") | {"valve.conductance": NARROW})
    return parameters, make_plan(parameters)


def needed_flow(nominal, muscle):
    """Return (contraction's angle, velocity, absolute pressure, its rate) -> mass flow by Eq. (6), kg/s."""
    s = effects.gas_model(nominal).signals
    a, rate = s.actuators[muscle], ca.SX.sym("rate")
    volume, slopes = a.volume + a.dead_volume, (a.volume_by_pressure, a.volume_by_contraction)
    flow = pneumatics.required_mass_flow(a.pressure, rate, a.rate, volume, *slopes, a.air)
    return ca.Function("flow", [s.coordinate, s.velocity, a.pressure, rate], [flow])


def share_of_the_valve(nominal, plan, muscle):
    """Return the mass flow of each node as a share of what the valve passes, filling or venting."""
    pressure, step = plan.cycle.pressures[KNEE.names.index(muscle)], plan.cycle_time / NODES
    after, next_angle = np.roll(pressure, -1), np.roll(plan.cycle.position, -1)
    here, angle = (pressure + after) / 2, (plan.cycle.position + next_angle) / 2
    rates = (next_angle - plan.cycle.position) / step, (after - pressure) / step
    law, passes = needed_flow(nominal, muscle), effects.flow_of_opening(nominal, muscle)
    needed = np.array([float(law(*row)) for row in zip(angle, rates[0], here, rates[1], strict=True)])
    supply = nominal.valve.supply_pressure
    most, least = (np.array([float(passes(way, p, supply)) for p in here]) for way in (1.0, -1.0))
    return np.where(needed > 0, needed / most, needed / least)


def test_a_plan_asks_for_nine_tenths_of_the_air_that_an_open_valve_passes_and_no_more(narrow):
    parameters, plan = narrow
    shares = [share_of_the_valve(parameters.nominal(), plan, muscle) for muscle in ("extensor", "flexor")]
    assert 0.85 < np.max(shares) < 0.91


def test_a_plan_keeps_the_limits_and_its_reserve(weak, plan):
    for pressure in plan.cycle.pressures:
        assert pressure.min() >= weak.control.position.minimum_pressure - 1.0
        assert pressure.max() <= weak.control.position.maximum_pressure - RESERVE + 1.0
    assert np.abs(plan.cycle.position - plan.wanted).max() == pytest.approx(plan.cycle.largest, rel=0.01)
    assert plan.cycle.largest > np.radians(0.5)


def test_a_larger_reserve_gives_way_farther(weak, plan):
    careful = make_plan(weak, 1.0e4)
    less = plan.cycle.pressures[1].max() - careful.cycle.pressures[1].max()
    assert less == pytest.approx(1.0e4 - RESERVE, abs=50)
    assert careful.cycle.largest > plan.cycle.largest


def test_where_nothing_lacks_the_plan_is_the_wanted_motion():
    cycle = (plan := make_plan(load(scenario_overrides("person")))).cycle
    assert np.degrees(np.abs(cycle.position - plan.wanted).max()) < 0.02


def test_the_planned_reference_is_differentiable_and_passes_through_the_nodes(weak, plan):
    trajectory = make_trajectory(weak.changed(plan.overrides))
    for time in np.arange(0.5, 6.0, 0.137):
        early, now, late = (trajectory.sample(round((time + shift) * 1e9)) for shift in (-1e-4, 0.0, 1e-4))
        (before, rate_before, _), planned, (after, rate_after, _) = early.planned, now.planned, late.planned
        assert planned.velocity == pytest.approx((after - before) / 2e-4, abs=2e-4)
        assert planned.acceleration == pytest.approx((rate_after - rate_before) / 2e-4, abs=2e-2)
    cycle_s, first = weak.scenario.cycle_time, 4.0  # hold, ramp and its lost half cycle
    for index in range(0, NODES, 7):
        asked = trajectory.sample(round((first + index * cycle_s / NODES) * 1e9))
        assert asked.position == pytest.approx(plan.wanted[index], abs=1e-6)
        assert asked.planned.position == pytest.approx(plan.cycle.position[index], abs=1e-3)


def test_at_rest_nothing_is_asked_for_but_what_is_wanted(weak, plan):
    resting = make_trajectory(weak.changed(plan.overrides)).sample(0)
    assert resting.mean_pressure == weak.control.position.mean_pressure
    assert resting.planned.position == pytest.approx(resting.position, abs=1e-3)
    assert resting.planned.velocity == 0.0


def test_a_search_that_fails_begins_elsewhere_and_loses_nothing_that_was_found(monkeypatch):
    starts = []

    def nearest(_nominal, start, angle, *_):
        starts.append(start)
        if len(starts) != 2:
            raise NotFound("none")
        return Cycle(angle, start.pressures, 0.01)

    monkeypatch.setattr(plan_module, "nearest_cycle", nearest)
    assert make_plan(load()).cycle.largest == 0.01
    assert np.ptp(starts[0].pressures[1]) > 0
    assert np.ptp(starts[1].pressures[1]) == 0


def test_a_valve_is_asked_for_all_it_passes_only_if_nothing_is_found_otherwise(monkeypatch):
    asked = []

    def nearest(_nominal, start, angle, _velocity, _torque, _period, share):
        asked.append(share)
        if share < 1.0:
            raise NotFound("none")
        return Cycle(angle, start.pressures, 0.01)

    monkeypatch.setattr(plan_module, "nearest_cycle", nearest)
    make_plan(load())
    assert asked == [0.9, 0.9, 1.0, 1.0]


def test_fourier_coefficients_are_those_of_the_shape():
    shape = fourier_shape([0.1, 0.02, 0.0, 0.03], [0.0, -0.04, 0.05, 0.0])
    values = np.array([shape(k / NODES)[0] for k in range(NODES)])
    again = fourier_shape(*fourier(values))
    assert [again(x)[0] for x in (0.1, 0.43)] == pytest.approx([shape(x)[0] for x in (0.1, 0.43)], abs=1e-6)


def test_the_controllers_follow_the_plan_and_guard_it():
    p = load()
    plain, planned, broken = (
        GuardedPosition(p, PositionController(p)).step(0.1, (3.6e5, 3.6e5), reference)
        for reference in (
            Reference(0.2, 0.3, 0.0, 4e5),
            Reference(0.5, 0.0, 0.0, 4e5, Motion(0.2, 0.3, 0.0)),
            Reference(0.5, 0.0, 0.0, 4e5, Motion(0.2, float("nan"), 0.0)),
        )
    )
    assert planned == plain
    assert broken != plain
    assert all(np.isfinite([*broken.pressures, *broken[1:5]]))


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"scenario.plan.angle.cosine": [0.5] + [0.0] * 24}, "goes 0.5 rad away"),
        ({"scenario.plan.pressure.cosine": [3.6] + [0.0] * 24}, "outside control.position's limits"),
        ({"scenario.plan.angle.sine": [0.0]}, "list of 25 numbers"),
        ({"scenario.cycle_time": 1.25}, "is for a cycle of 2.0 s"),
    ],
)
def test_a_plan_that_cannot_be_meant_is_refused(changes, told):
    with pytest.raises(OrthosisError, match=told):
        load({"scenario.plan.enabled": True} | changes)


def test_the_verb_writes_a_model_that_keeps_what_was_known(tmp_path, capsys, page_fits):
    known, out = tmp_path / "known.yaml", tmp_path / "planned.yaml"
    patch.write(known, {"valve.conductance": 2.6e-8, "gap.replay.warm_up": 3.0})
    page = tmp_path / "plan.html"
    given = ["--scenario", "person", "--model", str(known)]
    assert main(["plan", *given, "--out", str(out), "--page", str(page)]) == 0
    written = patch.read(out)
    assert written["valve.conductance"] == 2.6e-8
    assert written["gap.replay.warm_up"] == 3.0
    assert load(scenario_overrides("person") | written).scenario.plan.enabled
    with pytest.raises(OrthosisError, match="for another motion, or for a leg with or without a person"):
        load(written)
    assert "within 0.00 deg" in capsys.readouterr().out
    assert main(["plan", "--out", str(out)]) == 2
    assert "exists" in capsys.readouterr().err
    page_fits(page)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--scenario", "diagnostic"], "has no cycle to plan"),
        (["--reserve", "5"], "give 0 to 1 bar"),
        (
            ["--scenario", "person-heavy", "--param", "scenario.cycle_time=0.5"],
            "a slower cycle, a lighter person or more supply",
        ),
    ],
)
def test_what_cannot_be_planned_is_told_in_one_line(tmp_path, capsys, options, told):
    assert main(["plan", *options, "--out", str(tmp_path / "plan.yaml")]) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("pam-orthosis: error: ")
    assert told in said
    assert not (tmp_path / "plan.yaml").exists()


def test_an_interrupted_search_writes_nothing(weak, monkeypatch):
    """CasADi turns what SIGINT raises into a failure of its own."""

    def swallowing(_self):
        try:
            os.kill(os.getpid(), signal.SIGINT)
            sleep(5.0)
        except KeyboardInterrupt:
            raise RuntimeError("Solver failed: NonIpopt_Exception_Thrown") from None

    monkeypatch.setattr(ca.Opti, "solve", swallowing)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            make_plan(weak)
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_plan_is_for_the_motion_and_the_leg_that_it_was_made_for(weak, plan):
    assert weak.changed(plan.overrides).scenario.plan.made_for == plan.made_for
    for other in (
        {"leg.person.present": False},
        {"scenario.start_phase": 0.5},
        {"scenario.trajectory": "sine"},
    ):
        with pytest.raises(OrthosisError, match="for another motion"):
            weak.changed(plan.overrides | other)
    unknown = plan.overrides | {"scenario.plan.made_for": ""}
    assert weak.changed(unknown | {"scenario.start_phase": 0.5}).scenario.plan.enabled
