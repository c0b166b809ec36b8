# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next is a table that a controller can follow."""

import csv
import json
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

from pam_orthosis.bag.examples import write_example
from pam_orthosis.bag.record import BagWriter, run_metadata
from pam_orthosis.cli import gap, gap_graph, gap_next
from pam_orthosis.cli.main import main
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.machines import KNEE, machine_named
from pam_orthosis.model.parameters import experiments, load, scenario_names, scenario_overrides


def _found(*separated_by, foreign=False):
    effects = [SimpleNamespace(separated_by=separated_by)]
    return SimpleNamespace(effects=effects, surrogates=[], foreign=foreign)


def test_what_separates_comes_before_what_shows_most():
    useful = ["any words", "diagnostic-decay"]
    assert gap_next.next_experiment(_found("diagnostic-triangle"), useful) == "diagnostic-triangle"
    assert gap_next.next_experiment(_found("words of a system"), useful) == "diagnostic-decay"
    assert gap_next.next_experiment(_found(), ["words"]) == ""
    assert gap_next.next_experiment(_found("diagnostic-triangle", foreign=True), useful) == ""


@pytest.mark.parametrize("name", experiments())
def test_each_experiment_is_a_table_within_what_the_machine_can_do(name):
    parameters = load()
    rows = list(csv.DictReader(gap_next.references(name, parameters).splitlines()))
    times = [float(row["time"]) for row in rows]
    assert times == pytest.approx([0.01 * number for number in range(len(rows))])
    angles = [float(row["reference_angle"]) for row in rows]
    assert parameters.leg.joint.minimum <= min(angles) <= max(angles) <= parameters.leg.joint.maximum
    assert max(abs(b - a) for a, b in pairwise(angles)) < 0.05
    means = [float(row["mean_pressure"]) for row in rows if row["valves_closed"] == "0"]
    assert 3e5 < min(means) <= max(means) < 5.5e5
    closed = [row["mean_pressure"] for row in rows if row["valves_closed"] == "1"]
    assert not any(closed), "0 would be vacuum, as absolute pressure"
    assert bool(closed) == (name in ("diagnostic", "diagnostic-decay", "diagnostic-hold"))


def test_the_advice_names_what_to_do_and_what_to_record():
    said = gap_next.advice("diagnostic-triangle", load())
    assert experiments()["diagnostic-triangle"] in said
    assert "record angle, extensor_pressure, flexor_pressure, extensor_voltage, flexor_voltage" in said


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--until", "check", "--json"], "give no --out and no --json"),
        (["--system", "own.py"], "none of a --system"),
        ([], "exists; choose another --next"),
        (["--until", "check"], "exists; choose another --next"),
    ],
)
def test_next_is_refused_before_the_search(tmp_path, capsys, more, message):
    file = tmp_path / "next.csv"
    file.write_text("mine")
    assert main(["gap", "bags/walk", "--next", str(file), *more]) == 2
    assert message in capsys.readouterr().err
    assert file.read_text() == "mine"


def test_the_stages_before_the_search_write_what_would_show_most(tmp_path, capsys):
    *_, bag = write_example("friction", tmp_path / "case")
    file = tmp_path / "next.csv"
    assert main(["gap", str(bag), "--until", "check", "--next", str(file)]) == 0
    assert "next: " in capsys.readouterr().out.splitlines()[-1]
    assert file.read_text().startswith("time,reference_angle,mean_pressure,valves_closed")


def test_refusals_name_the_option_that_was_given(tmp_path, capsys):
    (tmp_path / "mine").write_text("mine")
    assert main(["identify", "bags/walk", "--figures", str(tmp_path / "mine")]) == 2
    assert "choose another --figures" in capsys.readouterr().err
    command = ["plan", "--out", str(tmp_path / "new.yaml"), "--page", str(tmp_path / "mine")]
    assert main(command) == 2
    assert "choose another --page" in capsys.readouterr().err
    assert main(["identify", "bags/walk"]) == 2
    assert "give bags of `pam-orthosis rig`, or tables of a muscle" in capsys.readouterr().err


@pytest.fixture(autouse=True)
def _there_is_ros(monkeypatch):
    monkeypatch.setattr(gap_graph, "need_ros", lambda: None)


@pytest.fixture
def runs(monkeypatch):
    """Return what the graph is asked to run; it makes a folder of each run."""
    asked = []
    monkeypatch.setattr(
        gap_graph, "run_graph", lambda *given: asked.append(given) or given[1].mkdir(parents=True)
    )
    return asked


def _walk(folder, changes=None, scenario="default", truth="/truth", machine=KNEE):
    """Write what of a short walk of the graph says that its hardware was emulated."""
    parameters = load(scenario_overrides(scenario) | (changes or {}), machine)
    with BagWriter(folder, run_metadata(parameters, scenario)) as bag:
        bag.add_topic(truth, "sensor_msgs/msg/JointState")
    return folder


@pytest.mark.parametrize("scenario", scenario_names())
def test_the_graph_repeats_hardware_and_controllers_of_a_bag_but_not_its_motion(tmp_path, scenario):
    motion = "plant.external_torque", "plant.external_frequency"
    own = {"plant.effects.joint_friction.coulomb": 0.3}
    recorded = load(scenario_overrides(scenario) | own).flat()
    repeated = gap_graph.emulated([_walk(tmp_path / "a", own, scenario)], "").parameters.flat()
    for key, value in recorded.items():
        if not key.startswith("scenario."):
            assert repeated[key] == (load().at(key) if key in motion else value), key


