# SPDX-License-Identifier: Apache-2.0
"""What several rooms of the tests share: commands of the documentation, each run once; machines of users."""

import os
import shlex
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

from pam_orthosis.cli.main import main
from pam_orthosis.progress import OFF

ROOT = Path(__file__).resolve().parents[1]
MACHINES = {
    "slide": """
meaning: a double-acting cylinder on a carriage
mechanism: {kind: translation, inertia: 5.0, damping: 40.0, minimum: 0.0, maximum: 0.3, start: 0.15}
actuators:
  push: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3, transmission: {arm: 1.0}}
  pull: {kind: cylinder, area: 8.0e-4, volume: 2.0e-5, length: 0.3,
         transmission: {arm: -1.0, contraction: 0.3}}
sensor: {noise: 1.0e-5}
""",
    "elbow": """
meaning: a forearm between two muscles
mechanism: {kind: rotation, inertia: 0.1, damping: 0.4, weight: 3.0, hanging: -1.2, minimum: -0.8,
            maximum: 0.8, start: 0.1}
actuators:
  biceps: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: 0.03, contraction: 0.05}}
  triceps: {kind: muscle, parameters: muscle.dmsp_20, transmission: {arm: -0.03, contraction: 0.05}}
sensor: {noise: 1.0e-4}
""",
}
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # tests share the cores; set before numpy is loaded
os.environ.setdefault(OFF, "1")  # what a command prints must not depend on how fast the machine is


sys.path.insert(0, str(ROOT / "test" / "report"))
from browser import fits, started  # noqa: E402


@pytest.fixture
def page_fits():
    """Return a function that opens a page in a browser and checks it; skip if there is none."""

    def check(file):
        with started() as browser:
            fits(browser, file)

    return check


@pytest.fixture
def compiler():
    """Skip where the package finds no compiler, but not in CI: such tests guard what is loaded."""
    if not (shutil.which("gcc") or shutil.which("cc")):
        assert not os.environ.get("CI"), "CI needs gcc or cc"
        pytest.skip("neither gcc nor cc is installed")


@pytest.fixture(scope="session")
def documented(tmp_path_factory):
    """Return a function: a command line of the documentation -> (exit status, the new folder it ran in)."""

    @cache
    def run(line):
        folder = tmp_path_factory.mktemp("documented")
        for name in ("bags", "config"):
            shutil.copytree(ROOT / name, folder / name)
        program, *arguments = shlex.split(line)
        assert program == "pam-orthosis"
        if arguments[0] == "run":  # takes signals for its own process
            command = [sys.executable, "-m", "pam_orthosis.cli.main", *arguments]
            return subprocess.run(command, cwd=folder, check=False).returncode, folder
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            return main(arguments), folder

    return run


@pytest.fixture(scope="session")
def machine_files(tmp_path_factory):
    """Return files of machines that are not shipped: name -> path."""
    folder = tmp_path_factory.mktemp("machines")
    for name, text in MACHINES.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.yaml" for name in MACHINES}


@pytest.fixture(scope="session")
def install_space(tmp_path_factory):
    """Return the folder into which colcon has installed the package."""
    folder = tmp_path_factory.mktemp("workspace")
    colcon = Path(sys.executable).with_name("colcon")
    bases = ["--build-base", folder / "build", "--install-base", folder / "install"]
    command = [colcon, "--log-base", folder / "log", "build", "--base-paths", ROOT, *bases]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stdout + built.stderr
    return folder / "install"
