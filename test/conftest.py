# SPDX-License-Identifier: Apache-2.0
"""What several rooms of the tests share: commands of the documentation, each run once."""

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
os.environ.setdefault(OFF, "1")  # what a command prints must not depend on how fast the machine is


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
