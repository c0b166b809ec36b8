# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next is a table that a controller can follow."""

import csv
from itertools import pairwise
from types import SimpleNamespace

import pytest

from pam_orthosis.bag.examples import write_example
from pam_orthosis.bag.record import BagWriter, run_metadata
from pam_orthosis.cli import gap, gap_graph, gap_next
from pam_orthosis.cli.main import main
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.parameters import experiments, load, scenario_overrides


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
    closed = sum(row["valves_closed"] == "1" for row in rows)
    assert (closed > 0) == (name in ("diagnostic", "diagnostic-decay", "diagnostic-hold"))


def test_the_advice_names_what_to_do_and_what_to_record():
    said = gap_next.advice("diagnostic-triangle", load())
    assert experiments()["diagnostic-triangle"] in said
    assert "record angle, extensor_pressure, flexor_pressure, extensor_voltage, flexor_voltage" in said


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--until", "check", "--json"], "leave --out and --json out"),
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


def _walk(folder, changes=None, scenario="default"):
    """Write what of a short walk of the graph says that its hardware was emulated."""
    metadata = run_metadata(load(changes or {}), scenario)
    with BagWriter(folder, metadata) as bag:
        bag.add_topic("/truth", "sensor_msgs/msg/JointState")
    return folder


def test_the_graph_repeats_the_hardware_of_a_bag_but_not_its_scenario(tmp_path, monkeypatch):
    monkeypatch.setattr(gap_graph, "need_ros", lambda: None)
    friction = {"plant.effects.joint_friction.coulomb": 0.3, "scenario.seed": 5}
    bag = _walk(tmp_path / "a", friction | scenario_overrides("diagnostic-hold"), "diagnostic-hold")
    hardware, runs = gap_graph.emulated([bag], ""), []
    monkeypatch.setattr(gap_graph, "run_graph", lambda *given: runs.append(given) or given[1].mkdir())
    bags = hardware.record("diagnostic-decay", tmp_path / "next", judged=True)
    assert [one.name for one in bags] == ["fitted", "held_out"]
    assert all(one.is_dir() for one in bags)
    for (parameters, _, scenario, mode), seed in zip(runs, (6, 7), strict=True):
        assert parameters.at("plant.effects.joint_friction.coulomb") == 0.3
        assert (
            parameters.flat()
            == load(friction | scenario_overrides("diagnostic-decay") | {"scenario.seed": seed}).flat()
        )
        assert scenario == "diagnostic-decay"
        assert mode.composed


def test_the_graph_does_what_is_new_and_can_be_used_beside_the_recordings(tmp_path, monkeypatch):
    monkeypatch.setattr(gap_graph, "need_ros", lambda: None)
    hardware = gap_graph.emulated([_walk(tmp_path / "a", {}, "diagnostic-hold")], "")
    left = {*experiments()} - {"diagnostic-hold", "diagnostic-locked"}
    assert {*hardware.experiments} == left
    assert {*hardware.having("diagnostic-decay").experiments} == left - {"diagnostic-decay"}
    found = _found("diagnostic-locked", "diagnostic-triangle")
    assert gap_next.next_experiment(found, (), hardware.experiments) == "diagnostic-triangle"


def test_a_failed_run_leaves_no_experiment(tmp_path, monkeypatch):
    def fails(_parameters, bag, *_):
        bag.mkdir()
        raise RunFailed("a node failed")

    monkeypatch.setattr(gap_graph, "run_graph", fails)
    hardware = gap_graph.Emulated(load(), frozenset())
    with pytest.raises(RunFailed):
        hardware.record("diagnostic-decay", tmp_path / "next" / "one", judged=False)
    assert list(tmp_path.iterdir()) == []


def test_only_what_the_graph_emulated_alike_is_repeated(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(gap_graph, "need_ros", lambda: None)
    new = ["--next", str(tmp_path / "new")]
    example, *_ = write_example("friction", tmp_path / "case")
    first = _walk(tmp_path / "a")
    other = _walk(tmp_path / "b", {"plant.effects.joint_friction.coulomb": 0.3})
    for measured, message in {
        (str(example),): "the graph did not emulate the hardware of",
        (str(first), str(other)): "are of different emulated hardware",
        (str(first), "--namespace", "left"): "of one joint, without --namespace",
        (str(first), "--until", "check"): "--until searches nothing",
    }.items():
        assert main(["gap", *measured, *new]) == 2
        assert message in capsys.readouterr().err
    assert main(["gap", str(first), "--next", str(first)]) == 2
    assert "is not an empty folder; choose another --next" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_search_goes_on_until_nothing_is_left_to_separate(tmp_path, capsys, monkeypatch):
    case = SimpleNamespace(data=SimpleNamespace(experiments=["diagnostic-cocontraction"]))
    # what each search finds must be told apart by
    answers = iter([("words",), ("diagnostic-decay",), ("diagnostic-decay",)])
    searched = []

    def search(arguments):
        searched.append(arguments)
        number = len(searched)
        return gap.Found(case, _found(*next(answers)), {"number": number}, f"answer {number}", number - 3)

    monkeypatch.setattr(gap, "_searched", search)
    monkeypatch.setattr(gap_graph, "need_ros", lambda: None)
    monkeypatch.setattr(gap_graph, "run_graph", lambda _parameters, bag, *_: bag.mkdir())
    bag, new = _walk(tmp_path / "a"), tmp_path / "new"
    assert main(["gap", str(bag), "--next", str(new)]) == 0
    added = [new / "diagnostic-cocontraction" / "fitted", new / "diagnostic-decay" / "fitted"]
    assert [one.measured for one in searched] == [[bag], [bag, added[0]], [bag, *added]]
    assert [one.held_out for one in searched] == [[], [], []]
    said = capsys.readouterr().out
    assert [said.index(f"answer {number}") for number in (1, 2, 3)] == sorted(
        said.index(f"answer {number}") for number in (1, 2, 3)
    )
    assert f"recorded in {new / 'diagnostic-decay'}" in said
