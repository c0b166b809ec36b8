# SPDX-License-Identifier: Apache-2.0
"""Python imports this by itself in each process of a run whose PYTHONPATH names this folder.

The environment variable PAM_ORTHOSIS_FAULT says, as JSON, which fault the run has: `node` (or `bag_writer`)
of `leg`, `act`, `after_ns` (of the run's time; nothing: while the node is made) and `notes`, a folder. There
each process leaves its id, each plant the stamp of its last step, and the fault the instant at which it
happened.
"""

import importlib.abc
import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

GRAPH, RECORD = "pam_orthosis.nodes.graph", "pam_orthosis.bag.record"
WRITER = "bag_writer"
PLANT = "plant_simulator"
FAULT = json.loads(os.environ.get("PAM_ORTHOSIS_FAULT", "{}"))


class Faulty(RuntimeError):
    """What a node with a bug raises."""


def _bug() -> None:
    raise Faulty("injected")


def _hang() -> None:
    while True:
        time.sleep(1)


def _to_parent(*numbers: int) -> None:
    for number in numbers:
        os.kill(os.getppid(), number)
        time.sleep(0.05)


def _kill_both() -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    os.kill(os.getpid(), signal.SIGKILL)


def _stop_then_kill() -> None:
    command = ["/bin/sh", "-c", f"sleep 0.3; kill -KILL {os.getpid()}"]
    subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)
    os.kill(os.getpid(), signal.SIGSTOP)


ACTS = {
    "SIGKILL": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "SIGSTOP": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "SIGSTOP, then SIGKILL": _stop_then_kill,
    "exit": lambda: os._exit(0),
    "exception": _bug,
    "hang": _hang,
    "entry script SIGKILL": lambda: _to_parent(signal.SIGKILL),
    "entry script SIGTERM": lambda: _to_parent(signal.SIGTERM),
    "entry script SIGHUP": lambda: _to_parent(signal.SIGHUP),
    "entry script SIGINT, five times": lambda: _to_parent(*[signal.SIGINT] * 5),
    "entry script and recorder SIGKILL": _kill_both,
}


class _Hook(importlib.abc.MetaPathFinder):
    """Changes a module as it is loaded."""

    def __init__(self, module, change):
        self._module, self._change = module, change

    def find_spec(self, name, path, target=None):
        if name != self._module:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def exec_module(module):
            load(module)
            self._change(module)

        spec.loader.exec_module = exec_module
        return spec


def _act(stamp_ns) -> None:
    fault = Path(FAULT["notes"], "fault")
    if not fault.exists():
        fault.write_text(json.dumps({"wall": time.time(), "stamp_ns": stamp_ns}))
        ACTS[FAULT["act"]]()


def _change_nodes(graph) -> None:
    graph_node, after_ns = graph.GraphNode, FAULT["after_ns"]
    made, step_done = graph_node.__init__, graph_node.step_done
    reached = {}

    def here(node):
        return node.role == FAULT["node"] and node.get_namespace().strip("/") in ("", FAULT["leg"])

    def changed_init(self, *arguments, **options):
        made(self, *arguments, **options)
        if here(self) and after_ns is None:
            _act(0)

    def changed_step_done(self, stamp_ns):
        if self.role == PLANT:
            leg = self.get_namespace().strip("/")
            if leg not in reached:
                reached[leg] = os.open(Path(FAULT["notes"], f"reached-{leg}"), os.O_CREAT | os.O_WRONLY)
            os.pwrite(reached[leg], b"%020d" % stamp_ns, 0)
        step_done(self, stamp_ns)
        if here(self) and after_ns is not None and self.time_ns >= after_ns:
            _act(stamp_ns)

    graph_node.__init__, graph_node.step_done = changed_init, changed_step_done


def _change_writer(record) -> None:
    writer = record.BagWriter
    write_all, begun = writer.write_all, []

    def changed_write_all(self, messages):
        messages = list(messages)
        begun.append(messages[0][1])
        write_all(self, messages)
        if messages[-1][1] - begun[0] >= (FAULT["after_ns"] or 0):
            _act(messages[-1][1])

    writer.write_all = changed_write_all


if FAULT:
    Path(FAULT["notes"], f"pid-{os.getpid()}").touch()
    sys.meta_path.insert(0, _Hook(GRAPH, _change_nodes))
    if FAULT["node"] == WRITER and "pam_orthosis.bag.writer_process" in sys.orig_argv:
        sys.meta_path.insert(0, _Hook(RECORD, _change_writer))
