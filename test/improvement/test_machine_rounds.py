# SPDX-License-Identifier: Apache-2.0
"""A machine of a user's file learns what the knee learns: its own experiments, effects and units."""

import io
from pathlib import Path

import pytest

from pam_orthosis.improvement import learned, rounds
from pam_orthosis.improvement.rounds import experiments
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import load
from pam_orthosis.report import improvement
from pam_orthosis.report.picture import draw

CYLINDER = Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "cylinder.yaml"
HIDDEN = {
    "plant.effects.carriage_friction.enabled": True,
    "plant.effects.carriage_friction.coulomb": 25.0,
    "scenario.duration": 4.0,
    "scenario.start_hold": 0.1,
    "scenario.start_ramp": 0.5,
}
FRICTION = {"coulomb": 25.0, "viscosity": 5.0, "transition_velocity": 1e-3}
VALUES = {
    **{f"{name}_{kind}": 0.0 for name in ("push", "pull") for kind in ("force", "pressure_offset")},
    **{f"carriage_friction.{key}": value for key, value in FRICTION.items()},
    "inertia": 0.1, "position_offset": 1e-4, "conductance": -0.02,
}  # fmt: skip


@pytest.fixture(scope="module")
def parameters():
    return load(HIDDEN, read_machine(CYLINDER))


def test_its_experiments_are_cadences_alone(parameters):
    names = [one.name for one in experiments(parameters)]
    assert names == ["gait", "gait-faster", "held-out-gait"]


def test_what_is_learned_is_the_controllers_and_not_the_files(parameters):
    changes = learned.calibrated(parameters.nominal(), ["carriage_friction"], VALUES)
    assert changes["valve.conductance"] == pytest.approx(0.98 * parameters.valve.conductance)
    assert not [key for key in changes if key.startswith(("machine.", "plant."))]
    assert "valve_curve_misfit" not in learned.learnable(parameters.declared)


def test_it_follows_better_with_the_friction_that_was_found(parameters, tmp_path, monkeypatch):
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    monkeypatch.setattr(rounds, "experiments", lambda _: [])

    def find(nominal, _bags, _progress):
        assert nominal.declared is parameters.declared
        assert not hasattr(nominal, "plant")
        return rounds.Found(("carriage_friction",), VALUES, "explained", {})

    monkeypatch.setattr(rounds, "find_effects", find)
    before, after = rounds.improve(parameters, "default", tmp_path, [1], 1)
    assert after.kept
    assert after.tracking.largest < 0.7 * before.tracking.largest
    told = [one.as_dict() for one in (before, after)]
    assert list(told[1]["tracking"])[:2] == ["max_abs_error_mm", "rms_error_mm"]
    table = improvement.table(told)
    assert f"| {after.tracking.largest:.3f} mm |" in table
    picture = io.BytesIO()
    draw(improvement.plots([before, after]), picture)
    assert picture.getvalue().startswith(b"\x89PNG")
