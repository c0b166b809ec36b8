# SPDX-License-Identifier: Apache-2.0
"""Runs of the graph that tests watch and disturb, and how long they may take."""

import os
import subprocess
import sys
import time
from functools import reduce
from pathlib import Path

import numpy as np
from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from zstandard import ZstdError

RUN = [sys.executable, "-m", "pam_orthosis.cli.main", "run"]
QUICK = ["--param", "scenario.start_hold=0.1", "--param", "scenario.start_ramp=0.2"]
HEED = ["env", "--default-signal=HUP,INT,TERM"]  # a shell in the background has children ignore SIGINT
LIMIT_S = 600.0  # after which a test counts as hung: no test is about speed


class LiveRun:
    """A run without end, to be disturbed."""

    def __init__(self, bag, *options):
        self.bag = bag
        command = [*HEED, *RUN, "--out", str(bag), "--duration", "3600", *options]
        environment = {**os.environ, "TMPDIR": str(bag.parent)}
        self.process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)

    def children(self):
        """Return process id by name of the node."""
        path = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children")
        return {_node_name(pid): pid for pid in map(int, path.read_text().split())}

    def wait_until_it_records(self):
        """Wait until messages of the bag are on disk."""
        file = self.bag / f"{self.bag.name}_0.mcap"
        wait_for(lambda: holds_messages(file) or self.process.poll() is not None)
        assert self.process.poll() is None, self.ended()

    def ended(self):
        """Wait for the end; return exit status and what it said last."""
        _, said = self.process.communicate(timeout=LIMIT_S)
        return self.process.returncode, said.strip().splitlines()[-1]


def wait_for(condition):
    """Wait for what other processes do, however long it takes; beyond `LIMIT_S` it counts as hung."""
    deadline = time.monotonic() + LIMIT_S
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.02)  # between two looks: files and processes do not say when they change


def holds_messages(file):
    try:
        with open(file, "rb") as stream:
            return any(isinstance(record, Message) for record in StreamReader(stream).records)
    except (OSError, McapError, ZstdError):  # a chunk may be on disk by half
        return False


def common(*series):
    """Return the stamps that all series of a bag have, and their values there."""
    stamps = reduce(np.intersect1d, [each.stamp_ns for each in series])
    return stamps, [each.value[np.searchsorted(each.stamp_ns, stamps)] for each in series]


def alive(pid):
    """Whether a process runs."""
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def _node_name(pid):
    words = Path(f"/proc/{pid}/cmdline").read_bytes().decode().split("\0")
    names = [word.removeprefix("__node:=") for word in words if word.startswith("__node:=")]
    return names[0] if names else "composed"
