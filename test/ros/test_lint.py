# SPDX-License-Identifier: Apache-2.0
"""The linters of ament that PyPI has; the others need ROS from packages of the system."""

import subprocess
import sys
from pathlib import Path

from ament_pep257.main import main as pep257

ROOT = Path(__file__).resolve().parents[2]
CONFIG = str(Path(__file__).with_name("ament_flake8.ini"))
# Google's sections; a method may be described like "torque(...)", an argument by its class
DOCSTRINGS = ["--convention", "google", "--add-ignore", "D105", "D107", "D402", "D417", "--"]


def flake8(*paths):
    """Return exit status and output; in its own process: it forks, and tests leave threads."""
    command = [Path(sys.executable).with_name("ament_flake8"), "--config", CONFIG, *paths]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    return done.returncode, done.stdout


def test_ament_flake8_finds_nothing():
    status, said = flake8(*(ROOT / name for name in ("pam_orthosis", "scripts", "test", "setup.py")))
    assert status == 0, said


def test_ament_flake8_sees_a_fault(tmp_path):
    (tmp_path / "bad.py").write_text("import os\n")
    status, said = flake8(tmp_path)
    assert status == 1
    assert "F401" in said


def test_ament_pep257_finds_nothing(capsys):
    status = pep257([*DOCSTRINGS, str(ROOT / "pam_orthosis")])
    assert status == 0, capsys.readouterr().err


def test_ament_pep257_sees_a_fault(tmp_path):
    (tmp_path / "bad.py").write_text('def f():\n    """returns nothing"""\n')
    assert pep257([*DOCSTRINGS, str(tmp_path)]) == 1
