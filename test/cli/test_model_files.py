# SPDX-License-Identifier: Apache-2.0
"""Every file of parameters that one verb writes is read by each verb that takes `--model`."""

import csv

import numpy as np
import pytest

import pam_orthosis.discrepancy.workflow  # noqa: F401  takes `begin` before a test replaces it
from pam_orthosis.batch import margin
from pam_orthosis.cli import main as entry
from pam_orthosis.cli import run
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.systems import knee
from pam_orthosis.errors import OrthosisError
from pam_orthosis.improvement import learned
from pam_orthosis.model.components import muscle
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import config_folder, load
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.truth import with_nominal
from pam_orthosis.planning import plan as planning

SCENARIO = "person"
EFFECTS = ("joint_friction", "creep")
SWITCH = "effects.joint_friction.enabled"
FOR_GAP = {"gap.tolerance.extensor_force": 0.03, "scenario.control_period": 0.001}


def of_identify(folder):
    m, table, out = load().muscle.dmsp_20, folder / "dmsp_20.csv", folder / "rows.yaml"
    with open(table, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["p_Pa_gauge", "dL_m", "F_N"])
        for pressure in np.linspace(1e5, 6e5, 6):
            for contraction in np.linspace(0.0, 0.11, 12):
                force = 1.02 * float(muscle.towing_force(contraction, pressure, m))
                if force > 0:
                    writer.writerow([f"{value:.9g}" for value in (pressure, contraction, force)])
    options = ["--muscle", "dmsp_20", "--nominal-length-m", str(m.map_length), "--held-out-bar"]
    assert entry.main(["identify", str(table), "--out", str(out), "--damping", "240", *options]) == 0
    return out, {"muscle.dmsp_20.force.damping": 240.0}


def of_plan(folder):
    out = folder / "plan.yaml"
    assert entry.main(["plan", "--scenario", SCENARIO, "--out", str(out)]) == 0
    return out, {"scenario.plan.enabled": True}


def of_gap(folder):
    """As the verb writes it, beside what was given for the search of tables, which it keeps."""
    system, out = knee.knee(load()), folder / "model.yaml"
    values = {f"{e}.{q.name}": q.typical for e in EFFECTS for q in system.catalogue[e].parameters}
    given = {"valve.conductance": 2.6e-8, **FOR_GAP, "scenario.cycle_time": 3.0}
    patch.write(out, patch.kept(given) | patch.overrides(system, EFFECTS, values))
    return out, {SWITCH: True, "valve.conductance": 2.6e-8}


def of_improve(folder):
    """As the verb writes it: nuisance parameters calibrated, maps corrected, an effect learned."""
    nominal, out = load(), folder / "improved.yaml"
    system = knee.knee(nominal, learned.learnable(KNEE))
    values = {one.name: 0.3 * one.sd for one in system.calibrations}
    values |= {f"{e}.{q.name}": 0.1 * q.prior for e in system.shapes for q in system.catalogue[e].parameters}
    values |= {f"{e}.{q.name}": q.typical for e in EFFECTS for q in system.catalogue[e].parameters}
    found = learned.calibrated(nominal, EFFECTS, values) | learned.named(nominal, EFFECTS, values)
    patch.write(out, found)
    return out, {SWITCH: True, "leg.knee_mass": found["leg.knee_mass"]}


WRITERS = {"identify": of_identify, "plan": of_plan, "gap": of_gap, "improve": of_improve}


@pytest.fixture(scope="module", params=WRITERS)
def written(request, tmp_path_factory):
    """A file of a verb, and some of what it says."""
    return WRITERS[request.param](tmp_path_factory.mktemp(request.param))


def taken(expected, parameters):
    """Stop a verb where its work would begin, with parameters that must hold what was written."""
    known = parameters.flat()
    assert {key: known[key] for key in expected} == expected
    raise OrthosisError("read and taken")


