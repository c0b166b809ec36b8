# SPDX-License-Identifier: Apache-2.0
"""Parameter studies agree with the single plant, set by set."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.lanes import library, source
from pam_orthosis.model.leg_table import LegTable, leg_mechanics, leg_terms
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.mechanisms.leg import mechanics
from pam_orthosis.model.parameters import load
from pam_orthosis.model.study import LANES, NODES, ORDER, Study

EVERYTHING_ON = {f"plant.effects.{name}.enabled": True for name in KNEE.catalogue}
KEYS = ("leg.person.mass", "plant.deviation.conductance", "plant.effects.joint_friction.coulomb")
SETS = np.array([[75.0, 0.95, 0.8], [60.0, 1.0, 0.0], [90.0, 0.9, 2.0]])
PERIODS = np.arange(60)
VOLTAGES = 5 + np.column_stack([np.sin(0.1 * PERIODS), np.sin(0.07 * PERIODS + 2)])


def coarse(overrides=None):
    """Return parameters with a coarse step, in whole numbers of which the delay is."""
    return load({"plant.simulation.step": 1e-3, "plant.delay.valve": 1.6e-3, **(overrides or {})})


def test_each_set_of_a_study_does_what_a_plant_of_its_own_does(monkeypatch):
    signals = ("angle", "velocity", "measured_extensor_pressure", "flexor_hysteresis", "extensor_flow")
    study = Study(coarse({**EVERYTHING_ON, "plant.external_torque": 3.0}), KEYS, signals)
    together = study.simulate(SETS, VOLTAGES)
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    alone = Study(study.parameters, KEYS, signals).simulate(SETS, VOLTAGES)
    for name in signals:
        moved = np.ptp(alone[name], axis=1)
        assert together[name].shape == (len(SETS), len(VOLTAGES))
        assert (moved > 0).all(), name
        assert (np.abs(together[name] - alone[name]).max(axis=1) < 1e-9 * moved).all(), name
    assert np.ptp(together["angle"][:, -1]) > 1e-3, "the sets must differ for the comparison to mean anything"


def test_a_single_set_does_what_the_plant_does(monkeypatch):
    signals = ("angle", "velocity", "measured_flexor_pressure", "extensor_flow")
    study = Study(coarse({**EVERYTHING_ON, "plant.external_torque": 3.0}), KEYS, signals)
    packed = study.simulate(SETS[:1], VOLTAGES)
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    plant = Study(study.parameters, KEYS, signals).simulate(SETS[:1], VOLTAGES)
    for name in signals:
        assert np.abs(packed[name] - plant[name]).max() < 1e-9 * np.ptp(plant[name]), name


@pytest.mark.parametrize("width", [1, LANES])
def test_every_operation_of_casadi_does_what_it_does_for_one_number(width):
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    unary = (ca.sin, ca.cos, ca.tan, ca.asin, ca.acos, ca.atan, ca.exp, ca.log, ca.sinh, ca.cosh, ca.tanh,
             ca.asinh, ca.atanh, ca.sqrt, ca.floor, ca.ceil, ca.fabs, ca.sign, ca.logic_not)  # fmt: skip
    binary = (ca.fmax, ca.fmin, ca.atan2, ca.fmod, ca.power, ca.logic_and, ca.logic_or)
    told = [f(x) for f in unary for x in (a - 0.5 * (f in (ca.floor, ca.fabs, ca.sign)), b)]
    told += [f(a, b) for f in binary] + [ca.acosh(1 + a), ca.if_else(a < b, a, b), a ** (1 / 3), 1 / a]
    told += [a < b, a <= b, a == b, a != b, -a, a + b, a - b, a * b, a / b, a**2]
    function = ca.Function("f", [ca.vertcat(a, b)], [ca.vertcat(*told)])
    loop = f"""extern "C" void run(const double* given, double* result) {{
  lane x[2], y[{len(told)}];
  for (int i = 0; i < 2; i++) x[i] = load(given + LANES * i);
  call<f>(y, x);
  for (int i = 0; i < {len(told)}; i++) store(result + LANES * i, y[i]);
}}"""
    path = library("operations", source([function], width) + loop)
    assert path is not None, "it does not compile"
    given, result = np.random.default_rng(1).uniform(0.05, 0.95, (2, width)), np.empty((len(told), width))
    ctypes.CDLL(str(path)).run(*(ctypes.c_void_p(one.ctypes.data) for one in (given, result)))
    assert result == pytest.approx(np.array(function.map(width)(given)), rel=1e-12)


def test_neighbours_in_a_vector_do_not_touch_each_other():
    study, mass = Study(coarse(), KEYS[:1]), np.linspace(50, 100, LANES + 3)[:, None]
    all_of_them = study.simulate(mass, VOLTAGES)["measured_angle"]
    backwards = study.simulate(mass[::-1], VOLTAGES, workers=1)["measured_angle"]
    assert (all_of_them == backwards[::-1]).all()


def test_the_legs_table_is_the_legs_mechanics_for_every_leg():
    leg = load({"leg.person.present": True, "leg.person.height": 1.6}).leg
    table, (q, v, extra) = (
        LegTable(leg.joint.minimum, leg.joint.maximum, ORDER, NODES),
        ca.vertsplit(ca.SX.sym("s", 3)),
    )
    at_nodes = ca.Function("t", [q], [leg_terms(leg, q)]).map(NODES)(table.angles[None, :])
    coefficients = ca.vec(ca.SX(at_nodes @ np.array(table.weights()).T).T)
    exact, ours = (make(q, v, leg, extra) for make in (mechanics, leg_mechanics(table, coefficients)))
    both = ca.Function("m", [q, v, extra], [ca.horzcat(*vars(one).values()) for one in (exact, ours)])
    for angle in np.linspace(leg.joint.minimum - 0.1, leg.joint.maximum + 0.1, 40):
        true, table_says = (np.array(one) for one in both(angle, 5.0, 0.7))
        assert np.abs(true - table_says).max() < 1e-8


def test_one_plant_is_a_study_without_keys():
    signals = Study(coarse(), ()).simulate(np.empty((1, 0)), VOLTAGES)
    same = Study(coarse(), KEYS[1:2]).simulate(SETS[:1, 1:2], VOLTAGES)
    assert np.abs(signals["measured_angle"] - same["measured_angle"]).max() < 1e-12


def test_a_knee_that_cannot_be_held_is_nan_and_the_others_are_not():
    study = Study(coarse({"scenario.start_angle": 1.4, "leg.person.present": True}), KEYS[:1])
    told = study.simulate([[200.0], [46.0]], VOLTAGES[:2])["measured_angle"]
    assert np.isnan(told).tolist() == [[True, True], [False, False]]


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("leg.person.weight", "unknown parameter"),
        ("plant.effects.creep.enabled", "cannot differ"),
        ("plant.simulation.step", "cannot differ"),
    ],
)
def test_bad_studies_are_told_in_one_line(key, words):
    with pytest.raises(OrthosisError, match=words) as told:
        Study(coarse(), (key,))
    assert "\n" not in str(told.value)
