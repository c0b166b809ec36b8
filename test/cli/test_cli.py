# SPDX-License-Identifier: Apache-2.0
"""Usage, errors and exit status of the entry script."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pam_orthosis.cli.main import VERBS, main
from pam_orthosis.cli.parameters import _assignment

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"


def test_help_of_the_program_and_of_each_verb(capsys):
    for arguments in (["--help"], *([verb, "--help"] for verb in VERBS)):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == 0
    text = capsys.readouterr().out
    assert all(verb in text for verb in VERBS)
    assert "--bound-deg" in text


def test_help_loads_no_verb():
    code = (
        "import sys; from pam_orthosis.cli.main import main\n"
        "try: main(['--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'numpy', 'casadi', 'rclpy'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["walk"], "invalid choice"),
        (["check"], "required"),
        (["check", "nowhere"], "no bag at nowhere"),
        (["check", ".", "--bound-deg", "nan"], "--bound-deg"),
        (["run", "--scenario", "moon"], "no scenario 'moon'"),
        (["run", "--param", "leg.lenght=1"], "unknown parameter leg.lenght"),
        (["run", "--param", "seed"], "give KEY=VALUE"),
        (["run", "--duration", "nan"], "scenario.duration"),
        (["run", "--duration", "-1"], "scenario.duration"),
        (["run", "--param", "scenario.trajectory=sine"], "give --param scenario.start_angle=0.6"),
        (["recover", "nowhere"], "expected .mcap files"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(arguments, message, capsys, tmp_path, monkeypatch):
    pytest.importorskip("rclpy")
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("pam-orthosis: error: ")
    assert message in error
    assert error.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_existing_run_is_not_overwritten(tmp_path, capsys):
    pytest.importorskip("rclpy")
    (tmp_path / "notes.txt").write_text("mine")
    assert main(["run", "--out", str(tmp_path)]) == 2
    assert "not an empty folder" in capsys.readouterr().err
    assert (tmp_path / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("a.b=3", 3),
        ("a.b=3.5", 3.5),
        ("a.b=1e-4", 1e-4),
        ("a.b=true", True),
        ("a.b=false", False),
        ("a.b=gait", "gait"),
        ("a.b=geometric", "geometric"),
        ("a.b=[1.0, 2.0]", [1.0, 2.0]),
    ],
)
def test_values_of_parameters(text, value):
    assert _assignment(text) == ("a.b", value)


@pytest.mark.parametrize("kind", [ZeroDivisionError, GeneratorExit])
def test_what_nobody_foresaw_is_one_line_and_no_answer(tmp_path, capsys, monkeypatch, kind):
    from pam_orthosis.bag import verdict

    def failing(*_):
        raise kind("division by zero")

    monkeypatch.setattr(verdict, "judge_all", failing)
    assert main(["check", str(tmp_path)]) == 3
    said = capsys.readouterr().err
    assert f"unforeseen {kind.__name__} in check.py:" in said
    assert len(said.splitlines()) == 1
    monkeypatch.setenv("PAM_ORTHOSIS_TRACEBACK", "1")
    with pytest.raises(kind):
        main(["check", str(tmp_path)])


ODD = os.fsdecode(b"b\xe4g")  # a name that is no UTF-8


@pytest.mark.parametrize("arguments", [["check"], ["report", "--only", "table"], ["recover"]])
def test_a_name_that_is_no_text_is_read_and_told(tmp_path, arguments):
    verb, *options = arguments
    shutil.copytree(WALK, tmp_path / ODD)
    command = [sys.executable, "-m", "pam_orthosis.cli.main", verb, ODD, *options]
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, check=False)
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout


@pytest.mark.parametrize("arguments", [["run", "--duration", "1", "--out"], ["replay", str(WALK), "--out"]])
def test_a_name_that_no_node_can_be_told_is_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments):
    pytest.importorskip("rclpy")
    monkeypatch.chdir(tmp_path)
    assert main([*arguments, ODD]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "b\\udce4g' is not UTF-8, and parameters of ROS nodes must be; choose another name" in said
    assert list(tmp_path.iterdir()) == []
