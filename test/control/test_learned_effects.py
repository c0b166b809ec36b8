# SPDX-License-Identifier: Apache-2.0
"""Controllers that know effects: what each compensation does to the equation that it belongs to."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.bag.read import aligned, read_bag
from pam_orthosis.control import effects, inverse_valve, observer, position, pressure
from pam_orthosis.control.anticipation import Anticipation
from pam_orthosis.control.axis import Axis
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import Reference
from pam_orthosis.model import parameters as parameter_tree
from pam_orthosis.model.effects.valves import opened
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.planning import problem

WALK = Path(__file__).parents[2] / "bags" / "walk"
MECHANICAL = [
    name
    for name, effect in KNEE.catalogue.items()
    if effect.stage in effects.MECHANICAL and name not in effects.UNFORESEEN
]
GAS = [name for name, effect in KNEE.catalogue.items() if effect.stage == "gas"]
PASSED = [name for name, effect in KNEE.catalogue.items() if effect.stage in ("opening", "flow")]
HARDWARE = ("joint_friction", "viscous_friction", "muscle_hysteresis", "valve_lag", "valve_dead_band")


def with_effects(*names, **values):
    """Return parameters whose nominal model has these effects with the values of the plant's tree."""
    flat, known = load().flat(), {}
    for name in names:
        known |= {
            key.removeprefix("plant."): value
            for key, value in flat.items()
            if key.startswith(f"plant.effects.{name}.")
        }
        known[f"effects.{name}.enabled"] = True
    return load({**known, **values})


def tracking(parameters, seconds=8.0, seed=1):
    run = ClosedLoop(parameters, seed).run(round(seconds / parameters.scenario.control_period))
    error = np.rad2deg(run["reference_angle"] - run["angle"])
    variation = np.abs(np.diff(run["extensor_voltage"])).sum() / seconds
    return run, float(np.abs(error).max()), float(np.sqrt(np.mean(error**2))), variation


@pytest.fixture
def interpreted(monkeypatch):
    """Functions that are built for a few seconds of one run: compiling them takes longer than running."""
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")


def test_without_effects_the_controllers_answer_what_they_answered_before():
    """The reference bag was recorded by controllers that could not know effects."""
    names = ("angle", "extensor_pressure", "flexor_pressure", "reference_angle", "reference_velocity",
             "reference_acceleration", "extensor_pressure_reference", "extensor_mass_flow",
             "extensor_voltage", "estimate_angle", "estimate_velocity")  # fmt: skip
    bag = read_bag(WALK, names)
    parameters = load({k: v for k, v in bag.parameters.items() if k in load().flat()})
    _, columns = aligned(*(bag[name] for name in names))
    controller, loop = PositionController(parameters), PressureController(parameters, "extensor")
    valve = InverseValveModel(parameters, "extensor")
    for row in np.array(columns).T[:400]:
        angle, pe, pf, *reference, wanted, flow, voltage, estimated, velocity = row
        command = controller.step(angle, (pe, pf), Reference(*reference))
        assert command[1:3] == pytest.approx((estimated, velocity), rel=1e-9, abs=1e-12)
        assert command.pressures[0] == pytest.approx(wanted, rel=1e-9)
        assert loop.step(pe, wanted, estimated, velocity) == pytest.approx(flow, rel=1e-9, abs=1e-15)
        assert valve.step(flow, pe) == pytest.approx(voltage, rel=1e-9)


def test_finer_steps_of_the_observer_are_no_longer_program():
    """What the compiler has to read decides on how soon a graph with a learned model is ready."""

    def length(parameters):
        code = ca.CodeGenerator("observer.c")
        code.add(observer.observer_step(parameters.nominal()))
        return len(code.dump())

    assert observer.FINE_STEPS_PER_PERIOD > observer.STEPS_PER_PERIOD
    assert length(with_effects(*HARDWARE)) < 1.2 * length(load())


def test_effects_that_are_off_change_no_bit():
    sizes = {
        f"effects.{name}.{e.fitted[0].name}": 0.9 * e.fitted[0].typical for name, e in KNEE.catalogue.items()
    }
    runs = [ClosedLoop(p, 1).run(300) for p in (load(), load(sizes))]
    assert all(np.array_equal(runs[0][name], runs[1][name]) for name in runs[0])


def test_a_torque_of_unknown_phase_is_left_to_the_observer():
    """By a phase that was another run's the controllers would double it."""
    assert effects.added_by_effects(with_effects("periodic_torque").nominal()) is None


