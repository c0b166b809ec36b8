# SPDX-License-Identifier: Apache-2.0
"""What `run` does with its folder when the run fails, or another one has it."""

import errno
import shutil

import pytest

from pam_orthosis.bag import recover
from pam_orthosis.cli import main as entry
from pam_orthosis.cli import run
from pam_orthosis.errors import OrthosisError


@pytest.fixture
def unfinished(tmp_path):
    """The folder of a bag that nobody closed, and one with the nodes' output."""
    bag, work = tmp_path / "bag", tmp_path / "work"
    for folder in (bag, work):
        folder.mkdir()
    (bag / "bag_0.mcap").touch()
    (work / "node.log").write_text("no air")
    return bag, work


def _full(*_arguments, **_options):
    raise shutil.Error([("a", "b", OSError(errno.ENOSPC, "No space left on device"))] * 50)


def test_on_a_full_disk_the_bag_is_recovered_all_the_same(unfinished, monkeypatch):
    bag, work = unfinished
    recovered = []
    monkeypatch.setattr(recover, "recover_in_place", recovered.append)
    monkeypatch.setattr(shutil, "copytree", _full)
    assert run._rescue(bag, work) == f"the bag {bag} holds the run up to there"
    assert recovered == [bag]


def test_what_cannot_be_recovered_is_said_and_the_output_kept(unfinished, monkeypatch):
    def refuse(bag):
        raise OrthosisError(f"{bag} holds no readable message")

    bag, work = unfinished
    monkeypatch.setattr(recover, "recover_in_place", refuse)
    assert run._rescue(bag, work) == f"{bag} holds no readable message"
    assert (bag / "log" / "node.log").read_text() == "no air"


def _both_find_it_free(monkeypatch):
    """Let two runs look at a folder before either of them has it."""
    monkeypatch.setattr(run, "refuse_used", lambda folder: None)


@pytest.mark.parametrize("there", [True, False], ids=["an empty folder", "a new folder"])
def test_a_folder_belongs_to_one_run(tmp_path, monkeypatch, there):
    out = tmp_path / "bag"
    if there:
        out.mkdir()
    _both_find_it_free(monkeypatch)
    assert run.claim(out, "default")[0] == out
    with pytest.raises(OrthosisError, match="belongs to another run"):
        run.claim(out, "default")
    assert [one.name for one in out.iterdir()] == [run.CLAIM]


def test_without_out_the_second_run_takes_the_next_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first = run.claim(None, "gait")[0]
    _both_find_it_free(monkeypatch)
    monkeypatch.setattr(run, "_unused", _late(run._unused, first))
    assert [first.name, run.claim(None, "gait")[0].name] == ["gait-1", "gait-2"]


def _late(unused, taken):
    """Return `_unused` that finds a folder free, once, that somebody takes."""
    answers = [taken]
    return lambda scenario: answers.pop() if answers else unused(scenario)


def test_a_run_that_another_has_just_ended_in_is_left_alone(tmp_path, monkeypatch):
    out = tmp_path / "bag"
    refuse, looks = run.refuse_used, []
    monkeypatch.setattr(run, "refuse_used", lambda folder: refuse(folder) if looks else looks.append(folder))
    out.mkdir()
    (out / "bag_0.mcap").write_bytes(b"theirs")
    with pytest.raises(OrthosisError, match="not an empty folder"):
        run.claim(out, "default")
    assert [one.name for one in out.iterdir()] == ["bag_0.mcap"]


def test_what_failed_leaves_no_claim(tmp_path, monkeypatch):
    out, parser = tmp_path / "bag", run.argparse.ArgumentParser()
    run.add_arguments(parser)
    monkeypatch.setattr(run, "need_ros", lambda: None)
    monkeypatch.setattr(run, "_run", _no_air)
    with pytest.raises(OrthosisError, match="no air"):
        run.execute(parser.parse_args(["--out", str(out)]))
    assert not out.exists()


def _no_air(*_arguments):
    raise OrthosisError("no air")


def test_a_model_file_changes_beliefs_only_and_not_what_is_given_beside_it(tmp_path, capsys):
    pytest.importorskip("rclpy")
    model, out = tmp_path / "model.yaml", str(tmp_path / "walk")
    for text, said in (
        ("plant.external_torque: 12.0\n", "plant.external_torque is nothing that controllers believe"),
        ("scenario.duration: 3.0\n", "scenario.duration is nothing that controllers believe"),
        ("leg.shoe_mass: 1.0\n", "leg.shoe_mass: --param and"),
    ):
        model.write_text(text)
        assert entry.main(["run", "--model", str(model), "--param", "leg.shoe_mass=0.9", "--out", out]) == 2
        assert said in capsys.readouterr().err
    assert not (tmp_path / "walk").exists()


def test_one_plan_is_not_followed_by_two_legs(tmp_path, capsys):
    pytest.importorskip("rclpy")
    model = tmp_path / "model.yaml"
    model.write_text("scenario.plan.enabled: true\n")
    assert entry.main(["run", "--legs", "2", "--model", str(model), "--out", str(tmp_path / "walk")]) == 2
    assert "--legs 2: a plan is of one leg" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "value"),
    [("075", 75), ("1e-4", 1e-4), ("30", 30), ("true", True), ("[1, 2]", [1, 2]), ("gait", "gait")],
)
def test_numbers_are_read_as_everybody_reads_them(text, value):
    (read,) = run.assignments([f"key={text}"]).values()
    assert (read, type(read)) == (value, type(value))