def test_an_experiment_is_recorded_with_noise_of_its_own(tmp_path, runs):
    bag = _walk(tmp_path / "a", {"scenario.seed": 2}, "diagnostic-hold")
    hardware = gap_graph.emulated([bag], "")
    bags, after = hardware.record("diagnostic-decay", tmp_path / "next", judged=True)
    assert [one.name for one in bags] == ["fitted", "held_out"]
    assert all(one.is_dir() for one in bags)
    after.record("diagnostic-triangle", tmp_path / "more", judged=False)
    assert [one[0].at("scenario.seed") for one in runs] == [1, 3, 4]
    assert [one[2] for one in runs] == ["diagnostic-decay"] * 2 + ["diagnostic-triangle"]
    assert all(mode.composed for *_, mode in runs)
    wanted = load(scenario_overrides("diagnostic-decay") | {"scenario.seed": 1})
    assert runs[0][0].flat() == wanted.flat()


def test_the_graph_does_what_is_new_and_can_be_used_beside_the_recordings(tmp_path, runs):
    hardware = gap_graph.emulated([_walk(tmp_path / "a", {}, "diagnostic-hold")], "")
    left = {*experiments()} - {"diagnostic-hold", "diagnostic-locked"}
    assert {*hardware.experiments} == left
    _, after = hardware.record("diagnostic-decay", tmp_path / "next", judged=False)
    assert {*after.experiments} == left - {"diagnostic-decay"}
    found = _found("diagnostic-locked", "diagnostic-triangle")
    assert gap_next.next_experiment(found, (), hardware.experiments) == "diagnostic-triangle"


def test_only_what_the_graph_emulated_alike_is_repeated(tmp_path, capsys):
    new = ["--next", str(tmp_path / "new")]
    example, *_ = write_example("friction", tmp_path / "case")
    first = _walk(tmp_path / "a")
    other = _walk(tmp_path / "b", {"plant.effects.joint_friction.coulomb": 0.3})
    real = _walk(tmp_path / "c", truth="/not_truth")
    ankle = _walk(tmp_path / "d", machine=machine_named(Path("ankle")))
    for measured, message in {
        (example,): "is no run of one emulated joint by `run`; give a FILE.csv to follow",
        (real,): "is no run of one emulated joint",
        (ankle,): "there are experiments for the knee, none for the ankle",
        (tmp_path / "nothing",): "no bag at",
        (first, other): "are of different emulated hardware",
        (first, "--namespace", "left"): "of one joint, without --namespace",
        (first, "--until", "check"): "--until searches nothing",
    }.items():
        assert main(["gap", *map(str, measured), *new]) == 2
        assert message in capsys.readouterr().err
    for folder, message in ((first, "is not an empty folder"), (first / "new", "is inside of")):
        assert main(["gap", str(first), "--next", str(folder)]) == 2
        assert f"{message}" in (said := capsys.readouterr().err)
        assert "choose another --next" in said
    assert not (tmp_path / "new").exists()
    assert not (first / "new").exists()


@pytest.fixture
def searched(monkeypatch):
    """Return the arguments of each search; the second and third find what another experiment separates."""
    case = SimpleNamespace(data=SimpleNamespace(experiments=["diagnostic-cocontraction"]))
    answers = [("words",), ("diagnostic-decay",), ("diagnostic-decay",)]
    asked = []

    def search(arguments):
        asked.append(arguments)
        number = len(asked)
        found = _found(*answers[number - 1])
        return gap.Found(case, found, {"number": number}, f"answer {number}", number - 3)

    monkeypatch.setattr(gap, "_searched", search)
    return asked


@pytest.mark.usefixtures("runs")
def test_a_search_goes_on_until_nothing_is_left_to_separate(tmp_path, capsys, searched):
    bag, new = _walk(tmp_path / "a"), tmp_path / "new"
    assert main(["gap", str(bag), "--next", str(new)]) == 0
    added = [new / "diagnostic-cocontraction" / "fitted", new / "diagnostic-decay" / "fitted"]
    assert [one.measured for one in searched] == [[bag], [bag, added[0]], [bag, *added]]
    assert [one.held_out for one in searched] == [[], [], []]
    said = capsys.readouterr()
    assert said.out.splitlines() == [
        "answer 3",
        "next: the graph has done what is known to help beside these recordings",
    ]
    assert "so far: answer 1\n" in said.err
    assert f"recorded in {new / 'diagnostic-decay'}" in said.err


def test_what_was_found_is_told_where_an_experiment_fails(tmp_path, capsys, searched, monkeypatch):
    def fails(_parameters, bag, *_):
        bag.mkdir(parents=True)
        raise RunFailed("a node failed")

    monkeypatch.setattr(gap_graph, "run_graph", fails)
    written = []
    monkeypatch.setattr(gap, "_write", lambda _, found: written.append(found.words))
    bag, new = _walk(tmp_path / "a"), tmp_path / "new"
    assert main(["gap", str(bag), "--next", str(new), "--out", str(tmp_path / "out"), "--json"]) == 3
    said = capsys.readouterr()
    assert json.loads(said.out) == {"number": 1}
    assert "a node failed" in said.err
    assert written == ["answer 1"]
    assert len(searched) == 1
    assert (new / "diagnostic-cocontraction" / "fitted").is_dir(), "what there is of a run is kept"
