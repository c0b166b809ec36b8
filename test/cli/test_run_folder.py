# SPDX-License-Identifier: Apache-2.0
"""What `run` does with its folder when the run fails, or another one has it."""

import errno
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack

import pytest

from pam_orthosis import files
from pam_orthosis.bag import recover
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.cli import main as entry
from pam_orthosis.cli import parameters, run
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.nodes import supervisor


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
    assert run._rescue(bag, work) == f"{bag} holds no readable message; logs in {bag / 'log'}"
    assert (bag / "log" / "node.log").read_text() == "no air"


def test_what_an_interruption_left_is_told_once(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(supervisor, "Child", interrupt)
    bag = tmp_path / "bag"
    with pytest.raises(RunFailed, match=r"\Ainterrupted; nothing was recorded\Z"):
        run.supervise_recorded({"node": ["true"]}, {}, tmp_path, lambda _: None, bag)
    with BagWriter(bag) as writer:
        writer.add_topic("/joint_states", "sensor_msgs/msg/JointState")
    (work := tmp_path / "work").mkdir()
    assert run._rescue(bag, work) == f"nothing was recorded; logs in {bag / 'log'}"


@pytest.mark.parametrize("there", [True, False], ids=["an empty folder", "a new folder"])
def test_a_folder_belongs_to_one_run(tmp_path, there):
    out = tmp_path / "bag"
    if there:
        out.mkdir()
    with ExitStack() as first, ExitStack() as second:
        assert run.claim(first, out, "default") == out
        with pytest.raises(OrthosisError, match="belongs to another run"):
            run.claim(second, out, "default")
        assert list(out.iterdir()) == []
    assert out.exists() == there


def test_without_out_the_second_run_takes_the_next_number(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with ExitStack() as first, ExitStack() as second:
        taken = run.claim(first, None, "gait")
        monkeypatch.setattr(run, "_unused", _late(run._unused, taken))
        assert [taken.name, run.claim(second, None, "gait").name] == ["gait-1", "gait-2"]


def _late(unused, taken):
    """Return `_unused` that finds a folder free, once, that somebody takes."""
    answers = [taken]
    return lambda scenario: answers.pop() if answers else unused(scenario)


def test_without_out_a_place_that_cannot_be_written_is_told(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("mine")
    with ExitStack() as stack, pytest.raises(OrthosisError, match="runs is no folder"):
        run.claim(stack, None, "gait")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP], ids=lambda number: number.name)
def test_the_claim_of_a_run_that_was_killed_is_gone(tmp_path, number):
    """It leaves nothing, and the folder is free for the next run."""
    out = tmp_path / "bag"
    code = (
        "import sys, time; from contextlib import ExitStack; from pathlib import Path\n"
        "from pam_orthosis.cli import run\n"
        "with ExitStack() as stack:\n"
        "    run.claim(stack, Path(sys.argv[1]), 'default'); print('claimed', flush=True); time.sleep(60)"
    )
    heed = ["env", "--default-signal=HUP"]  # under nohup it is ignored
    with subprocess.Popen([*heed, sys.executable, "-c", code, out], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"claimed\n"
        with ExitStack() as stack, pytest.raises(OrthosisError, match="belongs to another run"):
            run.claim(stack, out, "default")
        process.send_signal(number)
    assert list(out.iterdir()) == []
    with ExitStack() as stack:
        assert run.claim(stack, out, "default") == out


def test_a_run_that_another_has_just_ended_in_is_left_alone(tmp_path, monkeypatch):
    out = tmp_path / "bag"
    refuse, looks = files.refuse_used, []
    monkeypatch.setattr(
        files, "refuse_used", lambda folder: refuse(folder) if looks else looks.append(folder)
    )
    out.mkdir()
    (out / "bag_0.mcap").write_bytes(b"theirs")
    with ExitStack() as stack, pytest.raises(OrthosisError, match="not an empty folder"):
        run.claim(stack, out, "default")
    assert [one.name for one in out.iterdir()] == ["bag_0.mcap"]


def test_what_failed_leaves_no_folder(tmp_path, monkeypatch):
    out = tmp_path / "new" / "bag"
    with pytest.raises(OrthosisError, match="no air"):
        _execute(monkeypatch, _no_air, "--out", str(out))
    assert list(tmp_path.iterdir()) == []


def test_a_way_through_a_folder_that_is_not_there_is_the_same_before_and_after(tmp_path, monkeypatch):
    """`x/rel/../rel2`: `rel` is made by nobody, so nobody removes it."""
    seen = []
    with pytest.raises(OrthosisError, match="no air"):
        _execute(
            monkeypatch,
            lambda *given: seen.append(given[1]) or _no_air(),
            "--out",
            f"{tmp_path}/x/rel/../rel2",
        )
    assert seen == [tmp_path / "x" / "rel2"]
    assert list(tmp_path.iterdir()) == []


def _execute(monkeypatch, body, *arguments):
    parser = run.argparse.ArgumentParser()
    run.add_arguments(parser)
    monkeypatch.setattr(run, "need_ros", lambda: None)
    monkeypatch.setattr(run, "run_graph", body)
    run.execute(parser.parse_args(arguments))


def _no_air(*_arguments):
    raise OrthosisError("no air")


def test_a_model_file_changes_the_nominal_model_only_and_not_what_is_given_beside_it(tmp_path, capsys):
    pytest.importorskip("rclpy")
    model, out = tmp_path / "model.yaml", str(tmp_path / "walk")
    for text, said in (
        ("plant.external_torque: 12.0\n", "plant.external_torque is not of the nominal model"),
        ("scenario.duration: 3.0\n", "scenario.duration is not of the nominal model"),
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
    (read,) = parameters.assignments([f"key={text}"]).values()
    assert (read, type(read)) == (value, type(value))
