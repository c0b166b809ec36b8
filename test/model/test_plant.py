# SPDX-License-Identifier: Apache-2.0
"""The emulated hardware as a whole."""

import itertools

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate, parameters
from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.compiled import Compiled, compiled
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.plant import Plant, true_hardware
from pam_orthosis.model.truth import with_nominal

VOLTAGES = 5 + 1.6 * np.sin(np.arange(250)[:, None] * np.array([0.06, 0.043]) + [0.0, 2.0])


def driven(overrides=None):
    plant = Plant(parameters.load({"scenario.control_period": 0.002, **(overrides or {})}))
    for voltages in VOLTAGES:
        plant.advance(*voltages)
    return plant


def test_it_starts_at_rest():
    plant = Plant(parameters.load())
    start = plant.truth()
    for _ in range(100):
        plant.advance(5.0, 5.0)
    assert abs(plant.truth().angle - start.angle) < np.deg2rad(0.2)


def test_halving_the_step_changes_less_than_the_sensors_can_see():
    coarse, fine = driven(), driven({"plant.simulation.step": 5e-5})
    sensor = parameters.load().plant.sensor
    moved = abs(coarse.truth().angle - Plant(parameters.load()).truth().angle)
    assert moved > np.deg2rad(5), "the knee must have moved for the comparison to mean anything"
    assert abs(coarse.truth().angle - fine.truth().angle) < 0.05 * sensor.angle_resolution
    assert abs(coarse.truth().extensor_pressure - fine.truth().extensor_pressure) < 0.5 * 244.0


def test_same_seed_same_measurements_other_seed_others():
    measured = [Plant(parameters.load(), seed).measure() for seed in (7, 7, 8)]
    assert measured[0] == measured[1]
    assert measured[0] != measured[2]


def test_the_muscles_do_the_work_that_the_leg_gains():
    """Energy balance with closed valves, friction off: d(T + U) = torque times q-dot."""
    off = {f"plant.effects.{n}.enabled": False for n in ("joint_friction", "viscous_friction")}
    assembly = assemble(true_hardware(parameters.load(off)))
    n = len(assembly.states)
    x, work = ca.SX.sym("x", n), ca.SX.sym("work")
    u = ca.DM([5.0, 5.0, 0.0, 0.0])
    f = assembly.function("f")

    def rates(state):
        dx, y = f(state[:n], u)
        return ca.vertcat(dx, y[0] * state[1])

    state = ca.vertcat(x, work)
    step = ca.Function("step", [state], [integrate.runge_kutta_4(rates, state, 1e-4)])
    start = np.zeros(n + 1)
    start[:4] = 0.9, 0.0, 2.5e5, 4.2e5
    end = step.fold(1500)(start)
    energy = _mechanical_energy(true_hardware(parameters.load(off)).mechanism.parameters)
    gained = float(energy(end[0], end[1])) - float(energy(0.9, 0.0))
    assert abs(float(end[0]) - 0.9) > 0.03
    assert gained == pytest.approx(float(end[n]), abs=1e-7)


def _mechanical_energy(leg):
    from pam_orthosis.model.mechanisms.leg import bodies, energies

    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    kinetic, potential = energies(q, w, bodies(q, leg))
    return ca.Function("energy", [q, w], [kinetic + potential])


def test_machine_code_and_virtual_machine_agree():
    assembly = assemble(true_hardware(parameters.load()))
    function = assembly.function("agreement")
    x = np.zeros(len(assembly.states))
    x[:4] = 0.6, 1.5, 3.1e5, 3.9e5
    results = [
        np.concatenate([part.copy() for part in made(function)(x, [5.4, 4.7, 0.3, 1.0])])
        for made in (compiled, Compiled)
    ]
    assert np.allclose(results[0], results[1], rtol=1e-12, atol=1e-12)


@pytest.fixture
def plainly_built(monkeypatch):
    """Return what makes the compiler take each operation as it stands from now on."""

    def begin():
        module = "pam_orthosis.model.compiled"
        monkeypatch.setattr(f"{module}.COMPILER_FLAGS", ("-O0", "-ffp-contract=off", "-fPIC", "-shared"))
        monkeypatch.setattr(f"{module}.NEWER_INSTRUCTIONS", "none")
        monkeypatch.setattr(f"{module}.IN_PLACE", {})

    return begin


def test_what_makes_the_machine_code_fast_changes_no_bit(plainly_built):
    on = {f"plant.effects.{name}.enabled": True for name in KNEE.catalogue}
    every = {**on, "leg.person.present": True, "plant.simulation.step": 1e-3}
    fast = driven(every)
    plainly_built()
    assert fast.state.tobytes() == driven(every).state.tobytes()


def test_extremes_take_the_number_and_zeros_as_the_mathematics_library_does(plainly_built):
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    extremes = ca.Function("extremes", [a, b], [ca.fmax(a, b), ca.fmin(a, b)])
    values = (np.nan, -0.0, 0.0, 1.0, np.inf, -np.inf)

    def told():
        built = compiled(extremes)
        return [np.concatenate(built(x, y)).tobytes() for x, y in itertools.product(values, repeat=2)]

    fast = told()
    plainly_built()
    assert fast == told()


def test_voltage_that_is_not_a_number_is_refused():
    with pytest.raises(OrthosisError, match="not finite"):
        Plant(parameters.load()).advance(float("nan"), 5.0)


def test_a_load_that_the_muscles_cannot_hold_is_refused():
    heavy = {"leg.person.present": True, "leg.person.mass": 200.0, "scenario.start_angle": 1.3}
    with pytest.raises(OrthosisError, match="cannot hold"):
        Plant(parameters.load(heavy))


def test_joint_limits_hold_under_full_pressure():
    plant = Plant(parameters.load())
    joint = parameters.load().leg.joint
    for _ in range(400):
        plant.advance(0.0, 10.0)
    assert plant.truth().angle < joint.maximum + 0.1
    for _ in range(600):
        plant.advance(10.0, 0.0)
    assert plant.truth().angle > joint.minimum - 0.1


def test_another_nominal_model_leaves_the_hardware_as_it_is():
    mass = {key: 1.07 * parameters.load().flat()[key] for key in DEVIATIONS["moving_mass"]}
    nominal = {**mass, "valve.polytropic_exponent": 1.25, "effects.joint_friction.enabled": True}
    other = with_nominal(parameters.load(), nominal)
    assert other.valve.polytropic_exponent == 1.25
    runs = []
    for one in (Plant(parameters.load()), Plant(other)):
        for _ in range(100):
            one.advance(4.6, 5.4)
        runs.append(one.state)
    assert runs[0] == pytest.approx(runs[1], rel=1e-9)
    with pytest.raises(OrthosisError, match="by one factor"):
        with_nominal(parameters.load(), {"leg.shank.mass": 1.2})


def test_the_knees_muscle_damps_as_the_rigs_does():
    """A new identification changes the nominal model, not the hardware: the factor has to follow it."""
    flat = parameters.load().flat()
    true = flat["muscle.dmsp_20.force.damping"] * flat["plant.deviation.muscle_damping"]
    assert true == pytest.approx(flat["plant.rig.dmsp_20.damping"], rel=1e-3)
