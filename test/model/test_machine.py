# SPDX-License-Identifier: Apache-2.0
"""Machines of files: what they declare, what they do, and how a wrong file is refused."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate
from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.delay import computing_ns, line_ns
from pam_orthosis.model.machines import KNEE, RIG, machine_named, read_machine
from pam_orthosis.model.parameters import config_folder, load
from pam_orthosis.model.plant import Plant, true_hardware
from pam_orthosis.model.truth import with_nominal

SLIDE = """
meaning: a double-acting cylinder on a carriage
mechanism: {kind: translation, inertia: 5.0, minimum: 0.0, maximum: 0.3, start: 0.1}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}
  pull: {kind: cylinder, area: 6.0e-4, volume: 2.0e-5, length: 0.3,
         transmission: {arm: -1.0, contraction: 0.3}}
sensor: {noise: 1.0e-5}
"""
ARM = """
meaning: a forearm between a muscle and a spring
mechanism: {kind: rotation, inertia: 0.1, damping: 0.4, stiffness: 20.0, rest: -1.0, weight: 3.0,
            minimum: 0.0, maximum: 1.5, start: 0.5}
actuators:
  biceps: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: 0.03}}
sensor: {noise: 0.0}
"""
LEVER = "transmission: {ground: 0.3, lever: 0.05, angle: -2.5, contraction: 0.02}"
PLACES = np.linspace(0.0, 1.5, 9)
QUIET = {"plant.sensor.pressure_noise": 0.0, "plant.sensor.pressure_resolution": 0.0}


@pytest.fixture
def read(tmp_path):
    def from_text(text):
        path = tmp_path / "machine.yaml"
        path.write_text(text, encoding="utf-8")
        return read_machine(path)

    return from_text


def plant_of(machine, overrides=None):
    return Plant(load({**QUIET, **(overrides or {})}, machine))


def test_a_cylinders_carriage_rests_where_both_chambers_hold_it(read):
    plant = plant_of(read(SLIDE))
    for _ in range(40):
        plant.advance(5.0, 5.0)
    y = plant.signals()
    assert y["position"] == pytest.approx(0.1, abs=1e-6)
    assert y["push_tension"] == pytest.approx(y["pull_tension"], abs=1e-3)
    assert plant.measure() == pytest.approx((0.1, y["push_pressure"], y["pull_pressure"]), rel=1e-3)


def test_it_goes_where_the_air_pushes(read):
    plant = plant_of(read(SLIDE))
    for _ in range(40):
        plant.advance(6.0, 4.0)
    assert plant.signals()["position"] > 0.12
    for _ in range(400):
        plant.advance(10.0, 0.0)
    assert plant.signals()["position"] == pytest.approx(0.3, abs=0.02), "the upper stop holds"


def swing(machine, overrides, steps, speed):
    """Return states (steps + 1, states) of a machine with closed valves, pushed from its rest."""
    plant = plant_of(machine, overrides)
    rates = assemble(true_hardware(load(overrides, machine))).function("rates")
    period = integrate.steps_map("period", rates, 10)
    plant.state[1] = speed
    u = plant._held[: len(machine.inputs)]
    states = [plant.state.copy()]
    for _ in range(steps):
        states.append(np.array(period(states[-1], np.tile(u, 10), 1e-4)).ravel())
    return np.array(states)


def test_its_enclosed_air_is_the_spring_of_the_polytropic_law(read):
    """Small oscillation: m w^2 = n (p1 A1^2 / V1 + p2 A2^2 / V2), with the chambers' dead volumes."""
    machine = read(SLIDE)
    p = load(machine=machine)
    states = swing(machine, {}, 400, 1e-3)
    n, dead = 1.05 * p.valve.polytropic_exponent, p.valve.hose.volume
    (_, _, p1, p2), sides = states[0], ((8.0e-4, 0.1), (6.0e-4, 0.2))
    volumes = [2.0e-5 + dead + area * stroke for area, stroke in sides]
    pressures = zip((p1, p2), sides, volumes, strict=True)
    stiffness = n * sum(pressure * area**2 / volume for pressure, (area, _), volume in pressures)
    frequency = np.sqrt(stiffness / 5.0)
    expected = 0.1 + 1e-3 / frequency * np.sin(frequency * 1e-3 * np.arange(401))
    assert frequency * 0.4 > 2 * np.pi, "a whole oscillation"
    assert np.abs(states[:, 0] - expected).max() < 1e-3 * 1e-3 / frequency


