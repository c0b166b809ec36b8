# SPDX-License-Identifier: Apache-2.0
"""Entry points of the nodes, which take seconds to load: until then too they end without a traceback.

python -m pam_orthosis.nodes.entry NODE ...
"""

import gc
import os
import signal
import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from types import FrameType
from typing import NoReturn

USAGE = """\
usage: {node} [--ros-args [-p NAME:=VALUE] ...]

{what}

Parameters are rows of config/ and the node's own. While it runs these tell which they are:
  ros2 param list /{node}
  ros2 param describe /{node} NAME"""
OF_A_MUSCLE = "pressure_controller"  # each has one of its name
INTERRUPTED = b"pam-orthosis: error: interrupted while it was started\n"


def start(node: str) -> int:
    """Load a node's module and run its `main`, or tell its usage; return the exit status."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))  # as later: it did what it was asked to
    of_a_muscle = node.endswith(f"_{OF_A_MUSCLE}")
    gc.disable()  # what is loaded stays: to look through it meanwhile takes a sixteenth of the start
    module = import_module(f"pam_orthosis.nodes.{OF_A_MUSCLE if of_a_muscle else node}")
    gc.enable()
    if {"-h", "--help"}.intersection(sys.argv[1:]):
        print(USAGE.format(node=node, what=(module.__doc__ or "").partition("\n")[0]))
        return 0
    status: int = module.main(node) if of_a_muscle else module.main()
    return status


def _end(_number: int, _frame: FrameType | None) -> NoReturn:
    if sys.__stderr__:  # none where it was closed
        os.write(sys.__stderr__.fileno(), INTERRUPTED)
    os._exit(3)


def __getattr__(node: str) -> Callable[[], int]:
    """Return the function that starts a node: `entry:position_controller`."""
    if node.startswith("_"):
        raise AttributeError(node)
    return partial(start, node)


if __name__ == "__main__":
    sys.exit(start(sys.argv.pop(1)))
