# SPDX-License-Identifier: Apache-2.0
"""The tutorials to the letter, each in an empty folder, with the wheel and not the checkout.

Commands that take minutes are left to `make docs-commands`, which runs all in a fresh environment.
"""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from pam_orthosis.discrepancy.systems.knee import APPARATUS
from pam_orthosis.model.parameters import load

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import commands as shown  # noqa: E402

TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))


def test_the_program_is_that_of_the_wheel(program, tmp_path):
    found = shown.run("python -c 'import pam_orthosis; print(pam_orthosis.__file__)'", tmp_path, program)
    assert found.stdout.startswith(str(program.parents[1]))


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_works_from_an_empty_folder(tutorial, program, tmp_path):
    pytest.importorskip("rclpy")
    listed = [command for command in shown.commands(tutorial) if command.kind == "short"]
    assert listed
    assert not list(tmp_path.iterdir())
    for command in listed:
        done = shown.run(command.line, tmp_path, program)
        assert done.returncode in (0, 1), f"{command.line}\n{done.stderr}"
        if command.shown:
            page = (shown.SHOWN / command.shown).read_text(encoding="utf-8")
            assert shown.as_shown(done.stdout) == page, (
                f"run `python docs/commands.py --keep --only {tutorial.stem}`"
            )


def test_the_apparatus_that_a_tutorial_writes_down_is_that_of_the_example():
    with np.load(ROOT / "bags" / "friction.npz") as packed:
        about = json.loads(str(packed["about"]))
    page = (ROOT / "docs" / "tutorials" / "own-recordings.md").read_text(encoding="utf-8")
    stated = yaml.safe_load("\n".join(re.findall(r"^echo '(.+)' >>? nominal.yaml$", page, flags=re.M)))
    nominal, example = (load(values).flat() for values in (stated, about["nominal"]))
    own = [key for key in example if key.startswith(APPARATUS)]
    assert {key: nominal[key] for key in own} == {key: example[key] for key in own}


def test_the_estimate_and_the_truth_that_a_tutorial_compares_are_those_of_the_example():
    with np.load(ROOT / "bags" / "friction.npz") as packed:
        truth = json.loads(str(packed["about"]))["answer"]["effects"]["joint_friction"]["coulomb"]
    answer = (shown.SHOWN / "gap.txt").read_text(encoding="utf-8")
    estimate = map(float, re.search(r"coulomb (\S+) N m \((\S+) .. (\S+)\)", answer).groups())
    page = (ROOT / "docs" / "tutorials" / "find-a-gap.md").read_text(encoding="utf-8")
    value, low, high = (f"{number:.3f}" for number in estimate)
    assert f"Coulomb torque of {truth:.3f} N m" in page
    assert f"The estimate is {value}, with an interval from {low} to {high}" in " ".join(page.split())