@pytest.mark.parametrize(("coordinate", "used"), [("angle", ("unknown_torque",)), ("time", ())])
def test_what_drifted_in_a_recording_is_not_foreseen_in_another(coordinate, used):
    on = {"enabled": True, "coordinate": coordinate, "values": [0.2] * 20}
    nominal = load({f"effects.unknown_torque.{name}": value for name, value in on.items()}).nominal()
    assert effects.known(nominal, *effects.MECHANICAL) == used


@pytest.mark.parametrize("name", MECHANICAL)
def test_the_pressures_give_the_torque_together_with_the_effect(name):
    nominal = with_effects(name).nominal()
    law, command = effects.added_by_effects(nominal), position.command_function(nominal)
    estimate, reference = [0.5, 1.2, 0.7], [0.51, 1.3, 4.0]
    size = law.size1_in(3)
    states = np.linspace(0.5, 0.2, size) * (KNEE.catalogue[name].scales or np.zeros(size))
    gains = [nominal.flat()[key] for key in (*position.GAINS, *KNEE.live)]
    pressures = command(estimate, reference, 3.6e5, [0.0, 0.0], states, 0.4, gains)[0].full()[:, 0]
    added = float(law(*reference[:2], pressures, states, 0.4)[0])
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    point = ca.vertcat(q, velocity, estimate[2])
    axis = Axis(nominal)
    both = axis.effort(q, velocity, pressures), position.required_effort(point, reference, axis)
    muscles, wanted = (float(v) for v in ca.Function("both", [q, velocity], both)(*estimate[:2]))
    given = added + muscles
    assert given == pytest.approx(wanted, abs=2e-3)
    if name != "extra_foot_mass":
        assert abs(added) > 1e-3


@pytest.mark.parametrize("stretched", [0.045, -0.045])
def test_both_muscles_stay_taut_with_what_an_effect_adds_to_their_forces(stretched):
    """A muscle that an effect slackens pulls by jerks: its damping comes and goes with the elastic force."""
    nominal = with_effects("creep").nominal()
    law, command = effects.added_by_effects(nominal), position.command_function(nominal)
    estimate, states = [0.03, 1.5, 0.0], [stretched, 0.0, -stretched, 0.0]  # creep's springs, m
    gains = [nominal.flat()[key] for key in (*position.GAINS, *KNEE.live)]
    pressures = command(estimate, [*estimate[:2], 0.0], 3.0e5, [0.0, 0.0], states, 0.0, gains)[0].full()[:, 0]
    added = law(*estimate[:2], pressures, states, 0.0)[1].full()[:, 0]
    plain = effects.assembled(nominal)
    forces = [one.force for one in plain.signals.actuators.values()]
    elastic = ca.Function("elastic", [plain.x], forces)(np.append(estimate[:2], pressures))
    assert added.min() < -20.0
    assert min(map(float, elastic)) > 3.0
    assert min(float(force) + more for force, more in zip(elastic, added, strict=True)) > 3.0


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("name", ["joint_friction", "muscle_hysteresis", "parallel_elasticity", "creep"])
def test_what_the_effect_explains_is_no_disturbance_any_more(name):
    """The plant has one effect; the estimate of the disturbance shrinks once the nominal model has it too."""
    others = {f"plant.effects.{n}.enabled": n == name for n in KNEE.catalogue}
    same = {f"plant.deviation.{n}": 1.0 for n, _ in load().plant.deviation.items()}
    plant = {**others, **same, "plant.muscle_law": "polynomial", "valve.dead_band": 0.0,
             "scenario.start_hold": 0.3, "scenario.start_ramp": 0.5,
             "scenario.control_period": 0.002}  # fmt: skip
    before = ClosedLoop(load(plant), 1).run(1500)
    knowing = load(plant).changed(
        {k: v for k, v in with_effects(name).flat().items() if k.startswith(f"effects.{name}.")}
        | {k.removeprefix("plant."): v for k, v in plant.items() if k.startswith(f"plant.effects.{name}.")}
    )
    after = ClosedLoop(knowing, 1).run(1500)
    settled = slice(300, None)
    rms = [float(np.sqrt(np.mean(run["disturbance"][settled] ** 2))) for run in (before, after)]
    assert rms[1] < 0.55 * rms[0] + 0.03