def test_gap_reads_it(written, tmp_path, monkeypatch, capsys):
    file, expected = written
    expected = {key: value for key, value in expected.items() if not key.startswith(patch.PLANNED)}
    expected |= FOR_GAP if FOR_GAP.keys() & patch.read(file).keys() else {}
    table = tmp_path / "x.csv"  # a recording of another motion than the plan's, without a record of any
    table.write_text("time,angle,extensor_pressure,flexor_pressure\n0,0.5,2e5,2e5\n0.002,0.5,2e5,2e5\n")
    seen, whole = [], knee.knee
    monkeypatch.setattr(
        knee, "knee", lambda parameters, *more: seen.append(parameters) or whole(parameters, *more)
    )
    monkeypatch.setattr(beginning, "begin", lambda *_: taken(expected, seen[0]))
    assert entry.main(["gap", str(table), "--model", str(file)]) == 2
    assert "read and taken" in capsys.readouterr().err


def test_run_reads_it_and_the_hardware_stays(written, tmp_path, monkeypatch, capsys):
    file, expected = written
    monkeypatch.setattr(run, "need_ros", lambda: None)
    monkeypatch.setattr(run, "run_graph", lambda parameters, *_: taken(expected, parameters))
    out = str(tmp_path / "walk")
    assert entry.main(["run", "--scenario", SCENARIO, "--model", str(file), "--out", out]) == 2
    assert "read and taken" in capsys.readouterr().err


def test_margin_reads_it_and_a_run_keeps_its_own_period(written, monkeypatch, capsys):
    file, expected = written
    expected = expected | {key: load().flat()[key] for key in FOR_GAP}
    monkeypatch.setattr(margin, "measure", lambda parameters, *_: taken(expected, parameters))
    assert entry.main(["margin", "--scenario", SCENARIO, "--model", str(file)]) == 2
    assert "read and taken" in capsys.readouterr().err


def test_plan_reads_it(written, tmp_path, monkeypatch, capsys):
    file, expected = written
    monkeypatch.setattr(planning, "make_plan", lambda parameters, *_: taken(expected, parameters))
    out = str(tmp_path / "plan.yaml")
    assert entry.main(["plan", "--scenario", SCENARIO, "--model", str(file), "--out", out]) == 2
    assert "read and taken" in capsys.readouterr().err


def test_what_is_identified_changes_the_nominal_model_and_not_the_hardware(tmp_path):
    file, _ = of_identify(tmp_path)
    before, identified = load(), patch.read_nominal(file)
    after = with_nominal(before, identified)
    key = "muscle.dmsp_20.force.a"
    assert after.flat()[key] == identified[key] != before.flat()[key]
    walks = []
    for parameters in (before, after):
        plant = Plant(parameters, seed=1)
        walks.append([plant.advance(5.5, 4.5) or plant.measure() for _ in range(100)])
    np.testing.assert_allclose(walks[1], walks[0], rtol=1e-9)


def test_a_damping_of_nothing_cannot_be_made_up_for():
    with pytest.raises(OrthosisError, match=r"muscle\.dmsp_20\.force\.damping = 0"):
        with_nominal(load(), {"muscle.dmsp_20.force.damping": 0.0})


def test_a_file_that_identify_updates_is_read_as_a_whole():
    """It is laid out as the shipped one."""
    rows, known = patch.read(config_folder() / "muscle.yaml"), load().flat()
    assert len(rows) > 40
    assert {key: known[key] for key in rows} == rows


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "is empty: it changes nothing; leave --model out"),
        ("verdict: none\nclosure: {}\n", "is an answer of gap and no model; the model.yaml beside it is one"),
        ("plant.deviation.moving_mass: 1.1\n", "plant.deviation.moving_mass is not of the nominal model"),
        ("effects.joint_friction.coulomb: 0.5\n", "give effects.joint_friction.enabled: true too"),
    ],
)
def test_gap_and_run_refuse_a_file_that_would_change_nothing_of_the_model(
    tmp_path, monkeypatch, capsys, text, said
):
    monkeypatch.setattr(run, "need_ros", lambda: None)
    file, walk = tmp_path / "model.yaml", str(config_folder().parent / "bags" / "walk")
    file.write_text(text)
    for command in (["gap", walk, "--until", "check"], ["run", "--out", str(tmp_path / "walk")]):
        assert entry.main([*command, "--model", str(file)]) == 2
        assert said in capsys.readouterr().err
