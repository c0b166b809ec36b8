# SPDX-License-Identifier: Apache-2.0
"""What a model file puts into a system of one's own, and what it cannot."""

from pathlib import Path

import casadi as ca
import motor_bench
import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.api import (
    Channel,
    Contribution,
    Curve,
    Effect,
    Input,
    Model,
    Parameter,
    Quantity,
    from_arrays,
    load_system,
)
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

CARRIAGE = Path(__file__).resolve().parents[2] / "examples" / "motor_carriage.py"
ON = {"effects.friction.enabled": True, "effects.friction.level": 2.0, "effects.friction.speed": 0.005}
CURVE = {f"effects.unknown_position.{key}": value for key, value in {
    "enabled": True, "coordinate": "position", "places": [-0.1, 0.1], "values": [0.0, 1.0],
}.items()}  # fmt: skip


@pytest.fixture(scope="module")
def carriage():
    return load_system(CARRIAGE)


def test_an_effect_that_is_found_is_a_part_of_the_model_and_no_candidate(carriage):
    better = carriage.changed(ON)
    assert set(carriage.catalogue) - set(better.catalogue) == {"friction"}
    learned = {one.name for one in better.calibrations} - {one.name for one in carriage.calibrations}
    assert learned == {"friction_level", "friction_speed"}
    assert set(better.bare().catalogue) == set(carriage.catalogue)
    at_bound = carriage.changed({**ON, "effects.friction.speed": 1e-4})
    assert "friction_speed" not in {one.name for one in at_bound.calibrations}


def test_what_is_found_later_is_added_to_what_was_found_before(carriage):
    late = {"effects.inputs_delay.enabled": True, "effects.inputs_delay.delay": 0.03}
    better = carriage.changed(ON).changed({**late, "mass": 2.5})
    assert better.late == 0.03
    assert list(better.simpler) == ["friction", "inputs_delay"]
    assert next(one.nominal for one in better.calibrations if one.name == "mass") == 2.5


def test_a_curve_is_added_to_the_acceleration(carriage):
    better = carriage.changed(CURVE)
    assert [one.held for one in carriage.entries["position"]] == ["unknown_position"]
    assert not better.entries.get("position"), "it holds one curve"
    for position, added in ((-0.2, 0.0), (0.0, 0.5), (0.1, 1.0), (0.3, 1.0)):
        rates = [_rates(one, position) for one in (carriage, better)]
        assert rates[1] - rates[0] == pytest.approx([0.0, added])


def _rates(system, position):
    found = system.assemble(())
    given = [found.x, found.u, found.theta]
    rates = ca.Function("rates", given, [found.rates])([position, 0.3], 1.0, [0.0] * len(found.parameters))
    return np.array(rates).ravel()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"weight": 1.0}, "has no 'weight'; it has mass, motor, damping, position_offset"),
        ({"mass": "heavy"}, "mass is 'heavy', no finite number"),
        ({"mass": float("inf")}, "mass is inf, no finite number"),
        ({"effects.frction.enabled": True}, "has no 'frction'"),
        ({"effects.wrong_mass.enabled": True}, "wrong_mass is no effect: give mass: VALUE"),
        ({"mass": -2.0}, "mass = -2: by its tolerance it keeps the sign of 2"),
        ({"mass": 10**400}, "no finite number"),
        ({**ON, "effects.friction.level": None}, "effects.friction.level is None, no finite number"),
        ({"effects.friction.level": 2.0}, "give effects.friction.enabled: true, or leave out what is of it"),
        ({**ON, "effects.friction.enabled": False}, "effects.friction is not on"),
        ({"effects.friction.enabled": True}, "effects.friction.level is missing"),
        ({**ON, "effects.friction.mass": 1.0}, "has no 'mass'"),
        ({**ON, "effects.friction.level": 51.0}, "effects.friction.level = 51 is outside of 0 .. 50 N"),
        ({**ON, "effects.friction.level": True}, "effects.friction.level is True, no finite number"),
        ({**CURVE, "effects.unknown_position.places": [0.1, -0.1]}, "places have to rise"),
        ({**CURVE, "effects.unknown_position.places": 0.1}, "unknown_position.places: give 2 to 200 numbers"),
        ({**CURVE, "effects.unknown_position.values": [1.0]}, "places as many as values"),
        ({**CURVE, "effects.unknown_position.values": [1.0, "x"]}, "values is 'x', no finite number"),
        ({**CURVE, "effects.unknown_position.coordinate": "force"}, "coordinate has no 'force'; it has pos"),
        ({k: v for k, v in CURVE.items() if "values" not in k}, "effects.unknown_position.values is missing"),
        ({"effects": 3}, "effects is 3; give effects.NAME.enabled, and its parameters"),
        ({**CURVE, "effects.unknown_position.coordinate": 5}, "position.coordinate is 5; give one of"),
        ({**CURVE, "effects.unknown_position.places": list(range(300))}, "give 2 to 200 numbers"),
    ],
)  # fmt: skip
def test_what_a_system_cannot_have_is_refused_in_one_line(carriage, changes, said):
    with pytest.raises(OrthosisError) as refused:
        carriage.changed(changes)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


def _write(file, changed):
    """Write the carriage as a system with another field `changed`."""
    text = CARRIAGE.read_text(encoding="utf-8")
    text = text.replace("import casadi", "from dataclasses import replace\n\nimport casadi")
    text = text.replace("return Model(", "return replace(Model(").replace(
        ".system()\n", f".system(), changed={changed})\n"
    )
    file.write_text(text, encoding="utf-8")


