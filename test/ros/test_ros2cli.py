# SPDX-License-Identifier: Apache-2.0
"""The recipe of seven shells with the real `ros2`, where it is installed, and what its tools say."""

import os
import re
import signal
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from installed import LIMIT_S, ROOT, sourced

from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.nodes.launch import free_domain

PAGE = ROOT / "docs" / "howto" / "shells.md"
TRIES = 20  # of a tool that may look before the node is known
pytestmark = pytest.mark.skipif(not find_spec("ros2cli"), reason="ros2 is not installed: it is not on PyPI")


@pytest.fixture
def ros2(install_space, tmp_path, monkeypatch):
    """Return a function that starts `ros2 ...` in one domain."""
    monkeypatch.setenv("AMENT_PREFIX_PATH", sys.prefix)
    with free_domain() as domain:
        yield lambda *words, **options: sourced(
            install_space, [Path(sys.executable).with_name("ros2"), *words], domain, **options
        )


@pytest.fixture
def said(ros2):
    """Return a function that returns what `ros2 ...` says."""
    return lambda *words: ros2(*words).communicate(timeout=LIMIT_S)[0]


@pytest.fixture
def until(said):
    """Return a function that says it again while discovery has not found what is wanted."""

    def again(wanted, *words):
        answers = (said(*words) for _ in range(TRIES))
        assert any(wanted in answer for answer in answers), words

    return again


def test_the_tools_see_the_nodes_their_messages_and_parameters(ros2, said, until, tmp_path):
    lines = re.findall(r"^ros2 (run pam_orthosis .*)$", PAGE.read_text(encoding="utf-8"), flags=re.M)
    wanted = [line.replace("=10.0", "=3600.0").replace("by_hand", str(tmp_path / "bag")) for line in lines]
    shells = [ros2(*line.split(), start_new_session=True) for line in wanted]

    try:
        assert "ready" in shells[0].stdout.readline()
        table = Topics(KNEE)
        for topic in table.of_run().values():
            if topic.rate == "step" and topic.producers:
                until("nanosec", "topic", "echo", "--once", f"/{topic.name.lstrip('/')}")
        for node in table.nodes:
            assert 10 < len(said("param", "list", f"/{node}").splitlines()) < 60
        assert "pam_orthosis" not in said("doctor")
    finally:
        for shell in shells:
            os.killpg(shell.pid, signal.SIGTERM)
        for shell in shells:
            shell.communicate(timeout=LIMIT_S)


def test_a_node_that_is_led_by_hand_answers_as_the_page_shows(ros2, until):
    node = "/position_controller"
    shell = ros2(
        "run", "pam_orthosis", node[1:], "--ros-args", "-p", "autostart:=false", start_new_session=True
    )

    try:
        until("configure [1]", "lifecycle", "list", node)
        transcript = re.findall(
            r"^\$ ros2 (lifecycle .*)\n(.*)$", PAGE.read_text(encoding="utf-8"), flags=re.M
        )
        assert len(transcript) == 4
        for words, answer in transcript:
            until(answer, *words.split())
        until("/controller_state: sensor_msgs/msg/JointState", "node", "info", node)
        until(f"{node}/change_state: lifecycle_msgs/srv/ChangeState", "node", "info", node)
    finally:
        os.killpg(shell.pid, signal.SIGTERM)
        assert "waits for plant_simulator" in shell.communicate(timeout=LIMIT_S)[0]