def test_its_energy_stays_what_the_gas_and_the_motion_have(read):
    """Without damping: kinetic energy and the gas's p V / (n - 1) less the ambient's work are constant."""
    machine = read(SLIDE)
    p = load(machine=machine)
    states = swing(machine, {}, 300, 0.5)
    n, dead, ambient = 1.05 * p.valve.polytropic_exponent, p.valve.hose.volume, p.valve.ambient_pressure
    x, v, p1, p2 = states.T
    v1, v2 = (2.0e-5 + dead + area * stroke for area, stroke in ((8.0e-4, x), (6.0e-4, 0.3 - x)))
    energy = 2.5 * v**2 + (p1 * v1 + p2 * v2) / (n - 1) + ambient * (v1 + v2)
    assert np.ptp(2.5 * v**2) > 0.1
    assert np.ptp(energy) < 1e-4


def test_a_muscle_turns_an_arm_against_spring_and_weight(read):
    plant = plant_of(read(ARM))
    y, q = plant.signals(), 0.5
    assert 0.03 * y["biceps_tension"] == pytest.approx(20.0 * (q + 1.0) + 3.0 * np.sin(q), abs=0.02)
    assert y["biceps_contraction"] == pytest.approx(0.03 * q)


def test_a_lever_pulls_as_its_triangle_says(read):
    machine = read(ARM.replace("transmission: {arm: 0.03}", LEVER))
    mechanism = machine.mechanism(load(machine=machine))
    q = ca.SX.sym("q")
    contraction = ca.Function("c", [q], list(mechanism.contractions(q)))
    ground, at = np.array([0.3, 0.0]), lambda angle: 0.05 * np.array([np.cos(angle), np.sin(angle)])
    for angle in (0.0, 0.4, 1.2):
        shorter = np.linalg.norm(ground - at(-2.5)) - np.linalg.norm(ground - at(angle - 2.5))
        assert float(contraction(angle)) == pytest.approx(0.02 + shorter, abs=1e-12)


def test_a_table_is_a_smooth_lever(read):
    values = [0.02 + 0.03 * np.sin(place) for place in PLACES]
    table = f"transmission: {{coordinates: {PLACES.tolist()}, contractions: {[float(v) for v in values]}}}"
    machine = read(ARM.replace("transmission: {arm: 0.03}", table))
    q = ca.SX.sym("q")
    (c,) = machine.mechanism(load(machine=machine)).contractions(q)
    told = ca.Function("c", [q], [c, ca.jacobian(c, q)])
    for place, value in zip(PLACES, values, strict=True):
        assert float(told(place)[0]) == pytest.approx(value, abs=1e-12)
    for place in (0.3, 0.71, 1.1):
        assert float(told(place)[1]) == pytest.approx(0.03 * np.cos(place), rel=0.01)
    outside = [float(told(place)[1]) for place in (1.6, 2.0)]
    assert outside[0] == pytest.approx(outside[1]), "beyond its ends it is straight"


def test_effects_follow_from_what_a_machine_has(read):
    slide, arm = read(SLIDE).catalogue, read(ARM).catalogue
    assert {"carriage_friction", "push_leak", "pull_leak", "valve_lag", "supply_sag"} <= set(slide)
    assert not {"joint_friction", "muscle_hysteresis", "extra_foot_mass", "angle_offset"} & set(slide)
    assert {"joint_friction", "biceps_leak", "muscle_hysteresis", "angle_offset"} <= set(arm)
    assert not {"carriage_friction", "backlash"} & set(arm)
    assert arm["muscle_hysteresis"].states == ("biceps_hysteresis", "biceps_hysteresis_far")


def test_its_file_may_change_other_parameters_and_an_override_is_above_it(read):
    machine = read(SLIDE + "values: {control.position.mean_pressure: 4.0e+5, scenario.trajectory: sine}\n")
    parameters = load({"scenario.trajectory": "steps"}, machine)
    assert parameters.control.position.mean_pressure == 4.0e5
    assert parameters.scenario.trajectory == "steps"
    assert load().control.position.mean_pressure != 4.0e5


def test_its_file_takes_sections_and_the_rows_of_identify(read):
    row = "{value: 0.4, unit: m, meaning: a}"
    machine = read(f"{ARM}values:\n  muscle:\n    dmsp_20: {{length: {row}}}\n  valve.delay: 0.002\n")
    parameters = load(machine=machine)
    assert (parameters.muscle.dmsp_20.length, parameters.valve.delay) == (0.4, 0.002)


def test_its_model_has_the_dead_time_of_its_emulated_hardware_if_its_file_states_none(read):
    hose = (
        "plant.delay: {computing: 0.001, converter: 0, valve: 0.002, hose_length: 2, hose_per_metre: 0.003}"
    )
    assert load(machine=read(f"{SLIDE}values: {{{hose}}}\n")).valve.delay == pytest.approx(0.009)
    assert load(machine=read(f"{SLIDE}values: {{{hose}, valve.delay: 0.004}}\n")).valve.delay == 0.004
    plant = load(machine=read(SLIDE))
    assert plant.valve.delay == pytest.approx(1e-9 * (line_ns(plant) + computing_ns(plant)))


