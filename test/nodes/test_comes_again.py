# SPDX-License-Identifier: Apache-2.0
"""A node or driver that leaves, or is killed, and comes again in a graph that nobody supervises."""

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from conftest import LIMIT_S, wait_for

from pam_orthosis.bag.read import read_bag
from pam_orthosis.model.parameters import load

pytest.importorskip("rclpy")
from pam_orthosis.nodes.launch import Mode, commands, environment, free_domain

BOUND_DEG = 5.0  # by the wall clock of a busy machine
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
        """Return the time of the newest step that is on disk since the first, s."""
        try:
            stamps = read_bag(self.bag, ["estimate_angle"])["estimate_angle"].stamp_ns
        except Exception:
            return 0.0
        return (stamps[-1] - stamps[0]) * 1e-9 if len(stamps) else 0.0

    def gone(self):
        """Return the nodes that have ended, with what they said."""
        ended = [name for name, process in self.processes.items() if process.poll() is not None]
        return {name: self.said(name) for name in ended}

    def close(self):
        for name in sorted(self.processes, key=lambda name: name == "bag_recorder"):
            if self.processes[name].poll() is None:
                self.end(name, signal.SIGTERM)


if __name__ == "__main__":
    pass
