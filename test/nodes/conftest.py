# SPDX-License-Identifier: Apache-2.0
"""Real runs of the graph for tests, and a look at their processes."""

import os
import subprocess

import pytest
from live_runs import LIMIT_S, QUICK, RUN, LiveRun

from pam_orthosis.model.parameters import config_folder
from pam_orthosis.nodes.launch import free_domain


@pytest.fixture(scope="session")
def run_graph(tmp_path_factory):
    """Return a function that runs the graph to its end: options -> (finished process, bag)."""
    pytest.importorskip("rclpy")

    def run(*options):
        bag = tmp_path_factory.mktemp("run") / "walk"
        command = [*RUN, "--out", str(bag), *QUICK, *options]
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        return done, bag

    return run


@pytest.fixture(scope="session")
def in_processes(run_graph):
    """One second of gait, each node in a process of its own."""
    return run_graph("--duration", "1")


@pytest.fixture
def live_run(tmp_path):
    """Return a function that starts an endless run."""
    pytest.importorskip("rclpy")
    runs = []

    def start(*options):
        runs.append(LiveRun(tmp_path / "walk", *options))
        return runs[-1]

    yield start
    for run in runs:
        if run.process.poll() is None:
            os.kill(run.process.pid, 15)
            run.process.communicate(timeout=LIMIT_S)


@pytest.fixture
def stranger(monkeypatch):
    """Return a ROS node of somebody else in a domain that the environment names."""
    rclpy = pytest.importorskip("rclpy")
    with free_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "loopback.xml"))
        context = rclpy.Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node("stranger", context=context)
        yield node
        node.destroy_node()
        rclpy.shutdown(context=context)


@pytest.fixture
def caller(monkeypatch):
    """Return somebody in the domain that the environment names, who calls services."""
    pytest.importorskip("rclpy")
    from caller import Caller

    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(config_folder() / "loopback.xml"))
    with free_domain() as domain:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain))
        made = Caller(domain)
        yield made
        made.close()
