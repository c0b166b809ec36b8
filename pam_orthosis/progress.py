# SPDX-License-Identifier: Apache-2.0
"""How far work is: what is done, how much of how much, about how long still.

Libraries take a `Progress` and call it for each unit of their work; they never print. A verb opens `shown`,
which prints on stderr: on a terminal one line that is rewritten, otherwise a line now and then. A thread
prints, so that a long import, a compilation or a call into C is not silent either.
"""

import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from threading import Event, Lock, Thread
from typing import Protocol, TypeVar

PERIOD = 2.0  # s of silence at most; shorter work prints nothing
WIDEST = 79  # characters of the line on a terminal, lest it wraps
OFF = "PAM_ORTHOSIS_NO_PROGRESS"  # for scripts that read stderr
BEGIN_OF_LINE = "\r\x1b[K"

Item = TypeVar("Item")


class Progress(Protocol):
    """What work calls when it begins a unit: what, how much is done, of how much (0: unknown), its unit."""

    def __call__(self, what: str, done: float = 0.0, of: float = 0.0, unit: str = "", /) -> None:
        """Take it."""


def silent(what: str, done: float = 0.0, of: float = 0.0, unit: str = "") -> None:
    """Do nothing: the progress of work that nobody watches."""


def counted(items: Sequence[Item], progress: Progress, what: str) -> Iterator[Item]:
    """Yield items one by one, each with its progress before it is worked on."""
    for number, item in enumerate(items):
        progress(what, number, len(items))
        yield item


def part(progress: Progress, what: str, at: float, size: float, of: float, unit: str = "") -> Progress:
    """Return the progress of a part of known size of some work, which begins when `at` is done."""

    def inner_progress(inner: str, done: float = 0.0, amount: float = 0.0, _unit: str = "") -> None:
        if amount:
            progress(what, at + size * done / amount, of, unit)
        else:
            progress(f"{what}, {inner}", at, of, unit)

    return inner_progress


class Watch:
    """What is known of the work as a line: what, how far, and how long still by what is done."""

    def __init__(self, what: str, now: Callable[[], float] = time.monotonic):
        self._now, self._lock = now, Lock()
        self._start = self._since = self._last = now()
        self._what, self._first, self._done, self._of, self._unit = what, 0.0, 0.0, 0.0, ""

    def __call__(self, what: str, done: float = 0.0, of: float = 0.0, unit: str = "") -> None:
        """Take what is worked on: a `Progress`, of any thread."""
        with self._lock:
            self._last = self._now()
            if (of, unit) != (self._of, self._unit) or done < self._done:  # another amount of work
                self._first, self._since = done, self._last
            self._what, self._done, self._of, self._unit = what, done, of, unit

    def line(self) -> str:
        """Return the state of the work."""
        least_left = 1.0  # s: an estimate below it, or one that is over, is none
        with self._lock:
            left = self._left()
            if left >= least_left:
                return f"{self._what}{self._amount()}, about {_rounded(left)} left"
            return f"{self._what}{self._amount()}, {self._now() - self._start:.0f} s so far"

    def _amount(self) -> str:
        if not self._of:
            return ""
        digits = 1 if self._unit else 0
        return f": {int(self._done * 10**digits) / 10**digits:g} of {self._of:.{digits}f}{self._unit}"

    def _left(self) -> float:
        """Return the estimate of the seconds until the amount is done; 0 where there is none."""
        if not self._done > self._first:
            return 0.0
        pace = (self._last - self._since) / (self._done - self._first)
        return pace * (self._of - self._done) - (self._now() - self._last)


def _rounded(seconds: float) -> str:
    minutes = 120.0  # s from which minutes are shown
    return f"{seconds:.0f} s" if seconds < minutes else f"{seconds / 60:.0f} min"


class Shown(Watch):
    """A watch whose line is printed on stderr until the work is over."""

    def __init__(self, what: str):
        super().__init__(what)
        self._printing, self._visible = Lock(), False

    def note(self, text: str) -> None:
        """Print a line that stays."""
        with self._printing:
            self._clear()
            print(text, file=sys.stderr, flush=True)

    def show(self) -> None:
        """Print the state of the work."""
        line = self.line()
        with self._printing:
            if sys.stderr.isatty():
                self._visible = True
                print(BEGIN_OF_LINE + line[:WIDEST], end="", file=sys.stderr, flush=True)
            else:
                print(line, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave nothing on a terminal that is no result."""
        with self._printing, suppress(OSError, ValueError):
            self._clear()

    def _clear(self) -> None:
        if self._visible:
            self._visible = False
            print(BEGIN_OF_LINE, end="", file=sys.stderr, flush=True)


@contextmanager
def shown(what: str) -> Iterator[Shown]:
    """Yield a progress that is printed every `PERIOD` until the block is left."""
    watch, over = Shown(what), Event()

    def print_on() -> None:
        with suppress(OSError, ValueError):  # nobody reads it, or stderr is closed
            while not over.wait(PERIOD):
                watch.show()

    printer = Thread(target=print_on, name="progress", daemon=True)
    if not os.environ.get(OFF):
        printer.start()
    try:
        yield watch
    finally:
        over.set()
        if printer.ident:
            printer.join()
        watch.end()
