# SPDX-License-Identifier: Apache-2.0
"""`make` changes no environment that it did not create for this checkout."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def foreign(tmp_path):
    if shutil.which("make") is None:
        pytest.skip("make is not installed")
    folder = tmp_path / "foreign"
    (folder / "bin").mkdir(parents=True)
    (folder / "pyvenv.cfg").write_text("home = elsewhere\n")
    return folder


@pytest.mark.parametrize("target", ["setup", "docs", "clean"])
@pytest.mark.parametrize("owner", [None, "/another/checkout"])
def test_a_foreign_environment_is_refused_and_stays_as_it_is(foreign, target, owner):
    if owner:
        (foreign / ".made-by-make").write_text(f"{owner}\n")
    before = sorted(foreign.rglob("*"))
    done = subprocess.run(
        ["make", target, f"VENV={foreign}"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "make did not create this environment for this checkout" in done.stderr
    assert sorted(foreign.rglob("*")) == before


def test_results_of_the_paper_stay_if_they_cannot_be_made_again(foreign, tmp_path):
    checkout, program = tmp_path / "checkout", foreign / "bin" / "pam-orthosis"
    results = checkout / "benchmarks" / "results" / "paper.json"
    results.parent.mkdir(parents=True)
    results.write_text("kept")
    for name in ("Makefile", "setup.py", "pyproject.toml", "constraints.txt"):
        shutil.copy(ROOT / name, checkout)
    (foreign / ".ready").touch()  # nothing is installed
    program.write_text("#!/bin/sh\necho half\nexit 1\n")
    program.chmod(0o755)
    done = subprocess.run(
        ["make", "paper", f"VENV={foreign}"], cwd=checkout, capture_output=True, text=True, check=False
    )
    assert (done.returncode, "Error 1" in done.stderr) == (2, True)
    assert results.read_text() == "kept"


def test_every_installation_takes_the_tested_versions():
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    installing = [line for line in makefile.splitlines() if "pip install" in line]
    assert len(installing) == 2
    assert all("--constraint constraints.txt" in line for line in installing)
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = [line for line in lines if not line.startswith("#")]
    assert all(re.fullmatch(r"[\w.-]+==[\w.!+-]+; python_version == '3\.\d+'", line) for line in pinned)
    needed = re.findall(r'"([a-z]+)>=', (ROOT / "setup.py").read_text(encoding="utf-8"))
    names = {line.split("==")[0] for line in pinned}
    assert {"casadi", "numpy", "scipy"} <= set(needed)
    optional = {"mujoco", "pysindy"}  # of the extras bench and peer
    assert set(needed) - optional <= names
