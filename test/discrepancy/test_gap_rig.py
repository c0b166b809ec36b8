# SPDX-License-Identifier: Apache-2.0
"""The test rig as the second system of the gap workflow."""

import ast
import sys
from collections import namedtuple
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pam_orthosis.discrepancy
from pam_orthosis.bag.rig_record import record_rig
from pam_orthosis.bag.rig_topics import MUSCLES
from pam_orthosis.cli.main import main
from pam_orthosis.control.linearisation import CarriageEstimate, CarriageReference
from pam_orthosis.control.rig_loop import RigSample
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.preparation.check import missing_inputs
from pam_orthosis.discrepancy.recordings import rig_bags
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems import rig as system_of
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load
from pam_orthosis.model.rig import RigMeasurement
from pam_orthosis.testing.quantities import Hidden

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import hidden_rig

FEW = ("carriage_friction", "muscle_hysteresis", "creep", "force_map_misfit")
ENGINE = ("replay", "fitting", "preparation", "search", "unknown", "answer", "workflow.py")
ENGINE_KNOWS_NOT = {"knee", "rig", "test_rig", "orthosis", "leg"}


@pytest.fixture(scope="module")
def nominal():
    return hidden_rig.nominal()


@pytest.fixture(scope="module")
def system(nominal):
    """The rig with a few effects: kernels are built for each of them."""
    whole = system_of.test_rig(nominal, hidden_rig.SPECIMEN)
    return replace(whole, catalogue={name: whole.catalogue[name] for name in FEW})


@pytest.fixture(scope="module")
def replay(system):
    return Replay(system)


def recorded(nominal, effects, seed=1):
    """Return two runs of a rig that is as the nominal model says but for hidden effects."""
    rng = np.random.default_rng(seed)
    return [hidden_rig.record(rng, nominal, Hidden(**effects)) for _ in range(2)]


def search(nominal, system, replay, **effects):
    runs = [from_arrays(f"run {k}", system, run) for k, run in enumerate(recorded(nominal, effects))]
    return find_gap(system, runs[:1], runs[1:], nominal.gap, replay=replay)


def test_the_engine_knows_no_system():
    folder = Path(pam_orthosis.discrepancy.__file__).parent
    files = [file for room in ENGINE for file in (folder / room, *(folder / room).glob("*.py"))]
    for file in (one for one in files if one.is_file()):
        parts = {
            part
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
            if isinstance(node, ast.ImportFrom) and node.module
            for alias in node.names
            for part in (*node.module.split("."), alias.name)
        }
        assert not parts & ENGINE_KNOWS_NOT, f"{file} imports {parts & ENGINE_KNOWS_NOT}"


def test_a_model_file_without_end_is_refused(tmp_path):
    file = tmp_path / "model.yaml"
    file.write_text("".join(f"a{number}: 1\n" for number in range(60_000)))
    with pytest.raises(OrthosisError, match=r"model\.yaml is not valid YAML: more than 100000 values"):
        patch.read(file)


def test_with_nothing_hidden_the_plant_is_the_nominal_model(nominal, system, replay, monkeypatch):
    """Two realisations of the same equations; the observer's share of the agreement is small."""
    for name in ("POSITION_NOISE", "FORCE_NOISE", "PRESSURE_NOISE"):
        monkeypatch.setattr(hidden_rig, name, 0.0)
    for name in ("POSITION_RESOLUTION", "FORCE_RESOLUTION", "PRESSURE_RESOLUTION", "VOLTAGE_RESOLUTION"):
        monkeypatch.setattr(hidden_rig, name, 1e-9)
    run = Run(system, from_arrays("run", system, recorded(nominal, {})[0]), 40.0)
    moving = slice(1000, None)
    carriage, gas = (
        replay.residuals(run, equation, (), replay.defaults(()))[moving] for equation in system.equations
    )
    assert np.ptp(run.recording.signals["rig_position"]) > 0.02
    assert np.abs(carriage[:, 0]).max() < 5e-5
    assert np.abs(carriage[:, 1]).max() < 1.0
    assert np.abs(gas).max() < 20.0


def test_nothing_hidden_is_none(nominal, system, replay):
    outcome = search(nominal, system, replay)
    assert outcome.verdict == "none"
    assert outcome.effects == ()


def test_hidden_carriage_friction_is_named_and_goes_into_the_model(nominal, system, replay, tmp_path):
    """LuGre in the plant, Coulomb with a smooth change of sign in the catalogue."""
    outcome = search(nominal, system, replay, coulomb=12.0)
    assert [one.name for one in outcome.effects] == ["carriage_friction"]
    assert outcome.effects[0].equation == "carriage"
    assert outcome.effects[0].parameters["coulomb"][0] == pytest.approx(12.0, rel=0.2)
    values = outcome.selection.final.values
    patch.write(tmp_path / "model.yaml", patch.overrides(system, ["carriage_friction"], values))
    changed = load(patch.read(tmp_path / "model.yaml"))
    assert changed.rig.effects.carriage_friction.enabled
    assert "carriage_friction" not in system_of.test_rig(changed, hidden_rig.SPECIMEN).catalogue


def test_hidden_muscle_hysteresis_is_named(nominal, system, replay):
    """Maxwell-slip elements in the plant, Bouc-Wen in the catalogue."""
    outcome = search(nominal, system, replay, hysteresis=15.0)
    assert [one.name for one in outcome.effects] == ["muscle_hysteresis"]
    assert outcome.effects[0].parameters["half_width"][0] == pytest.approx(15.0, rel=0.2)


def bag(folder, every_ns, test="force", samples=40):
    """Write a rig bag of a few samples."""
    row = RigMeasurement(0.02, 3e5, 3e5, 400.0)
    still, estimate = CarriageReference(0.02, 0, 0, 0), CarriageEstimate(0.02, 0, 0)
    known = ("position", "velocity", *(f"{n}_{k}" for k in ("force", "pressure", "flow") for n in MUSCLES))
    truth = namedtuple("Truth", known)(0.02, 0.0, 400.0, 400.0, 3e5, 3e5, 0.0, 0.0)
    rows = [
        RigSample(k * every_ns, row, still, 3e5, estimate, (0.0, 0.0), (5.0 + 0.01 * k, 5.0), truth)
        for k in range(samples)
    ]
    record_rig(folder, load(), "dmsp_20", test, rows)
    return folder


def test_a_rig_bag_is_known_by_its_metadata(system, tmp_path):
    fast, slow = bag(tmp_path / "fast", 2_000_000), bag(tmp_path / "slow", 20_000_000)
    assert rig_bags.specimen_of(fast) == "dmsp_20"
    assert rig_bags.specimen_of(Path("bags/walk")) is None
    assert missing_inputs(system, [rig_bags.recording(fast, system)]) == []
    one = rig_bags.recording(slow, system)
    assert missing_inputs(system, [one]) == list(system.inputs)
    assert "every 20 ms" in one.remarks[0]


def test_free_decays_and_mixed_systems_are_refused(system, tmp_path, capsys):
    with pytest.raises(OrthosisError, match="unhooked"):
        rig_bags.recording(bag(tmp_path / "decay", 2_000_000, "decay"), system)
    assert main(["gap", str(tmp_path / "decay"), "bags/walk"]) == 2
    assert "different systems" in capsys.readouterr().err


def test_each_effect_of_the_rig_enters_the_equation_that_it_names(nominal):
    whole = system_of.test_rig(nominal, hidden_rig.SPECIMEN)
    replay = Replay(whole)
    for name in whole.candidates:
        assert replay.touched(name), f"{name} changes nothing"
        assert "extensor" not in name
        assert "flexor" not in name
