# SPDX-License-Identifier: Apache-2.0
"""The package as a library: runs, bags, answers; what it gives is what the commands give."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

import pam_orthosis as po
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.plant import Plant

ROOT = Path(__file__).resolve().parents[2]
WALK = ROOT / "bags" / "walk"
STEP = ROOT / "examples" / "step.py"
CASES = {"plant.deviation.conductance": [0.8, 1.0, 1.2]}


@pytest.fixture(scope="module")
def short():
    return po.parameters("default", {"scenario.duration": 1.5})


@pytest.fixture(scope="module")
def run(short):
    return po.simulate(short)


def test_importing_it_loads_neither_ros_nor_what_takes_time():
    slow = {"casadi", "numpy", "rclpy"}
    code = f"import sys, pam_orthosis as po; dir(po); print(sorted({slow} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
    assert set(po.__all__) <= set(dir(po))
    assert all(getattr(po, name).__doc__ for name in po.__all__)
    with pytest.raises(AttributeError, match="simulation"):
        _ = po.simulation


def test_the_ten_lines_of_readme_simulate_a_step(tmp_path):
    readme, text = (ROOT / "README.md").read_text(encoding="utf-8"), STEP.read_text(encoding="utf-8")
    assert f"```python\n{text}```" in readme
    assert len(text.splitlines()) <= 10
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("maximum error ")
    assert (tmp_path / "step.png").stat().st_size > 10_000
    stepped = np.degrees(po.read(tmp_path / "bag")["angle"])
    assert stepped[0] == pytest.approx(17.2, abs=0.5)
    assert stepped[-1] == pytest.approx(51.6, abs=0.5)


def test_a_bag_is_read_as_it_was_written_and_judged_as_the_run_is(run, tmp_path):
    again = po.read(run.save(tmp_path / "bag"))
    for name in ("angle", "extensor_pressure", "estimate_velocity", "flexor_voltage"):
        assert np.array_equal(again[name], run[name]), name
    assert again.parameters.flat() == run.parameters.flat()
    assert "true_angle" not in again.signals
    one, other = po.check(run), po.check(tmp_path / "bag")
    assert one.as_dict() | {"scenario": None} == other.as_dict() | {"scenario": None}
    assert one.max_abs_error == pytest.approx(np.degrees(np.abs(run.error).max()))


def test_the_answer_is_that_of_the_verb(capsys):
    assert main(["check", str(WALK), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(po.check(WALK).as_dict()))


def test_cases_are_arrays_and_each_is_that_of_its_own_parameters(short):
    voltages = np.full((60, 2), 5.0)
    voltages[30:, 0] = 6.0
    runs = po.simulate(short, CASES, voltages)
    assert runs["extensor_pressure"].shape == (3, 60)
    for number, factor in enumerate(CASES["plant.deviation.conductance"]):
        plant = Plant(short.changed({"plant.deviation.conductance": factor}))
        for row in voltages[:-1]:
            plant.advance(*row)
        assert runs[number]["extensor_pressure"][-1] == pytest.approx(plant.state[2], rel=1e-6)
    assert np.ptp(runs["extensor_pressure"][:, -1]) > 1e3


def test_cases_of_the_closed_loop(short, run):
    quick = short.changed({"scenario.duration": 0.1})
    runs = po.simulate(quick, {"control.position.c1": [20.0, short.control.position.c1]})
    assert np.array_equal(runs["angle"][1], run["angle"][: len(runs.time)])
    assert not np.array_equal(runs["extensor_voltage"][0], runs["extensor_voltage"][1])


def test_tables_for_pandas_and_for_matlab(run, tmp_path):
    table = run.to_pandas()
    assert table["angle"].to_numpy().tolist() == run["angle"].tolist()
    assert table.index.to_numpy().tolist() == run.time.tolist()
    assert main(["report", str(WALK), "--only", "mat", "--out", str(tmp_path)]) == 0
    walk, found = po.read(WALK), loadmat(tmp_path / "walk.mat")
    for name in ("angle", "extensor_pressure"):
        assert np.array_equal(found[name].ravel(), walk[name])
    assert np.array_equal(found["time"].ravel(), walk.time)


def test_what_is_wrong_is_said(short):
    for call, words in {
        (lambda: po.simulate(short, {"leg.person.mass": [1], "scenario.seed": [1, 2]})): "as many values",
        (lambda: po.simulate(short, voltages=[[1.0]])): "extensor, flexor",
        (lambda: po.simulate(short, voltages=np.full((2, 2), 5.0)).error): "no signal reference_angle",
        (lambda: po.simulate(short, voltages=np.full((2, 2), 5.0)).plot()): "no reference",
        (lambda: po.read("nowhere")): "nowhere",
        (lambda: po.parameters("no such")): "no scenario",
    }.items():
        with pytest.raises(OrthosisError, match=words):
            call()


def test_a_run_that_is_refused_is_called_as_it_was_given(run):
    brief = run.between(0.0, 0.1)
    for call, words in {
        (lambda: po.gap([WALK, brief])): "training run 2",
        (lambda: po.gap([WALK], [brief])): "held-out run 1",
        (lambda: po.check(brief, skip_s=5.0)): "^run 1 holds no sample",
    }.items():
        with pytest.raises(OrthosisError, match=words) as refused:
            call()
        assert "pam-orthosis-" not in str(refused.value)
        assert refused.value.__cause__ is None


def test_exact_hardware_is_the_nominal_model_but_for_what_is_changed():
    leak = "plant.effects.extensor_leak.enabled"
    values = po.parameters("person", {leak: True}, exact=True).flat()
    effects = {key for key in values if key.startswith("plant.effects.") and key.endswith(".enabled")}
    assert {key for key in effects if values[key]} == {leak}
    assert {value for key, value in values.items() if key.startswith("plant.deviation.")} == {1.0}
    assert values["plant.muscle_law"] == "polynomial"
    assert values["leg.person.present"] is True


def test_objects_show_themselves(short, run):
    shown = [one._repr_html_() for one in (short, po.machine(), run, po.check(run))]
    for html, words in zip(
        shown, ("scenario.duration", "extensor", "angle", "max abs error deg"), strict=True
    ):
        assert html.startswith("<table>")
        assert words in html
    assert run.plot()._repr_png_().startswith(b"\x89PNG")


def test_objects_print_themselves(short, run):
    verdict = po.check(run)
    assert repr(verdict).startswith(f"passed: maximum error {verdict.max_abs_error:.3f} deg, bound 3 deg\n")
    head, _, *rows = repr(run).splitlines()
    assert head == f"knee, {run.scenario}: {len(run.time)} samples in {run.time[-1]:.3f} s"
    assert [row.split()[0] for row in rows] == list(run.signals)
    low, high = map(float, next(row.split()[1:] for row in rows if row.startswith("angle ")))
    assert (low, high) == pytest.approx((run["angle"].min(), run["angle"].max()), rel=1e-3)
    assert f"control.position.c1 = {short.control.position.c1}" in repr(short.control.position).splitlines()
    assert repr(short).splitlines()[:2] == [
        f"knee: {len(short.flat())} parameters, 1 of them changed",
        "parameters.muscle",
    ]
    assert repr(run.machine).splitlines()[0] == f"knee: {run.machine.meaning}"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_arguments_are_completed(shell, capsys):
    with pytest.raises(SystemExit):
        main(["--print-completion", shell])
    script = capsys.readouterr().out
    for word in ("gap-hide", "held-out", "scenario"):
        assert word in script


def test_bash_completes_a_verb_and_its_options(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--print-completion", "bash"])
    file = tmp_path / "completion.sh"
    file.write_text(capsys.readouterr().out, encoding="utf-8")
    words = "COMP_WORDS=(pam-orthosis {}); COMP_CWORD={}; _shtab_pam_orthosis; echo ${{COMPREPLY[@]}}"
    lines = [f"source {file}", words.format("iden", 1), words.format("report --only ta", 3)]
    done = subprocess.run(["bash", "-c", "\n".join(lines)], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["identify", "table"]


@pytest.mark.parametrize(
    ("call", "problem"),
    [
        (lambda _: po.simulate("default"), "give parameters, such as po.parameters"),
        (lambda run: po.check([run, run]), "run 1: give a run, a bag or a table, not list"),
        (po.gap, "such as po.gap"),
        (lambda run: po.gap([run], [run]), "^training run 1 is given to fit and to judge by"),
        (lambda _: po.gap([str(WALK)], [str(WALK)]), f"{WALK} is given to fit and to judge by"),
        (lambda run: po.gap([run, run]), "^training run 1 is given twice"),
        (lambda _: po.gap([WALK, WALK / "walk_0.mcap"]), "walk_0.mcap and .* are the same recording"),
        (
            lambda _: po.parameters(changes={"plant.effects.backlash.half_width": 0.01}, exact=True),
            "give plant.effects.backlash.enabled: True too",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(call, problem, run):
    with pytest.raises(OrthosisError, match=problem):
        call(run)


def test_what_the_controllers_are_to_know_leaves_the_hardware_as_it_is(short):
    """A moving mass is twice as large in the hardware: once it is known, once not."""
    heavy = short.changed({"plant.deviation.moving_mass": 2.0})
    masses = {
        key: 2.0 * heavy.at(key)
        for key in ("leg.thigh.mass", "leg.shank.mass", "leg.knee_mass", "leg.shoe_mass")
    }
    known, unknown = po.simulate(heavy, model=masses), po.simulate(heavy)
    both = po.simulate(short.changed({**masses, "plant.deviation.moving_mass": 1.0}))
    assert known.parameters.at("leg.thigh.mass") == masses["leg.thigh.mass"]
    assert known.parameters.at("plant.deviation.moving_mass") == pytest.approx(1.0)
    assert known["angle"] == pytest.approx(both["angle"], abs=1e-6)
    assert np.abs(known["angle"] - unknown["angle"]).max() > 1e-4
