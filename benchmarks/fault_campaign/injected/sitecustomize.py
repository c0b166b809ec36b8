# SPDX-License-Identifier: Apache-2.0
"""Python imports this by itself in each process of a run whose PYTHONPATH names this folder.

The environment variable PAM_ORTHOSIS_FAULT says, as JSON, which fault the run has: `node`, `act`,
`after_ns` (of the run's time; nothing: while the node is made) and `notes`, a folder. There each process
leaves its id, the plant the stamp of its last step, and the fault the instant at which it happened.
"""

import importlib.abc
import importlib.util
import json
import os
import signal
import sys
import time
from pathlib import Path

GRAPH = "pam_orthosis.nodes.graph"
PLANT = "plant_simulator"
FAULT = json.loads(os.environ.get("PAM_ORTHOSIS_FAULT", "{}"))


class Faulty(RuntimeError):
    """What a node with a bug raises."""


def _bug() -> None:
    raise Faulty("injected")


def _hang() -> None:
    while True:
        time.sleep(1)


def _kill_both() -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    os.kill(os.getpid(), signal.SIGKILL)


ACTS = {
    "SIGKILL": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "SIGSTOP": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "exit": lambda: os._exit(0),
    "exception": _bug,
    "hang": _hang,
    "entry script SIGKILL": lambda: os.kill(os.getppid(), signal.SIGKILL),
    "entry script and recorder SIGKILL": _kill_both,
}


class _Hook(importlib.abc.MetaPathFinder):
    """Changes the module of the graph as it is loaded."""

    def find_spec(self, name, path, target=None):
        if name != GRAPH:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(name)
        load = spec.loader.exec_module

        def exec_module(module):
            load(module)
            _change(module.GraphNode)

        spec.loader.exec_module = exec_module
        return spec


def _change(graph_node) -> None:
    notes, after_ns = Path(FAULT["notes"]), FAULT["after_ns"]
    (notes / f"pid-{os.getpid()}").touch()
    reached = os.open(notes / "reached", os.O_CREAT | os.O_WRONLY)
    made, step_done, over = graph_node.__init__, graph_node.step_done, []

    def act(stamp_ns) -> None:
        if not over:
            over.append(True)
            (notes / "fault").write_text(json.dumps({"wall": time.time(), "stamp_ns": stamp_ns}))
            ACTS[FAULT["act"]]()

    def changed_init(self, *arguments, **options):
        made(self, *arguments, **options)
        if self.role == FAULT["node"] and after_ns is None:
            act(0)

    def changed_step_done(self, stamp_ns):
        if self.role == PLANT:
            os.pwrite(reached, b"%020d" % stamp_ns, 0)
        step_done(self, stamp_ns)
        if self.role == FAULT["node"] and after_ns is not None and self.time_ns >= after_ns:
            act(stamp_ns)

    graph_node.__init__, graph_node.step_done = changed_init, changed_step_done


if FAULT:
    sys.meta_path.insert(0, _Hook())