def test_a_system_written_by_hand_takes_settings_of_the_search_alone(tmp_path, capsys):
    table = motor_bench.write(tmp_path / "one.csv", 1, 0.0)
    file, model = tmp_path / "own.py", tmp_path / "found.yaml"
    _write(file, changed="None")
    model.write_text("mass: 2.1\n")
    assert main(["gap", table, "--system", str(file), "--model", str(model)]) == 2
    said = "beside --system it takes gap.* alone, not mass, unless"
    assert f"{said} {file} makes its system by Model(...).system()" in capsys.readouterr().err


def test_an_error_of_the_users_code_names_its_file(tmp_path):
    file = tmp_path / "own.py"
    _write(file, changed="lambda _: 1 / 0")
    with pytest.raises(OrthosisError, match=r"own.py, line \d+: ZeroDivisionError: division by zero"):
        load_system(file).changed(ON)


def _rub(quantity):
    size = Quantity(quantity, 3.0, "N", 0.0, 50.0, "dry friction", 0.0)
    law = lambda s, p, own: -getattr(p, quantity) * ca.tanh(s.v / 0.01)  # noqa: E731
    return Effect("rub", "force", (size,), law, "It rubs.", "")


def _model(**changed):

    def equations(s, p):
        s.force = p.motor * s.current
        return {"x": s.v, "v": s.force}

    settings = {
        "name": "slide",
        "channels": [Channel("x", "x", "m", "mm", 1e3)],
        "inputs": [Input("current", "A")],
        "states": ["x", "v"],
        "equations": equations,
        "parameters": [Parameter("motor", 2.0, "m/s^2/A", 0.1, "acceleration per current")],
        "effects": [_rub("level")],
    }
    return Model(**(settings | changed))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"present": ["rub"]}, "`present` is \\['rub'\\]; give a mapping from names"),
        ({"present": None}, "`present` is None; give a mapping"),
        ({"present": {"rub": 40}}, "effects.rub is 40; give a mapping from level"),
        ({"present": {"rub": {"level": "40"}}}, "effects.rub.level is '40', no finite number"),
        ({"present": {"rub": {}}}, "effects.rub.level is missing"),
        ({"curves": {"x": {"coordinate": "x"}}}, "effects.unknown_x is .*; give a Curve"),
        ({"curves": {"x": Curve(None, [0, 1], [0, 1])}}, "unknown_x.coordinate is None; give one of x, v"),
        ({"curves": {"y": Curve("x", [0, 1], [0, 1])}}, "`curves` has no 'y'"),
        ({"parameters": [Parameter("rub_level", 1.0, "N", 0.1, "")]}, "effect 'rub' has one of this name"),
        ({"parameters": [Parameter("effects", 1.0, "N", 0.1, "")]}, "has something else under this name"),
        ({"effects": [_rub("enabled")]}, "'enabled' says in a model file that it is there"),
    ],
)  # fmt: skip
def test_a_model_that_no_file_could_hold_is_refused_before_a_search(changes, said):
    with pytest.raises(OrthosisError, match=said):
        _model(**changes).system()


def test_a_model_by_hand_may_have_an_effect_a_curve_and_a_late_sensor():
    curve = Curve("v", (-1.0, 1.0), (0.5, -0.5))
    known = {"rub": {"level": np.float64(2.0)}, "current_delay": {"delay": 0.02}, "x_delay": {"delay": 0.01}}
    channels = [Channel("x", "x", "m", "mm", 1e3), Channel("v", "v", "m/s", "m/s", 1.0)]
    two = {"inputs": [Input("current", "A"), Input("other", "A")], "channels": channels}
    system = _model(present=known, curves={"x": curve}, **two).system()
    assert (system.late, system.later, system.aged) == (0.0, {"current": 0.02}, {"x": 0.01})
    assert {"rub", "current_delay", "x_delay"} & set(system.catalogue) == {"current_delay"}


def test_what_warms_from_the_beginning_on_is_warm_in_the_last_quarter():
    """Without recordings that are held out that quarter judges; what came before it acts there still."""
    gain = Quantity("gain", 0.3, "-", -5.0, 5.0, "what a warm body adds", 0.0)
    warming = Effect(
        "warming", "flow", (gain,),
        lambda s, p, own: Contribution({"flow": p.gain * own[0]}, (s.power,)), "Warms.", "", states=("heat",),
    )  # fmt: skip

    def equations(s, p):
        s.flow = p.factor * s.power
        return {"x": s.flow - s.x}

    system = Model(
        "heater", [Channel("x", "x", "-", "-", 1.0)], [Input("power", "-", held=False)], ["x"], equations,
        [Parameter("factor", 1.0, "-", 0.05, "flow by power")], [warming], present={"warming": {"gain": 0.5}},
    ).system()  # fmt: skip
    period, count = 0.01, 4000
    time, random = period * np.arange(count), np.random.default_rng(1)
    power = 1.0 + np.sin(1.3 * time)
    heat = time - np.cos(1.3 * time) / 1.3 + 1 / 1.3
    x = np.zeros(count)
    for i in range(count - 1):
        flow = power[i : i + 2] + 0.5 * heat[i : i + 2]
        x[i + 1] = x[i] * np.exp(-period) + (1 - np.exp(-period)) * flow.mean()
    one = from_arrays(
        "one", system, {"time": time, "x": x + 1e-3 * random.standard_normal(count), "power": power}
    )
    start = begin(system, [one], [], load().gap)
    assert start.recalibrated().white["x"] < 1.2 * start.floor.white["x"]
    assert [scored.samples for scored in start.held_out.scored] == [count // 4]
