# SPDX-License-Identifier: Apache-2.0
"""What was found becomes nominal model: inside its bounds, once, and about the same hardware."""

import pytest

from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.improvement import learned
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects.base import enabled
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.model.truth import true_parameters, with_nominal

RIGHT = {
    **dict.fromkeys(DEVIATIONS, 0.0), "extensor_force": 0.02, "flexor_force": -0.01,
    "angle_offset": 1e-3, "extensor_pressure_offset": 300.0, "flexor_pressure_offset": -200.0,
    **{f"{n}.{q.name}": 0.0 for n, e in KNEE.catalogue.items() if e.shape for q in e.parameters},
}  # fmt: skip
FRICTION = {f"joint_friction.{q.name}": q.typical for q in KNEE.catalogue["joint_friction"].parameters}


def test_values_beyond_a_bound_stop_at_it():
    values = {**FRICTION, "joint_friction.coulomb": 1.2345678, "joint_friction.stribeck": -1e-80}
    changes = learned.named(load(), ["joint_friction"], values)
    assert changes["effects.joint_friction.enabled"] is True
    assert changes["effects.joint_friction.coulomb"] == 1.23457
    assert changes["effects.joint_friction.stribeck"] == 0.0
    load(changes)
    wide = {**RIGHT, "polytropic_exponent": 0.9, "force_map_misfit.extensor_c00": 500.0}
    changes = learned.calibrated(load(), [], wide)
    assert changes["valve.polytropic_exponent"] == load().row("valve.polytropic_exponent").maximum
    assert changes["effects.force_map_misfit.extensor_c00"] == 80.0
    load(changes)


def test_what_a_weak_supply_cannot_give_is_not_asked_for():
    """Without this the model of a supply below the highest reference pressure would be refused."""
    weak = learned.calibrated(load(), [], {**RIGHT, "supply_pressure": -0.2})
    assert weak["control.position.maximum_pressure"] == pytest.approx(0.97 * 0.8 * 7e5)
    load(weak)
    strong = learned.calibrated(load(), [], {**RIGHT, "supply_pressure": 0.05})
    assert "control.position.maximum_pressure" not in strong


def test_calibrated_parameters_are_those_of_the_hardware():
    """The deviations of the plant, given as calibration, make the nominal model the truth."""
    base = load()
    names = [name for name, _ in base.plant.deviation.items() if name in DEVIATIONS]
    deviations = {name: getattr(base.plant.deviation, name) - 1 for name in names}
    model = learned.calibrated(base, [], {**RIGHT, **deviations})
    after = with_nominal(base, model)
    for name in names:
        for key in DEVIATIONS[name]:
            assert after.flat()[key] == pytest.approx(true_parameters(base).flat()[key], rel=1e-5)
            assert after.flat()[f"plant.deviation.{name}"] == pytest.approx(1.0, abs=1e-5)


def test_an_effect_of_an_earlier_round_and_its_calibration_add_up():
    known = load({"effects.extensor_force_scale.enabled": True, "effects.extensor_force_scale.scale": 0.9,
                  "effects.angle_offset.enabled": True, "effects.angle_offset.offset": 0.02})  # fmt: skip
    changes = learned.calibrated(known, [], RIGHT)
    assert changes["effects.extensor_force_scale.scale"] == pytest.approx(0.9 * 1.02)
    assert changes["effects.flexor_force_scale.scale"] == pytest.approx(0.99)
    assert changes["effects.angle_offset.offset"] == pytest.approx(0.021)
    assert "effects.joint_friction.enabled" not in changes


def test_the_model_is_a_file_that_controllers_read(tmp_path):
    model = learned.calibrated(load(), ["joint_friction"], {**RIGHT, **FRICTION})
    model |= learned.named(load(), ["joint_friction"], FRICTION)
    patch.write(tmp_path / "model.yaml", model)
    read = with_nominal(load(), patch.read(tmp_path / "model.yaml"))
    assert {"joint_friction", "force_map_misfit"} <= set(enabled(read.effects))
    assert read.flat() == with_nominal(load(), model).flat()
