# SPDX-License-Identifier: Apache-2.0
"""Single nodes that are started with what they cannot use: one line, status 2, no traceback; their help."""

import os
import subprocess
import sys

import pytest
from own_domain import own_domain

pytest.importorskip("rclpy")
ERROR = "pam-orthosis: error: "


def _started(tmp_path, node, *arguments):
    return subprocess.run(
        [sys.executable, "-m", "pam_orthosis.nodes.entry", node, "--ros-args", *arguments],
        env={**os.environ, "ROS_LOG_DIR": str(tmp_path), "ROS_DOMAIN_ID": str(own_domain())},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


@pytest.mark.parametrize(
    ("node", "arguments", "said"),
    [
        ("position_controller", ["-p", "foo"], "Couldn't parse parameter override rule: '-p foo'"),
        ("leg_state_publisher", ["--params-file", "/none.yaml"], "Couldn't parse params file"),
        ("live_view", ["-p", "leg.person.weight:=1.0"], "live_view has no parameter leg.person.weight"),
        ("live_view", ["-p", "machine_file:=/none.yaml"], "/none.yaml"),
        ("dummy_driver", ["--foo"], "cannot use the arguments behind --ros-args: ['--foo']"),
        ("dummy_driver", ["-p", "scenario.period:=0.01"], "has no parameter scenario.period"),
        ("dummy_driver", ["-p", "scenario.control_period:=50.0"], "scenario.control_period"),
        ("bag_recorder", ["-p", "legs:='5'"], "legs must be like"),
        ("bag_recorder", ["-p", "legs:='left'"], "legs is not valid JSON"),
        ("bag_recorder", ["-p", "sample_timeout:=-1.0"], "sample_timeout must be a positive number"),
        ("plant_simulator", ["-p", "answer_timeout:=.nan"], "answer_timeout must be a positive number"),
        ("session_conductor", [], "no programme is given: name its file"),
        ("composed", ["-p", "autostart:=false"], "with autostart:=false name the nodes"),
    ],
)
def test_one_line_says_what_is_wrong(tmp_path, node, arguments, said):
    done = _started(tmp_path, node, *arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    (line,) = [line for line in done.stderr.splitlines() if line.startswith(ERROR)]
    assert said in line


def test_help_is_one_screen_and_starts_nothing():
    command = [sys.executable, "-m", "pam_orthosis.nodes.entry", "extensor_pressure_controller", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.startswith("usage: extensor_pressure_controller [--ros-args")
    assert "Node: pressure controller of one actuator" in done.stdout
    assert len(done.stdout.splitlines()) < 24
    assert done.stderr == ""
