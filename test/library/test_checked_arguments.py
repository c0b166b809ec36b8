# SPDX-License-Identifier: Apache-2.0
"""What a caller of the library gives: taken as it is meant, or refused in one line of Python's words."""

import math
from pathlib import Path

import numpy as np
import pytest

import pam_orthosis as po
from pam_orthosis.model.components.muscle import towing_force
from pam_orthosis.model.parameters import load

ROOT = Path(__file__).resolve().parents[2]
WALK, CYLINDER = ROOT / "bags" / "walk", ROOT / "examples" / "cylinder" / "cylinder.yaml"
MUSCLE = "dmsp_20"
NEVER_ONE = None, 3, "table.csv", Path("table.csv"), {"table.csv": 1}


@pytest.fixture(scope="module")
def run():
    return po.simulate(po.parameters(changes={"scenario.duration": 0.1}))


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """Return a table of a muscle, by its rows in config/, with gauge pressures."""
    m, rows = getattr(load().muscle, MUSCLE), []
    for pressure in np.linspace(1e5, 6e5, 6):
        for contraction in np.linspace(0.0, 0.2 * m.map_length, 12):
            force = float(towing_force(contraction * m.length / m.map_length, pressure, m))
            if force > 0:
                rows.append((pressure, contraction, force))
    path = tmp_path_factory.mktemp("muscle") / "measured.csv"
    np.savetxt(path, rows, "%.9g", ",", header="p_Pa_gauge,dL_m,F_N", comments="")
    return path


@pytest.fixture(scope="module")
def muscle(table):
    return po.identify([table], MUSCLE)


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda _: po.gap([]), "there is no recording to fit"),
        *(
            (lambda _, given=given: po.gap(given), r"^gap: give lists .* po.gap\(\[run")
            for given in NEVER_ONE
        ),
        (lambda _: po.gap([WALK], WALK), "^gap: give lists"),
        (lambda _: po.gap([3]), "^training run 1: give a run"),
        *((lambda _, jobs=jobs: po.gap([WALK], jobs=jobs), "^jobs: give a ") for jobs in (0, -1, "2", 1.5)),
        (lambda _: po.gap([WALK], model={"valve.delay": 0.0}), "^model: give a text or a path, not {"),
        (lambda _: po.gap([WALK], columns=3), "^columns: give signals"),
        (lambda _: po.gap([WALK], machine=3), "^machine: give a text or a path, not 3"),
        (lambda _: po.gap([WALK], machine="ankle", system="x.py"), "^`system` and `machine` each say"),
        *((lambda run, b=b: po.check(run, b), "^bound: give a number, 0") for b in ("3", -1, math.nan, None)),
        (lambda run: po.check(run, skip_s="1"), "^skip_s: give a number"),
        (lambda run: run.plot(math.nan), "^bound: give a number"),
        (lambda run: run.between("a", 1), "^between: give a number, not 'a'"),
        (lambda run: po.check(run, namespace=None), "^namespace: give a text"),
        (lambda _: po.parameters(changes=["a"]), "^changes: give keys with their values"),
        (lambda _: po.parameters(["person"]), "^scenario: give a text"),
        (lambda _: po.parameters(machine="none.yaml"), "^no machine none.yaml"),
        (lambda run: po.simulate(run.parameters, voltages="a"), "^voltages: give an array of numbers"),
        (lambda run: po.simulate(run.parameters, voltages=[[1], [1, 2]]), "^voltages: give an array"),
        (lambda run: po.simulate(run.parameters, {"scenario.seed": []}), "^cases: give each key as many"),
        (lambda run: po.simulate(run.parameters, {}), "^cases: give each key as many"),
        (lambda run: po.simulate(run.parameters, {"scenario.seed": [[1], [1, 2]]}), "^cases: give each"),
        (lambda run: po.simulate(run.parameters, [1]), "^cases: give keys"),
        (lambda run: po.simulate(run.parameters, model=[1]), "^model: give keys"),
        (lambda _: po.read(3), "^path: give a text or a path, not 3"),
        (lambda _: po.read(""), "^path: give a text or a path, not ''"),
        (lambda _: po.example(3, "out"), "^name: give a text, not 3"),
    ],
)
def test_what_is_of_another_kind_is_refused(call, problem, run):
    with pytest.raises(po.OrthosisError, match=problem) as refused:
        call(run)
    assert len(str(refused.value).splitlines()) == 1
    assert "--" not in str(refused.value)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        *(({"data": given}, r"^identify: give a list .* po.identify\(\['table.csv'") for given in NEVER_ONE),
        ({"data": []}, "^identify: there are no data"),
        ({"data": [3]}, "^data: give a text or a path, not 3"),
        ({"muscle": None}, "give `muscle`$"),
        ({"muscle": 20}, "^muscle: give a text or a path, not 20"),
        ({"nominal_length": "0.3"}, r"^nominal_length \(m\): give a number, 0.001 or more, not '0.3'"),
        *(({"nominal_length": one}, "^nominal_length .* not ") for one in (math.nan, 0, -0.3, True)),
        ({"nominal_length": 0.02}, "give `nominal_length` or `muscle`"),
        ({"machine": CYLINDER, "muscle": None}, "cylinder has no muscle"),
        ({"machine": "ankle", "muscle": "own.yaml"}, "^`machine` and `muscle` FILE each say"),
        ({"held_out": 3e5}, "^held_out: give a list of absolute pressures"),
        ({"held_out": [3.0]}, "no data at 3e-05 bar absolute to hold out"),
        ({"degrees": 3}, "^degrees: give two whole numbers"),
        ({"degrees": (3,)}, "^degrees: give two whole numbers"),
        ({"degrees": (1.5, 4)}, "^degrees: give a whole number, 0 to 4, not 1.5"),
        ({"degrees": (4, 4)}, r"^`degrees`: Eq. \(14\) has at most degrees 3 and 4"),
        ({"damping": -1.0}, "^damping: give a number, 0 or more, not -1.0"),
    ],
)
def test_what_no_muscle_is_identified_by_is_refused(given, problem, table):
    with pytest.raises(po.OrthosisError, match=problem) as refused:
        po.identify(**{"data": [table], "muscle": MUSCLE, **given})
    assert "--" not in str(refused.value)


