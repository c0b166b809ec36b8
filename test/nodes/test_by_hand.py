# SPDX-License-Identifier: Apache-2.0
"""The recipe of seven shells, as its page has it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from live_runs import LIMIT_S

from pam_orthosis.cli.main import main
from pam_orthosis.model.parameters import config_folder
from pam_orthosis.nodes.launch import free_domain

PAGE = Path(__file__).resolve().parents[2] / "docs" / "howto" / "shells.md"
START = "ros2 run pam_orthosis "


def test_seven_shells_in_the_reverse_order_walk(tmp_path):
    pytest.importorskip("rclpy")
    lines = re.findall(rf"^{START}(.*)$", PAGE.read_text(encoding="utf-8"), flags=re.M)
    assert len(lines) == 7
    with free_domain() as domain:
        own = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(tmp_path)}
        own |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(config_folder() / "loopback.xml")}
        shells = [
            subprocess.Popen(
                [sys.executable, "-m", "pam_orthosis.nodes.entry", *line.replace("=10.0", "=1.0").split()],
                cwd=tmp_path,
                env={**os.environ, **own},
            )
            for line in reversed(lines)
        ]
        try:
            assert [shell.wait(LIMIT_S) for shell in shells] == [0] * 7
        finally:
            for shell in shells:
                shell.kill()
    assert main(["check", str(tmp_path / "by_hand")]) == 0
