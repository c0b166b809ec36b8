# SPDX-License-Identifier: Apache-2.0
"""Python imports this by itself: a process interrupts itself when it loads the module of INTERRUPT_AT."""

import importlib.abc
import os
import signal
import sys


class _Interruption(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == AT:
            sys.meta_path.remove(self)
            os.kill(os.getpid(), getattr(signal, os.environ.get("INTERRUPT_BY", "SIGINT")))


if AT := os.environ.pop("INTERRUPT_AT", ""):  # what this process starts is not interrupted
    sys.meta_path.insert(0, _Interruption())