def test_a_muscle_of_none_of_config_is_identified_by_its_file(table, tmp_path):
    own, m = tmp_path / "bicep.yaml", getattr(load().muscle, MUSCLE)
    own.write_text(f"length: {m.map_length}\ndiameter: {m.geometry.diameter}\n", encoding="utf-8")
    for given in (own, str(own)):
        found = po.identify([table], given).as_dict()
        assert found["nominal_length"] == m.map_length
        assert not [line for line in found["remarks"] if "nominal length" in line]


def test_what_the_verb_takes_the_function_takes_too(table, muscle):
    ambient = muscle.found.data.parameters.valve.ambient_pressure
    found = po.identify([table], MUSCLE, held_out=[2e5 + ambient], degrees=(2, 2), damping=500.0).as_dict()
    assert found["held_out"]["by_pressure_bar_gauge"].keys() == {"2"}
    assert [len(found[name]) for name in "ab"] == [3, 3]
    assert found["damping_used"] == 500.0
    assert not muscle.as_dict()["held_out"]
    of_machine = po.identify([table], machine=po.machine()).as_dict()
    assert (of_machine["muscle"], of_machine["a"]) == (MUSCLE, muscle.as_dict()["a"])


def test_a_muscle_shows_its_errors_and_no_arrays(muscle):
    head, _, row = repr(muscle).splitlines()
    assert head == f"muscle {MUSCLE}, nominal length {muscle.found.data.length:g} m"
    assert row.split()[:2] == ["fitted", f"{muscle.found.errors(False)['rms']:.2f}"]
    assert head in muscle._repr_html_()


def test_remarks_and_refusals_name_arguments_of_python(muscle, tmp_path):
    assert "give `nominal_length`" in " ".join(muscle.as_dict()["remarks"])
    used = tmp_path / "used"
    used.write_text("", encoding="utf-8")
    for write in (muscle.save, lambda path: po.example("walk", path)):
        with pytest.raises(po.OrthosisError, match=r"used exists.*; choose another path$"):
            write(used)


def test_a_machines_file_is_as_good_as_the_machine():
    machine = po.machine(CYLINDER)
    values = po.parameters(machine=machine).flat()
    assert all(po.parameters(machine=given).flat() == values for given in (CYLINDER, str(CYLINDER)))


def test_cases_of_words_show_themselves(run):
    runs = po.simulate(run.parameters, {"control.position.controller": ["pid", "backstepping"]})
    assert [line.strip() for line in repr(runs).splitlines()[-2:]] == ["pid", "backstepping"]


def test_files_are_written_into_new_folders_and_in_the_place_of_older_ones(run, tmp_path):
    picture, mat = tmp_path / "new" / "run.PNG", tmp_path / "other" / "run"
    for _ in range(2):
        run.plot().save(picture)
        run.save_mat(mat)
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert [one.name for one in mat.parent.iterdir()] == ["run.mat"]


@pytest.mark.parametrize("name", ["run.xyz", "run"])
def test_a_picture_of_no_known_ending_is_refused(name, run, tmp_path):
    with pytest.raises(po.OrthosisError, match=r"give \.png, \.svg or \.pdf"):
        run.plot().save(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_where_nothing_can_be_written_is_said(run, tmp_path):
    (tmp_path / "file").write_text("", encoding="utf-8")
    for write, name in ((run.plot().save, "run.png"), (run.save_mat, "run.mat")):
        with pytest.raises(po.OrthosisError, match="file"):
            write(tmp_path / "file" / name)
