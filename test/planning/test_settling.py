# SPDX-License-Identifier: Apache-2.0
"""Plans of muscles that creep: another cycle at the start than later, and each where it belongs."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.control.effects import AddedEffort
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.reference import Reference
from pam_orthosis.control.trajectory import make_trajectory, settling_shape
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load, scenario_overrides
from pam_orthosis.model.shapes import fourier_shape
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning import plan as plan_module
from pam_orthosis.planning.plan import EARLY, NODES, along, make_plan
from pam_orthosis.planning.problem import Cycle, NotFound, nearest_cycle

CREEP = {"effects.creep.enabled": True, "effects.creep.stiffness": 1200.0, "effects.creep.time_constant": 6.0}
LOW_SUPPLY = 5.4e5  # Pa
EFFECTS = ("joint_friction", "muscle_hysteresis")
PHASES = np.arange(NODES) / NODES
MIDDLES = PHASES + 0.5 / NODES
PRESSURES = Cycle(PHASES, np.full((2, NODES), 6e5), 0.0)


def walk_of(nominal):
    """Angle and velocity of the wanted cycle, from heel strike."""
    trajectory = make_trajectory(nominal)
    rows = [trajectory.sample(round((4.0 + phase * 2.0) * 1e9))[:2] for phase in PHASES]
    return (np.array(each) for each in zip(*rows, strict=True))


@pytest.fixture(scope="module")
def creeping():
    """Hardware of a low supply that creeps, which is known."""
    plant = {f"plant.{key}": value for key, value in CREEP.items()}
    hardware = load(
        scenario_overrides("person") | plant | {"plant.deviation.supply_pressure": LOW_SUPPLY / 7e5}
    )
    limits = {"valve.supply_pressure": LOW_SUPPLY, "control.position.maximum_pressure": LOW_SUPPLY - 1.5e4}
    return with_nominal(hardware, CREEP | limits | {f"effects.{name}.enabled": True for name in EFFECTS})


@pytest.fixture(scope="module")
def plan(creeping):
    return make_plan(creeping)


def test_creep_dies_away_as_the_effect_itself_does_cycle_by_cycle():
    nominal = load(CREEP).nominal()
    angle, velocity = walk_of(nominal)
    found = along(nominal, angle, velocity, PRESSURES)
    assert found.settling == pytest.approx(6.0 / 2.0, rel=0.02)
    law = AddedEffort(nominal)
    at = np.arange(400) / 400
    q, rate = (np.interp(at, PHASES, each, period=1.0) for each in (angle, velocity))
    for cycle in range(4):
        torque = [law.step(Reference(*row, 0.0), (6e5, 6e5)) for row in zip(q, rate, strict=True)]
        left = np.exp((EARLY - cycle - MIDDLES) / found.settling)
        expected = found.settled + (found.early - found.settled) * left
        assert np.interp(MIDDLES, at, torque, period=1.0)[:-2] == pytest.approx(expected[:-2], abs=0.06)
    assert np.abs(found.early - found.settled).max() > 1.0  # N m: it matters


@pytest.mark.parametrize("known", [{}, {"effects.joint_friction.enabled": True}])
def test_without_creep_the_start_is_as_all_cycles_are(known):
    nominal = load(known).nominal()
    found = along(nominal, *walk_of(nominal), PRESSURES)
    assert found.settling is None
    assert np.array_equal(found.early, found.settled)


def test_each_swing_is_asked_for_what_was_planned_for_it(creeping, plan):
    assert plan.early.largest > 1.2 * plan.cycle.largest
    trajectory = make_trajectory(creeping.changed(plan.overrides))
    node = round(EARLY * NODES)

    def asked(cycle):  # the ramp loses half a cycle
        reference = trajectory.sample(round((2.0 + (cycle + EARLY) * 2.0) * 1e9))
        return reference.planned.position, reference.mean_pressure

    def planned(each):
        return each.position[node], each.pressures[:, node].mean()

    for found, wanted, away in zip(asked(0), planned(plan.early), (1e-3, 3e3), strict=True):
        assert found == pytest.approx(wanted, abs=away)
    for found, wanted, away in zip(asked(40), planned(plan.cycle), (1e-3, 3e3), strict=True):
        assert found == pytest.approx(wanted, abs=away)
    assert abs(asked(0)[0] - asked(40)[0]) > 3e-3


def test_what_dies_away_is_differentiable():
    shape = settling_shape(fourier_shape([0.1, 0.2], [0, 0.3]), fourier_shape([0.0, 0.4], [0, -0.2]), 3.0)
    step = 1e-5
    for phase in (0.1, 0.7, 2.3):
        before, now, after = (shape(phase + shift) for shift in (-step, 0.0, step))
        for of, rate in ((0, 1), (1, 2)):
            assert now[rate] == pytest.approx((after[of] - before[of]) / (2 * step), rel=1e-6)


def test_a_plan_of_its_own_for_the_start_helps_the_first_swing(creeping, plan):
    alike = {
        key: [0.0] * 25 for key in plan.overrides if key.startswith("scenario.plan.start.") and "sine" in key
    }
    assert len(alike) == 4

    def first_swing(overrides):
        run = ClosedLoop(creeping.changed(overrides), 1).run(800)
        return np.degrees(np.abs(run["reference_angle"] - run["angle"]).max())

    assert first_swing(plan.overrides) < 0.85 * first_swing(plan.overrides | alike)


def test_a_search_begins_where_the_one_before_ended(creeping, plan, monkeypatch):
    """With its flows too: from angle and pressures alone it came to worse cycles than it had."""
    begun = []
    monkeypatch.setattr(ca.Opti, "set_initial", lambda _self, _of, value: begun.append(value))
    monkeypatch.setattr(ca.Opti, "solve", lambda _self: (_ for _ in ()).throw(RuntimeError("not solved")))
    nominal = creeping.nominal()
    angle, velocity = walk_of(nominal)
    with pytest.raises(NotFound):
        nearest_cycle(nominal, plan.cycle, angle, velocity, np.zeros(NODES), 2.0 / NODES)
    states, flows, largest = begun
    assert states[0] == pytest.approx(plan.cycle.position)
    assert states[2:4] * 1e5 == pytest.approx(plan.cycle.pressures)
    assert flows.shape == (2, NODES)
    assert np.abs(flows).max() > 1.0  # g/s
    assert largest == plan.cycle.largest


def test_a_start_that_is_too_far_away_is_refused_as_such(creeping, monkeypatch):
    """Planned within the limit, but at the beginning, before creep has died away so far, beyond it."""

    settled = []

    def nearest(_nominal, start, angle, _velocity, torque, *_):
        settled.append(torque)
        away = 0.1 if np.array_equal(torque, settled[0]) else 0.3
        return Cycle(angle + away, start.pressures, away)

    monkeypatch.setattr(plan_module, "nearest_cycle", nearest)
    with pytest.raises(OrthosisError, match=r"nearest motion found is 2\d deg away"):
        make_plan(creeping)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"scenario.plan.start.angle.cosine": [-0.5] + [0.0] * 24}, "goes 0.5 rad away"),
        ({"scenario.plan.start.pressure.cosine": [4e5] + [0.0] * 24}, "outside control.position's limits"),
        ({"scenario.plan.start.settling": 0.0}, "scenario.plan.start.settling"),
    ],
)
def test_a_start_that_cannot_be_meant_is_refused(changes, told):
    with pytest.raises(OrthosisError, match=told):
        load({"scenario.plan.enabled": True} | changes)