def test_a_knee_of_a_users_file_has_the_legs_parameters(read):
    file = config_folder() / "machines" / "knee.yaml"
    knee = read(file.read_text().replace("muscle.dmsp_20", "muscle.dmsp_10"))
    thin, shipped = Plant(load(machine=knee)), Plant(load())
    assert thin.signals()["angle"] == shipped.signals()["angle"]
    assert abs(thin.signals()["extensor_pressure"] - shipped.signals()["extensor_pressure"]) > 1e5


def test_another_nominal_model_leaves_the_hardware_of_any_machine_as_it_is(read):
    machine = read(SLIDE)
    before = load(machine=machine)
    after = with_nominal(before, {"valve.conductance": 0.5 * before.valve.conductance})
    assert true_hardware(after).valve.conductance == pytest.approx(true_hardware(before).valve.conductance)


def test_an_effect_of_its_catalogue_acts(read):
    machine = read(SLIDE)
    on = {"plant.effects.carriage_friction.enabled": True, "plant.effects.carriage_friction.coulomb": 30.0}
    free, rubbing = (swing(machine, overrides, 200, 0.2)[:, 0] for overrides in ({}, on))
    assert np.ptp(rubbing[100:]) < 0.9 * np.ptp(free[100:])


def test_the_shipped_machines_follow_the_same_schema():
    assert KNEE.states == ("angle", "velocity", "extensor_pressure", "flexor_pressure")
    assert RIG.states == ("position", "velocity", "specimen_pressure", "positioner_pressure")
    for machine in (KNEE, RIG):
        machine.check(load())


def test_parameters_know_their_machine(read):
    machine = read(SLIDE)
    own = load(machine=machine)
    changed = own.changed({"valve.temperature": 300.0})
    copies = (own, changed, own.substituted({}), own.nominal(), own.only("valve"))
    assert {id(one.declared) for one in copies} == {id(machine)}
    assert load().declared is load().rig_nominal().declared is KNEE
    with pytest.raises(AttributeError):
        own.declared = KNEE


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("sensor: {noise: 1.0e-5}", "", "a machine has a sensor, which is missing here"),
        ("cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3", "muscle", "push has no parameters: give the"),
        ("kind: translation", "kind: slide", "kind of the mechanism is one of"),
        ("inertia: 5.0, ", "", "the mechanism .translation. has no inertia: mass"),
        ("inertia: 5.0", "inertia: -5.0", "outside .* check its unit"),
        ("inertia: 5.0", "inertia: heavy", "give a number in kg"),
        ("inertia: 5.0", "inertia: [1, 2]", "give a number in kg"),
        ("inertia: 5.0", "inertia: .nan", "not a finite number"),
        ("inertia: 5.0", "mass: 5.0, inertia: 5.0", "has no 'mass'"),
        ("start: 0.1", "start: 0.4", "start lies between its stops"),
        ("kind: cylinder, area", "kind: balloon, area", "kind of actuator push is one of"),
        ("area: 8.0e-4", "aera: 8.0e-4", "did you mean area"),
        ("transmission: {arm: 1.0}", "transmission: {lever: 1.0}", "given by one of"),
        (", transmission: {arm: 1.0}", "", "needs a transmission"),
        ("kind: translation", "kynd: translation", "mechanism has no kind, but 'kynd': give kind, one of"),
        ("push: {kind:", "push: {kynd:", "actuator push has no kind, but 'kynd': give kind, one of muscle"),
        ("push: {kind", "push: {kynd: muscle, kind", "push has no 'kynd'; did you mean kind"),
        ("push:", "Push Rod:", "an actuator cannot be called 'Push Rod'; give one of small letters"),
        ("push:", "truth:", "cannot be called 'truth'; .* but not mechanism, sensor, truth"),
        ("translation, inertia: 5.0, minimum: 0.0, maximum: 0.3",
         "rotation, inertia: 5.0, minimum: 0.0, maximum: 90.0",
         "maximum = 90 rad is outside -7.0 .. 7.0 rad; check its unit"),
        ("meaning: a", "values: {muscle.dmsp_20.box.maximum_contraction: 0.9}\nmeaning: a",
         "maximum_contraction = 0.9 m is outside 0.001 .. 0.5 m"),
        ("sensor: {noise: 1.0e-5}", "sensor: {noise: -1.0}", "outside"),
        ("sensor: {noise: 1.0e-5}", "sensor: plant.sensor.force", "plant.sensor.force_noise"),
        ("meaning: a double", "effects: [leek]\nmeaning: a double", "did you mean leak"),
        ("meaning: a double", "meening: a double", "did you mean meaning"),
        ("meaning: a double-acting cylinder on a carriage", "meaning: [a]", "meaning is a text"),
        ("cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3", "muscle, parameters: muscle.dmsp_2",
         "no parameter muscle.dmsp_2"),
        ("cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3", "muscle, parameters: dmsp_20",
         "actuator push: its parameters are a branch as muscle.dmsp_20, not dmsp_20"),
        ("actuators:\n", "actuators: []\nothers:\n", "others|mapping of names"),
        ("sensor: {noise: 1.0e-5}", "sensor: x", "the machine .* unknown parameter x_noise"),
        ("meaning: a", "start: none.such\nmeaning: a", "the machine .* unknown parameter none.such"),
        ("meaning: a", "start: scenario.trajectory\nmeaning: a", "the machine .* is not a number"),
        ("meaning: a", "takes: {valve.temperature: 3}\nmeaning: a", "valve.temperature is a text, not 3"),
        ("meaning: a", "takes: {valve.temperature: no.such}\nmeaning: a", "the machine .* unknown parameter"),
        ("meaning: a", "takes: {valve.temperature: scenario.trajectory}\nmeaning: a", "give a number in K"),
        ("meaning: a", "branch: valve\nmeaning: a", "branch of a machine is one of effects, rig.effects"),
        ("meaning: a", "experiments: 1\nmeaning: a", "experiments is true or false, not 1"),
        ("meaning: a", "effects: [joint_friction]\nmeaning: a", "cannot have the effect joint_friction"),
        ("area: 8.0e-4", "sizes: {leak: -1.0}, area: 8.0e-4", "the size of leak .* not -1.0"),
        ("area: 8.0e-4", "sizes: {leak: .nan}, area: 8.0e-4", "the size of leak .* not nan"),
        ("area: 8.0e-4", "sizes: {leak: x}, area: 8.0e-4", "the size of leak .* not 'x'"),
        ("{arm: 1.0}", "{coordinates: [0.0, 0.2, 0.1], contractions: [0, 0, 0]}", "the machine .* rise"),
        ("{arm: 1.0}", "{coordinates: [0.0, 0.2], contractions: [0, 0]}", "3 to 40 numbers, not 2"),
        ("meaning: a", "values: {scenario.duraton: 3.0}\nmeaning: a", "values of the machine .* mean"),
        ("meaning: a", "values: {scenario: {duration: 3}, scenario.duration: 2}\nmeaning: a", "there twice"),
        ("meaning: a", "values: {scenario.duration: -3.0}\nmeaning: a", "values of the machine .* outside"),
        ("meaning: a", "values: [3.0]\nmeaning: a", "values is not a mapping"),
        ("meaning: a", "values: {scenario.start_angle: 0.2}\nmeaning: a", "unknown parameter scenario.st"),
        ("meaning: a", "values: {plant.sensor.angle_noise: 0}\nmeaning: a", "unknown parameter plant.sens"),
        ("meaning: a", "values: {plant.deviation.moving_mass: 1}\nmeaning: a", "unknown parameter plant.d"),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_in_one_line(read, old, new, words):
    assert old in SLIDE
    with pytest.raises(OrthosisError, match=words) as refused:
        load(machine=read(SLIDE.replace(old, new)))
    assert "\n" not in str(refused.value)


