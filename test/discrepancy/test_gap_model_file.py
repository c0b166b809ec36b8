# SPDX-License-Identifier: Apache-2.0
"""What a model file puts into a system of one's own, and what it cannot."""

from pathlib import Path

import casadi as ca
import motor_bench
import numpy as np
import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.api import load_system
from pam_orthosis.errors import OrthosisError

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
        ({"effects.wrong_mass.enabled": True}, "has no 'wrong_mass'"),
        ({"effects.friction.level": 2.0}, "give effects.friction.enabled: true, or leave out what is of it"),
        ({**ON, "effects.friction.enabled": False}, "effects.friction is not on"),
        ({"effects.friction.enabled": True}, "effects.friction.level is missing"),
        ({**ON, "effects.friction.mass": 1.0}, "has no 'mass'"),
        ({**ON, "effects.friction.level": 51.0}, "effects.friction.level = 51 is outside of 0 .. 50 N"),
        ({**ON, "effects.friction.level": True}, "effects.friction.level is True, no finite number"),
        ({**CURVE, "effects.unknown_position.places": [0.1, -0.1]}, "places have to rise"),
        ({**CURVE, "effects.unknown_position.places": 0.1}, "position.places is 0.1; it needs two"),
        ({**CURVE, "effects.unknown_position.values": [1.0]}, "places as many as values"),
        ({**CURVE, "effects.unknown_position.values": [1.0, "x"]}, "values is 'x', no finite number"),
        ({**CURVE, "effects.unknown_position.coordinate": "force"}, "coordinate has no 'force'; it has pos"),
        ({k: v for k, v in CURVE.items() if "values" not in k}, "effects.unknown_position.values is missing"),
        ({"effects": 3}, "has no ''"),
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