@pytest.mark.parametrize("name", GAS)
def test_the_mass_flow_gives_the_wanted_rate_in_the_nominal_gas(name):
    nominal = with_effects(name).nominal()
    model = effects.assembled(nominal, name)
    a, x = model.signals.actuators["flexor"], [0.6, 1.5, 3.1e5, 3.7e5, *[0.0] * (model.x.shape[0] - 4)]
    rate = ca.Function("rate", [model.x, model.u], [a.pressure_rate, a.flow])
    flow = pressure.mass_flow_function(nominal, "flexor")
    found, plain = (float(v) for v in rate(x, [5.0, 5.4, 0.0, 7.0])), load().nominal()
    wanted, passed = found
    assert float(flow(3.7e5, wanted, 0.6, 1.5, 7.0)[0]) == pytest.approx(passed, rel=1e-9)
    unknowing = float(pressure.mass_flow_function(plain, "flexor")(3.7e5, wanted, 0.6, 1.5, 7.0)[0])
    assert ("extensor" in name) == (unknowing == pytest.approx(passed, rel=1e-6))


@pytest.mark.parametrize("name", PASSED)
def test_the_opening_gives_the_wanted_flow_through_the_nominal_valve(name):
    muscle = "flexor" if name.startswith("flexor") else "extensor"
    nominal = with_effects(name).nominal()
    passed = effects.flow_of_opening(nominal, muscle)
    plain, at = load().nominal(), (3.4e5, 7.0e5)
    for flow in (-4e-3, -1e-3, 1e-3, 4e-3):
        found, unknowing = (
            float(passed(inverse_valve.opening_with_effects(flow, *at, b, muscle), *at))
            for b in (nominal, plain)
        )
        assert abs(found - flow) < 0.02 * abs(flow) + 1e-7
        assert abs(found - flow) < 0.3 * abs(unknowing - flow) + 1e-9


def test_a_supply_that_sags_is_met_by_a_wider_opening():
    """The nominal sag is that of the effect's equation; steady, it is its resistance times the flow."""
    parameters = with_effects("supply_sag", **{"effects.supply_sag.resistance": 2e7})
    nominal, state, flow, at = parameters.nominal(), np.zeros(1), 4e-3, 4.5e5
    after = effects.supply_after(nominal, "flexor")
    for _ in range(200):
        state, supply = after(state, flow)
    assert float(supply) == pytest.approx(nominal.valve.supply_pressure - 2e7 * flow, rel=1e-6)
    assert effects.supply_after(load().nominal(), "flexor") is None
    knowing, plain = InverseValveModel(parameters, "flexor"), InverseValveModel(load(), "flexor")
    unknowing = plain.step(flow, at)
    voltages = [knowing.step(flow, at) for _ in range(50)]
    assert voltages[0] == unknowing
    assert voltages[-1] > unknowing + 0.1
    opening = float(inverse_valve.opening_with_effects(flow, at, supply, nominal, "flexor"))
    passed = effects.flow_of_opening(nominal, "flexor")
    assert float(passed(opening, at, supply)) == pytest.approx(flow, rel=1e-3)
    for _ in range(200):
        knowing.step(-flow, at)  # air that leaves draws none
    assert knowing.step(flow, at) == pytest.approx(unknowing, abs=1e-6)


@pytest.fixture
def second_supply_effect(monkeypatch):
    """Another effect of the supply in the catalogue: a long line before the regulator."""
    line = replace(KNEE.catalogue["supply_sag"], name="supply_line", states=("line_sag",), scales=(2.0e4,))
    monkeypatch.setitem(KNEE.catalogue, "supply_line", line)
    parameter_tree._shipped_rows.cache_clear()
    yield {"effects.supply_line.resistance": 1e7, "effects.supply_line.time_constant": 0.5}
    parameter_tree._shipped_rows.cache_clear()


def test_all_effects_of_the_supply_are_compensated_and_planned_with(second_supply_effect):
    on = {"effects.supply_sag.resistance": 2e7, **second_supply_effect}
    on |= {f"effects.{name}.enabled": True for name in ("supply_sag", "supply_line")}
    nominal, flow = load(on).nominal(), 4e-3
    after, state = effects.supply_after(nominal, "flexor"), np.zeros(2)
    for _ in range(2000):
        state, supply = after(state, flow)
    assert float(supply) == pytest.approx(nominal.valve.supply_pressure - 3e7 * flow, rel=1e-6)
    assert effects.supply_scales(nominal) == (1.0e4, 2.0e4)
    own, mass = ca.SX.sym("supply", 2), ca.SX.sym("flow")
    drawn = {"extensor": problem._positive(ca.SX(0), 1e-5), "flexor": problem._positive(mass, 1e-5)}
    then = ca.Function("then", [own, mass], [*effects.supply(nominal, own, drawn)])
    planned = lambda state: then(state, flow)  # noqa: E731
    at_rest, sagging = planned([0.0, 0.0]), planned([3e3, 5e3])
    assert float(at_rest[0] - sagging[0]) == pytest.approx(8e3)
    # each goes by its own resistance and time constant; both round the edge where a valve begins to draw
    fast, slow = np.array(at_rest[1]).ravel().tolist()
    assert fast * 0.05 / 2e7 == pytest.approx(slow * 0.5 / 1e7)
    assert fast * 0.05 / 2e7 == pytest.approx(flow, rel=0.01)


