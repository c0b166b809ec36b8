# SPDX-License-Identifier: Apache-2.0
"""Two nodes that leave a run in lockstep at the same time, and come again."""

import os
import signal
import subprocess
import sys

import pytest
from live_runs import LIMIT_S, holds_messages, wait_for

from pam_orthosis.bag.topics import PLANT, VALVE, Topics
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import config_folder
from pam_orthosis.nodes.launch import free_domain

OTHERS = [node for node in Topics(KNEE).nodes if node not in (PLANT, VALVE)]


@pytest.fixture
def start(tmp_path):
    """Return a function that starts nodes in one process by hand, in a domain of their own."""
    pytest.importorskip("rclpy")
    started = []
    with free_domain() as domain:
        own = {"ROS_DOMAIN_ID": str(domain), "ROS_LOG_DIR": str(tmp_path)}
        own |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(config_folder() / "loopback.xml")}

        def process(*nodes):
            given = {"scenario.duration": 2.0, f"{PLANT}:paced": True, "bag_recorder:directory": "bag"}
            words = [word for name, value in given.items() for word in ("-p", f"{name}:={value}")]
            command = [sys.executable, "-m", "pam_orthosis.nodes.entry", "composed", *nodes, "--ros-args"]
            environment = {**os.environ, **own}
            started.append(subprocess.Popen([*command, *words], cwd=tmp_path, env=environment))
            return started[-1]

        yield process
        for one in started:
            one.kill()


def test_valve_model_and_plant_that_come_again_together_go_on_to_the_end(start, tmp_path):
    others, *leaving = start(*OTHERS), start(VALVE), start(PLANT)
    wait_for(lambda: holds_messages(tmp_path / "bag" / "bag_0.mcap"))
    for process in leaving:
        process.send_signal(signal.SIGKILL)
        process.wait()
    again = start(VALVE), start(PLANT)
    assert [process.wait(LIMIT_S) for process in (others, *again)] == [0, 0, 0]
