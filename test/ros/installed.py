# SPDX-License-Identifier: Apache-2.0
"""Commands in the environment of the package as colcon installs it."""

import os
import subprocess
from pathlib import Path

from own_domain import own_domain

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 300.0


def done(command, **options):
    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False, **options)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def sourced(install_space, command, domain=None, **options):
    """Start a command as after `source install/setup.bash`, outside the source tree."""
    script = f'source "{install_space}/setup.bash" && exec "$@"'
    # the editable installation must not stand in for the one under test
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= {
        "ROS_LOG_DIR": str(install_space),
        "ROS_DOMAIN_ID": str(own_domain() if domain is None else domain),
    }
    return subprocess.Popen(
        ["bash", "-c", script, "bash", *map(str, command)],
        cwd=install_space,
        env=environment,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        **options,
    )