def test_the_voltage_undoes_the_nominal_dead_band():
    parameters = with_effects("valve_dead_band", **{"effects.valve_dead_band.half_width": 0.21})
    model, valve = inverse_valve.InverseValveModel(parameters, "flexor"), parameters.valve
    for flow in (-3e-3, 3e-3):
        opening = float(inverse_valve.opening_for_flow(flow, 3.4e5, valve))
        deviation = model.step(flow, 3.4e5) - valve.closed_voltage
        assert opened(deviation, 0.21) == pytest.approx(
            opening * (valve.maximum_voltage - valve.closed_voltage), rel=0.01
        )


def test_the_lag_is_that_of_the_effects():
    prompt = {"valve.delay": 0.0}
    lag = with_effects("valve_lag").changed(prompt).nominal()
    p = lag.effects.valve_lag
    expected = 2 * p.damping_ratio / (2 * np.pi * p.natural_frequency)
    assert effects.command_lag(lag) == pytest.approx(expected, rel=1e-6)
    both = with_effects("valve_lag", "valve_delay").changed(prompt).nominal()
    assert effects.command_lag(both) == pytest.approx(expected + both.effects.valve_delay.delay, rel=1e-3)
    assert Anticipation(load(prompt).nominal()).horizon == 0.0


def test_readings_lose_their_nominal_errors():
    sensors = effects.Sensors(with_effects("angle_gain", "angle_offset", "flexor_pressure_gain").nominal())
    assert sensors.true("angle", 0.7 * 1.02 + 0.02) == pytest.approx(0.7, abs=1e-6)
    gauge = 2.5e5
    assert sensors.true("flexor_pressure", 101300 + 1.03 * gauge) == pytest.approx(101300 + gauge, abs=1.0)
    assert sensors.true("extensor_pressure", 3.21e5) == 3.21e5


def test_known_effects_lower_the_error_without_chatter():
    """Maps and masses stay nominal; what learning these gives: benchmarks/results/control.jsonl."""
    _, before, rms_before, nervous = tracking(load())
    run, after, rms, variation = tracking(with_effects(*HARDWARE))
    assert after <= 0.6 * before
    assert rms <= min(0.1, 0.55 * rms_before)
    assert variation <= 1.5 * nervous
    assert not run["saturated"].any()


def test_compensation_is_in_no_loop():
    """The known torque follows from reference and pressures alone: another angle changes nothing in it."""
    nominal = with_effects("joint_friction", "muscle_hysteresis").nominal()
    first, second = effects.AddedEffort(nominal), effects.AddedEffort(nominal)
    for index in range(40):
        reference = Reference(0.4 + 0.01 * index, 2.0, 0.0)
        assert first.step(reference, (3e5, 4e5)) == second.step(reference, (3e5, 4e5))
    assert first.step(Reference(0.8, 2.0, 0.0), (3e5, 4e5)) < -0.8  # friction and hysteresis brake
    assert abs(effects.AddedEffort(nominal).step(Reference(0.8, 0.0, 0.0), (3e5, 4e5))) < 1e-9  # rest: none


@pytest.mark.parametrize("half_width", [5e-4, 2e-3, 1e-2])
def test_play_is_followed_at_any_width_and_speed(half_width):
    """A state that is quick beside the steps of its integration would leave its range and shake the knee."""
    nominal = with_effects("backlash", **{"effects.backlash.half_width": half_width}).nominal()
    known, period = effects.AddedEffort(nominal), nominal.scenario.control_period
    for time in np.arange(0.0, 1.0, period):
        motion = 0.6 + 0.5 * np.sin(20 * time), 10 * np.cos(20 * time), -200 * np.sin(20 * time)
        known.step(Reference(*motion), (3.6e5, 3.6e5))
        assert np.abs(known.states).max() < 1 + 1e-6
