# SPDX-License-Identifier: Apache-2.0
"""Recordings that come with the package, written by the verb `example`."""

import json
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.bag import arrays, examples
from pam_orthosis.bag.read import read_bag
from pam_orthosis.cli.main import main
from pam_orthosis.model.parameters import load

ROOT = Path(__file__).resolve().parents[2]


def test_the_list_names_every_example(capsys):
    assert main(["example", "--list"]) == 0
    printed = capsys.readouterr().out
    assert [line.split()[0] for line in printed.splitlines()] == [*examples.BAGS, *examples.CASES]


@pytest.mark.parametrize("name", examples.BAGS)
def test_a_bag_is_a_copy_that_can_be_judged(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["example", name]) == 0
    assert capsys.readouterr().out == f"{name}\n"
    for file in (ROOT / "bags" / name).iterdir():
        assert (tmp_path / name / file.name).read_bytes() == file.read_bytes()
    assert main(["check", name]) == 0


def test_a_case_is_bags_that_the_gap_workflow_reads(tmp_path, capsys):
    folder = tmp_path / "case"
    assert main(["example", "friction", "--out", str(folder)]) == 0
    bags = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [bag.name for bag in bags] == [
        "training_gait", "training_diagnostic", "held_out_gait", "held_out_diagnostic",
    ]  # fmt: skip
    sensor = load().plant.sensor
    for path in bags:
        bag = read_bag(path, tuple(examples.MEASURED))
        steps = bag["angle"].value / sensor.angle_resolution
        assert np.abs(steps - np.round(steps)).max() < 1e-6
        assert np.ptp(bag["angle"].value) > 0.3
        assert 1e5 < bag["extensor_pressure"].value.min() < bag["extensor_pressure"].value.max() < 7e5
        assert bag.parameters["valve.dead_band"] == 0.0
        assert not any(key.startswith("plant.") for key in bag.parameters)
    truth = json.loads((folder / "sealed" / "truth.json").read_text())
    assert list(truth["effects"]) == ["joint_friction"]
    stages = [str(bags[0]), "--held-out", str(bags[2]), "--until", "check"]
    assert main(["gap", *stages]) == 0
    assert "these data would not show" in capsys.readouterr().out


def test_what_cannot_be_written_is_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys):
    assert main(["example", "nothing", "--out", str(tmp_path / "new")]) == 2
    assert "no example 'nothing'; there are: walk" in capsys.readouterr().err
    (tmp_path / "used").mkdir()
    (tmp_path / "used" / "mine").touch()
    assert main(["example", "walk", "--out", str(tmp_path / "used")]) == 2
    assert [one.name for one in (tmp_path / "used").iterdir()] == ["mine"]
    assert main(["example"]) == 2

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(arrays, "write_arrays", full)
    capsys.readouterr()
    assert main(["example", "friction", "--out", str(tmp_path / "full")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "full").exists()
