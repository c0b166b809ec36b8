# SPDX-License-Identifier: Apache-2.0
"""From the rig to config/: bags recorded, read, identified, written, drawn - without the truth."""

import json
import re
import shutil
from dataclasses import replace
from functools import partial
from itertools import islice

import numpy as np
import pytest
import yaml

from pam_orthosis.bag.read import read_bag, recorded_parameters, run_record
from pam_orthosis.bag.rig_record import record_rig
from pam_orthosis.bag.simulated import record_run
from pam_orthosis.cli.main import main
from pam_orthosis.control.rig_loop import DecayRig, Rig, force_procedure, volume_procedure
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import read_data
from pam_orthosis.identification.identify import identify
from pam_orthosis.model import parameters

PRESSURES, HELD_OUT = (2e5, 3.5e5, 5e5, 7e5), (4.5e5, 6.5e5)
AMBIENT = 1.013e5


def runs(p):
    """Yield name, test, samples and how many of them to keep, of a shortened procedure."""
    for seed, pressure in enumerate((*PRESSURES, *HELD_OUT)):
        yield f"force-{seed}", "force", force_procedure(Rig(p, "dmsp_20", 20 + seed), pressure), 10
    for seed, pressure in enumerate((2e5, 4e5, 7e5)):
        yield f"volume-{seed}", "volume", volume_procedure(Rig(p, "dmsp_20", 30 + seed), pressure), 50
    yield "decay", "decay", DecayRig(p, "dmsp_20", 40).run(4e5), 1


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The same runs recorded twice: as they were, and with a truth that lies."""
    honest, lying = tmp_path_factory.mktemp("rig"), tmp_path_factory.mktemp("lies")
    p = parameters.load({"rig.procedure.volume_stations": 4})
    for name, test, run, every in runs(p):
        samples = list(run)
        record_rig(honest / name, p, "dmsp_20", test, samples, every)
        spoilt = [s._replace(truth=s.truth._make([123.0] * len(s.truth))) for s in samples]
        record_rig(lying / name, p, "dmsp_20", test, spoilt, every)
    return honest, lying


@pytest.fixture(scope="module")
def bags(both):
    return both[0]


@pytest.fixture(scope="module")
def found(bags):
    return identify(read_data([bags]), [p - AMBIENT for p in HELD_OUT])


def test_the_model_predicts_held_out_pressures_within_the_papers_error(found):
    told = found.errors(held_out=True)
    assert told["samples"] > 500
    assert set(np.round((np.unique(found.held_out.level) + AMBIENT) / 1e5, 2)) == {4.5, 6.5}
    assert told["max"] <= 30.0
    assert told["rms"] <= 10.5


def test_the_hysteresis_is_visible_by_direction(found):
    by_direction = found.errors(held_out=True)["by_direction"]
    assert by_direction["shortening"]["mean"] < -4.0
    assert by_direction["stretching"]["mean"] > 4.0


def test_damping_and_volume_come_with_it(found):
    p = parameters.load()
    assert found.damping.value == pytest.approx(p.plant.rig.dmsp_20.damping, rel=0.1)
    assert found.volume.rms < 0.02 * found.volume.v[0]
    assert found.stiff
    assert found.box.maximum_contraction == pytest.approx(0.125, abs=0.005)


def test_truth_is_recorded_apart_and_never_used(both, found):
    _, lying = both
    force = [read_bag(folder / "force-0", ["rig_truth_force"])["rig_truth_force"] for folder in both]
    assert force[0].value.max() > 200
    assert set(force[1].value) == {123.0}, "the lie must be in the bags"
    again = identify(read_data([lying]), [p - AMBIENT for p in HELD_OUT])
    assert again.as_dict() == found.as_dict()


def test_a_bag_explains_itself(bags):
    run = run_record(bags / "force-0")
    assert (run["specimen"], run["test"]) == ("dmsp_20", "force")
    assert json.loads(run["parameters"])["rig.carriage_mass"] == 20.0


def test_the_command_writes_rows_that_config_takes(bags, found, tmp_path, capsys, page_fits):
    out, figures = tmp_path / "rows.yaml", tmp_path / "figures"
    held = [str(p / 1e5) for p in HELD_OUT]
    arguments = ["identify", str(bags), "--out", str(out), "--figures", str(figures), "--json"]
    assert main([*arguments, "--held-out-bar", *held]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["a"] == found.force.model.a.tolist()
    rows = yaml.safe_load(out.read_text())["dmsp_20"]
    p = parameters.load(
        {
            "muscle.dmsp_20.map_length": rows["map_length"]["value"],
            "muscle.dmsp_20.force.a": rows["force"]["a"]["value"],
            "muscle.dmsp_20.volume.w": rows["volume"]["w"]["value"],
        }
    )
    assert p.muscle.dmsp_20.force.a[0] == pytest.approx(told["a"][0], rel=1e-8)
    for name in ("force.png", "residual.png", "volume.png"):
        assert (figures / name).stat().st_size > 10_000
    page_fits(figures / "identify.html")


def test_what_the_rig_identified_is_a_model_for_gap_plan_and_run(bags, tmp_path, capsys):
    """From the rig's bags to the knee, by commands alone."""
    rows, walk = tmp_path / "rows.yaml", tmp_path / "walk"
    held = [str(p / 1e5) for p in HELD_OUT]
    assert main(["identify", str(bags), "--out", str(rows), "--held-out-bar", *held]) == 0
    changed = {"scenario.duration": 14.0, "scenario.seed": 3}
    record_run(parameters.load(changed | {"scenario.seed": 3}), "default", walk)
    capsys.readouterr()
    for model in ([], ["--model", str(rows)]):
        assert main(["gap", str(walk), *model, "--until", "replay"]) == 0
    plain, known = (part.splitlines() for part in capsys.readouterr().out.split("angle [deg]")[1:])
    assert plain[0] != known[0]  # the nominal model has another muscle
    pytest.importorskip("rclpy")
    done = tmp_path / "done"
    options = ["--composed", "--duration", "1", "--model", str(rows), "--out", str(done)]
    assert main(["run", *options]) in (0, 1), capsys.readouterr().err
    recorded, written = recorded_parameters(done, run_record(done)), patch.read(rows)
    assert {key: recorded[key] for key in written} == written


