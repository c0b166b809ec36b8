# SPDX-License-Identifier: Apache-2.0
"""A node or driver that leaves, or is killed, and comes again in a graph that nobody supervises."""

import signal
import subprocess
import time
from contextlib import suppress

import numpy as np
import pytest
from conftest import LIMIT_S, wait_for
from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.parameters import load

pytest.importorskip("rclpy")
from pam_orthosis.nodes.launch import Mode, commands, environment, free_domain

BOUND_DEG = 3.0
SLOW = {
    "scenario.control_period": 0.02, "scenario.trajectory": "hold", "scenario.start_angle": 0.4,
    "control.position.c1": 12.0, "control.position.c2": 12.0, "control.observer.pole": 35.0,
    "control.pressure.gain": 20.0,
}  # fmt: skip


class Graph:
    """Nodes in processes of their own, started one by one as by hand."""

    def __init__(self, folder, domain, parameters, mode):
        self.bag, self._folder = folder / "walk", folder
        self._environment = environment(folder, domain)
        self._commands = commands(folder, parameters, self.bag, "default", mode)
        self.processes, self.logs = {}, {}
        for name in self._commands:
            self.start(name)

    def start(self, name):
        log = self.logs[name] = self._folder / f"{name}_{time.monotonic_ns()}.log"
        with open(log, "wb") as output:
            self.processes[name] = subprocess.Popen(
                self._commands[name], env=self._environment, stdout=output, stderr=output
            )

    def end(self, name, number):
        self.processes[name].send_signal(number)
        self.processes[name].wait(LIMIT_S)

    def said(self, name):
        return self.logs[name].read_text()

    def reached_s(self):
        """Return the time from the first to the newest message on disk, s."""
        stamps = []
        with suppress(OSError, McapError), open(self.bag / "walk_0.mcap", "rb") as stream:
            for record in StreamReader(stream).records:
                if isinstance(record, Message):
                    stamps.append(record.log_time)
        return (max(stamps) - min(stamps)) * 1e-9 if stamps else 0.0

    def gone(self):
        """Return the nodes that have ended, with what they said."""
        ended = [name for name, process in self.processes.items() if process.poll() is not None]
        return {name: self.said(name) for name in ended}

    def close(self):
        for name in sorted(self.processes, key=lambda name: name == "bag_recorder"):
            if self.processes[name].poll() is None:
                self.end(name, signal.SIGTERM)


def _error(bag):
    """Return stamps, s since the first sample, and the errors there, degrees."""
    recorded = read_bag(bag, ["angle", "reference_angle"])
    angle, reference = recorded["angle"], recorded["reference_angle"]
    wanted = np.interp(angle.stamp_ns, reference.stamp_ns, reference.value)
    return (angle.stamp_ns - angle.stamp_ns[0]) * 1e-9, np.rad2deg(np.abs(wanted - angle.value))


@pytest.mark.parametrize(("number", "seconds"), [(signal.SIGTERM, 4.0), (signal.SIGKILL, 0.5)])
def test_a_position_controller_that_comes_again_takes_its_place_and_the_knee_follows(
    tmp_path, number, seconds
):
    with free_domain() as domain:
        pass
    graph = Graph(tmp_path, domain, load({**SLOW, "scenario.duration": 3600.0}), Mode(realtime=True))
    try:
        wait_for(lambda: graph.reached_s() > 2.0)
        graph.end("position_controller", number)
        time.sleep(seconds)
        before = graph.reached_s()
        graph.start("position_controller")
        wait_for(lambda: graph.reached_s() > before + 16.0 or graph.gone())
        assert graph.gone() == {}
    finally:
        graph.close()
    assert all(process.returncode == 0 for process in graph.processes.values())
    time_s, error = _error(graph.bag)
    assert error.max() > 20.0  # it was let go
    settled = (time_s > before + 14.0) & (time_s < before + 16.0)
    assert settled.sum() > 50
    assert error[settled].max() < BOUND_DEG
