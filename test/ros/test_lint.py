# SPDX-License-Identifier: Apache-2.0
"""The linters of ament that PyPI has; the others need ROS from packages of the system."""

from pathlib import Path

from ament_flake8.main import main_with_errors
from ament_pep257.main import main as pep257

ROOT = Path(__file__).resolve().parents[2]
CONFIG = str(Path(__file__).with_name("ament_flake8.ini"))
# Google's sections; a method may be described like "torque(...)", an argument by its class
DOCSTRINGS = ["--convention", "google", "--add-ignore", "D105", "D107", "D402", "D417", "--"]


def test_ament_flake8_finds_nothing():
    paths = [str(ROOT / name) for name in ("pam_orthosis", "scripts", "test", "setup.py")]
    status, errors = main_with_errors(argv=["--config", CONFIG, *paths])
    assert status == 0, "\n".join(errors)


def test_ament_flake8_sees_a_fault(tmp_path):
    (tmp_path / "bad.py").write_text("import os\n")
    status, errors = main_with_errors(argv=["--config", CONFIG, str(tmp_path)])
    assert status == 1
    assert any("F401" in error for error in errors)


def test_ament_pep257_finds_nothing(capsys):
    status = pep257([*DOCSTRINGS, str(ROOT / "pam_orthosis")])
    assert status == 0, capsys.readouterr().err


def test_ament_pep257_sees_a_fault(tmp_path):
    (tmp_path / "bad.py").write_text('def f():\n    """returns nothing"""\n')
    assert pep257([*DOCSTRINGS, str(tmp_path)]) == 1