def test_a_damping_that_is_given_is_fitted_with_and_written(bags, tmp_path, capsys):
    out = tmp_path / "rows.yaml"
    assert main(["identify", str(bags), "--out", str(out), "--damping", "100", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["damping_used"] == 100.0
    assert yaml.safe_load(out.read_text())["dmsp_20"]["force"]["damping"]["value"] == 100.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ["--held-out-bar", "3.3"],
            "no data at 3.3 bar absolute to hold out; there are: 2, 3.5, 4.5, 5, 6.5, 7",
        ),
        (["--held-out-bar", "250000"], "no data at 250000 bar"),
        (["--nominal-length-m", "0"], "longer than 0 m"),
        (["--out", "{there}"], "exists; choose another --out"),
    ],
)
def test_options_that_would_do_nothing_or_harm_are_refused(bags, tmp_path, capsys, options, said):
    there = tmp_path / "there.yaml"
    there.write_text("mine")
    assert main(["identify", str(bags), *(word.format(there=there) for word in options)]) == 2
    assert said in capsys.readouterr().err
    assert there.read_text() == "mine"


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_forces_of_another_unit_reach_no_file(bags, tmp_path, capsys, factor, monkeypatch):
    from pam_orthosis.identification import data

    read = data.read_data

    def scaled(*arguments):
        found = read(*arguments)
        return replace(found, samples=replace(found.samples, force=factor * found.samples.force))

    monkeypatch.setattr(data, "read_data", scaled)
    copy = tmp_path / "muscle.yaml"
    shutil.copy(parameters.config_folder() / "muscle.yaml", copy)
    before = copy.read_text()
    assert main(["identify", str(bags), "--update", str(copy), "--out", str(tmp_path / "rows.yaml")]) == 2
    assert "check their units" in capsys.readouterr().err
    assert copy.read_text() == before
    assert not (tmp_path / "rows.yaml").exists()


