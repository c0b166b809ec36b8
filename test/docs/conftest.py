# SPDX-License-Identifier: Apache-2.0
"""The package as a user has it: the wheel, installed apart from the checkout."""

import fcntl
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Return the folder in which the wheel is installed."""
    folder = tmp_path_factory.mktemp("wheel")
    pip = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check"]
    with (ROOT / "setup.py").open() as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # another worker builds in the same folder
        subprocess.run(
            [*pip, "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", folder, ROOT], check=True
        )
    (wheel,) = folder.glob("*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", folder / "site", wheel], check=True)
    return folder / "site"


@pytest.fixture
def program(site, monkeypatch):
    """Return `pam-orthosis` of the wheel; what is started meanwhile imports the wheel's package."""
    monkeypatch.setenv("PYTHONPATH", str(site))
    return site / "bin" / "pam-orthosis"
