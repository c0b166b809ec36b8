# SPDX-License-Identifier: Apache-2.0
"""Calls of a user's code: what it prints is no answer, and it has to come back."""

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from threading import current_thread, main_thread
from types import FrameType
from typing import NoReturn
from warnings import catch_warnings, simplefilter

LONGEST_SECONDS = 30.0  # of the processor: a busy machine, or one that sleeps, is no endless loop
AGAIN_SECONDS = 1.0  # code in C may swallow what is raised


class Endless(BaseException):
    """A user's code does not come back; no `except Exception` of it keeps this."""


@contextmanager
def called() -> Iterator[None]:
    """Call a user's code; raises `Endless` if it computes for too long."""
    with redirect_stdout(sys.stderr), catch_warnings(), _limited():
        simplefilter("ignore", FutureWarning)  # CasADi's, of functions of numpy that take its symbols
        yield


@contextmanager
def _limited() -> Iterator[None]:
    """Limit what is called, where a signal can: in the main thread."""
    if current_thread() is not main_thread() or not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGVTALRM, _stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, LONGEST_SECONDS, AGAIN_SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before or signal.SIG_DFL)


def _stop(_number: int, _frame: FrameType | None) -> NoReturn:
    raise Endless