def test_update_changes_these_rows_only(bags, found, tmp_path):
    copy = tmp_path / "muscle.yaml"
    shutil.copy(parameters.config_folder() / "muscle.yaml", copy)
    before = yaml.safe_load(copy.read_text())
    assert main(["identify", str(bags), "--update", str(copy)]) == 0
    after = yaml.safe_load(copy.read_text())
    section = after["dmsp_20"]
    assert "identified on the emulated test rig" in section["force"]["a"]["source"]
    assert section["force"]["damping"]["value"] == pytest.approx(found.damping.decrement, rel=1e-3)
    assert section["map_length"]["value"] == 0.5
    for name in ("dmsp_10", "mas_40"):
        assert after[name] == before[name]
    assert section["geometry"] == before["dmsp_20"]["geometry"]


def _no_figures(found, out):
    raise OrthosisError("no figures")


def _out_is_taken(found, out):
    out.write_text("theirs")
    return {}


@pytest.mark.parametrize("drawn", [_no_figures, _out_is_taken])
def test_a_file_is_updated_together_with_what_else_is_written_or_not_at_all(
    bags, tmp_path, capsys, monkeypatch, drawn
):
    copy, out, figures = (tmp_path / name for name in ("muscle.yaml", "rows.yaml", "figures"))
    shutil.copy(parameters.config_folder() / "muscle.yaml", copy)
    before = copy.read_bytes()
    monkeypatch.setattr("pam_orthosis.report.identification.drawn", partial(drawn, out=out))
    written = ["--update", str(copy), "--out", str(out), "--figures", str(figures)]
    assert main(["identify", str(bags), *written]) == 2
    assert re.search(r"no figures|rows\.yaml exists", capsys.readouterr().err)
    assert copy.read_bytes() == before
    assert not figures.exists()


@pytest.mark.parametrize(
    ("chosen", "message"),
    [
        (["force-0"], "coefficients"),
        (["decay"], "no force measurement"),
        (["nowhere"], "no data at"),
    ],
)
def test_data_that_do_not_suffice_end_with_one_line(bags, capsys, chosen, message):
    assert main(["identify", *(str(bags / name) for name in chosen)]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.fixture
def of_the_small_muscle(tmp_path):
    p = parameters.load()
    samples = list(islice(force_procedure(Rig(p, "dmsp_10", 1), 3e5), 30))
    record_rig(tmp_path / "small", p, "dmsp_10", "force", samples)
    return str(tmp_path / "small")


@pytest.mark.parametrize("muscle", [[], ["--muscle", "dmsp_20"], ["--muscle", "dmsp_10"]])
def test_bags_of_another_muscle_are_refused_whatever_muscle_is_told(
    bags, of_the_small_muscle, capsys, muscle
):
    assert main(["identify", str(bags), of_the_small_muscle, *muscle]) == 2
    error = capsys.readouterr().err
    assert "is of a dmsp_" in error if muscle else "data of dmsp_10, dmsp_20: give the data of one" in error
    assert "--muscle" not in error


@pytest.mark.parametrize(
    ("inside", "said"),
    [
        ("", "is given twice"),
        ("force-0", "is given twice"),
        ("force-0/force-0_0.mcap", "are the same recording"),
    ],
)
def test_the_same_bag_twice_is_refused(bags, capsys, inside, said):
    assert main(["identify", str(bags / "force-0"), str(bags / inside)]) == 2
    assert said in capsys.readouterr().err


def test_a_file_to_update_that_is_no_text_is_refused(bags, tmp_path, capsys):
    binary = tmp_path / "muscle.yaml"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    assert main(["identify", str(bags), "--update", str(binary)]) == 2
    assert "is not UTF-8 (at byte" in capsys.readouterr().err
    assert binary.read_bytes() == b"\xff\xfe\x00\x81"
