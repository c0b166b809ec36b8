# SPDX-License-Identifier: Apache-2.0
"""`--help` answers at once: what takes its time to load waits until it is needed."""

import subprocess
import sys

import pytest

from pam_orthosis.cli.main import VERBS

HEAVY = ("casadi", "dask", "jinja2", "matplotlib", "numpy", "rclpy", "rosbags", "scipy")
TELL = """
import sys
from pam_orthosis.cli.main import main
try:
    main([sys.argv[1], "--help"])
except SystemExit:
    pass
print(*sorted(name for name in sys.modules))
"""


def _loaded(verb):
    done = subprocess.run(
        [sys.executable, "-c", TELL, verb], capture_output=True, text=True, timeout=60, check=True
    )
    help_text, _, modules = done.stdout.rstrip().rpartition("\n")
    assert f"usage: pam-orthosis {verb}" in help_text
    return set(modules.split())


@pytest.mark.parametrize("verb", VERBS)
def test_help_loads_nothing_heavy(verb):
    loaded = _loaded(verb)
    assert loaded.isdisjoint(HEAVY)
    assert len([name for name in loaded if name.startswith("pam_orthosis")]) < 20
