# SPDX-License-Identifier: Apache-2.0
"""The package as colcon installs it."""

import sys
from pathlib import Path

import pytest
from installed import ROOT, done


@pytest.fixture(scope="session")
def install_space(tmp_path_factory):
    """Return the folder into which colcon has installed the package."""
    folder = tmp_path_factory.mktemp("workspace")
    colcon = Path(sys.executable).with_name("colcon")
    bases = ["--build-base", folder / "build", "--install-base", folder / "install"]
    done([colcon, "--log-base", folder / "log", "build", "--base-paths", ROOT, *bases], cwd=folder)
    return folder / "install"