def test_a_table_of_degrees_is_refused(read):
    table = "{coordinates: [0, 45, 90], contractions: [0, 0.01, 0.02]}"
    with pytest.raises(OrthosisError, match="coordinates go beyond 7; check their unit"):
        read(ARM.replace("{arm: 0.03}", table))


def test_a_cylinder_is_as_long_as_its_stroke(read):
    with pytest.raises(OrthosisError, match=r"stroke of push reaches 0.3 m, .* has 0.16 m: mend"):
        plant_of(
            read(
                SLIDE.replace(
                    "length: 0.3, transmission: {arm: 1.0}", "length: 0.16, transmission: {arm: 1.0}"
                )
            )
        )


def test_a_simulation_that_diverges_is_an_error(read):
    plant = plant_of(read(SLIDE))
    plant.state[0] = np.nan
    plant.advance(5.0, 5.0)
    with pytest.raises(OrthosisError, match="the simulation of the machine diverges: a stiffness"):
        plant.measure()


def test_a_number_needs_no_point(read):
    assert load(machine=read(SLIDE.replace("8.0e-4", "8e-4"))).machine.push.area == 8.0e-4


def test_an_unreadable_file_is_refused(tmp_path):
    with pytest.raises(OrthosisError, match="cannot read"):
        read_machine(tmp_path / "none.yaml")


def test_a_folder_called_as_a_shipped_machine_stands_in_nobodys_way(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("ankle", "knee", "mine"):
        Path(name).mkdir()
    assert machine_named(Path("ankle")).name == "ankle"
    assert machine_named(Path("knee")) is KNEE
    with pytest.raises(OrthosisError, match="mine is a folder"):
        machine_named(Path("mine"))
