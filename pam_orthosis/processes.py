# SPDX-License-Identifier: Apache-2.0
"""What the system says of a process: whether somebody has stopped it, how long it has done nothing."""

import ctypes
import gc
import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # what asks a process to end
SILENCE_SECONDS, STARVED_SECONDS = 1.0, 20.0
LEAST_SECONDS = 0.1  # between two looks
MOST_SECONDS = 0.2  # counted of the time between two looks: for the rest the machine stood still
NOISE_SECONDS = 0.05  # of processor time: threads of the middleware use less while nothing happens
PR_SET_PDEATHSIG = 1  # of prctl
ENDED = ("Z", "X", "")  # letters of the scheduler
STATE, GROUP, TIMES = 0, 2, slice(11, 13)  # words of /proc/PID/stat behind the name
TIMES_WITH_CHILDREN = slice(11, 15)


class Turn(NamedTuple):
    """The scheduler's letter for a thread, and processor time, s."""

    state: str
    used: float = 0.0

    @property
    def waits(self) -> bool:
        """Whether the thread wants the processor, or waits for the disk."""
        return self.state in ("R", "D")


Turns = Callable[[int], Iterator[Turn]]


def turns_of_process(pid: int) -> Iterator[Turn]:
    """Yield what the main thread of a process does, and whether others, which may hold its locks, wait."""
    yield _turn(f"{pid}/task/{pid}", TIMES)
    yield from _letters(pid)


def turns_of_tree(pid: int) -> Iterator[Turn]:
    """Yield what all threads of a process and of its descendants do, those that have ended included."""
    yield Turn("", _turn(str(pid), TIMES_WITH_CHILDREN).used)
    yield from _letters(pid)
    for thread in _listed(f"{pid}/task"):
        for child in _read(f"{pid}/task/{thread}/children").split():
            yield from turns_of_tree(int(child))


def turns_of_group(group: int) -> Iterator[Turn]:
    """Yield what the processes of a group do."""
    for entry in filter(str.isdecimal, _listed("")):
        words = _words(entry)
        if words and int(words[GROUP]) == group:
            yield _turn(entry, TIMES)


def running_in_group(group: int) -> bool:
    """Whether a process of a group has not ended; one that nobody has asked for its status yet has."""
    return any(turn.state not in ENDED for turn in turns_of_group(group))


def _letters(pid: int) -> Iterator[Turn]:
    """Yield the letters of all threads of a process."""
    for thread in _listed(f"{pid}/task"):
        yield Turn(_turn(f"{pid}/task/{thread}", TIMES).state)


def _turn(entry: str, times: slice) -> Turn:
    words = _words(entry)
    return Turn(words[STATE], sum(map(int, words[times])) / os.sysconf("SC_CLK_TCK")) if words else Turn("")


def _words(entry: str) -> list[str]:
    return _read(f"{entry}/stat").rpartition(")")[2].split()


def _read(entry: str) -> str:
    try:
        return Path("/proc", entry).read_text()
    except OSError:  # it has ended
        return ""


def _listed(entry: str) -> list[str]:
    try:
        return os.listdir(f"/proc/{entry}")
    except OSError:
        return []


class Idleness:
    """How long a process has done nothing for its part: time in which it waits for its turn is not its own.

    Args:
        pid: of the process, or what `of` takes.
        of: what counts as the process.

    Attributes:
        asleep: time in which it wanted neither the processor nor the disk, s.
        resting: the same since it last worked; what the middleware's threads do now and then is no work.
        used: its processor time, s.
        passed: all time, s.
    """

    def __init__(self, pid: int, of: Turns = turns_of_process):
        self._pid, self._of = pid, of
        self.begin()

    def begin(self) -> None:
        """Count from now on: something was heard of the process."""
        self._looked = time.monotonic()
        self._used_before: float | None = None
        self.asleep = self.resting = self.used = self.passed = self._worked = 0.0

    def look(self) -> None:
        """Count the time since the last look."""
        passed = time.monotonic() - self._looked
        if passed < LEAST_SECONDS:
            return
        self._looked += passed
        turns = list(self._of(self._pid))
        used = sum(each.used for each in turns)
        self._used_before = used if self._used_before is None else self._used_before
        self.used = used - self._used_before
        if self.used > self._worked + NOISE_SECONDS:
            self._worked, self.resting = self.used, 0.0
        passed = min(passed, MOST_SECONDS)
        asleep = 0.0 if any(each.waits for each in turns) else passed
        self.passed += passed
        self.asleep += asleep
        self.resting += asleep

    def silent(self, seconds: float, longest: float = STARVED_SECONDS) -> bool:
        """Whether it had so much time of its own since something was heard, or waits for ever."""
        return self.asleep + self.used > seconds or self.passed > longest


def stopped(pid: int) -> bool:
    """Return whether somebody has stopped (SIGSTOP) a child that was not waited for."""
    # look only: it may be continued; asked about its end as well, since it may end at any moment
    found = os.waitid(os.P_PID, pid, os.WSTOPPED | os.WEXITED | os.WNOHANG | os.WNOWAIT)
    return found is not None and found.si_code == os.CLD_STOPPED


def how_it_ended(code: int) -> str:
    """Return what the exit status of a child says."""
    return f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"


@contextmanager
def deaf_children() -> Iterator[None]:
    """Let processes that are started meanwhile hear nothing that asks them to end."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def garbage_left_to_parent() -> Iterator[None]:
    """Let processes that are forked meanwhile never collect what this one has let go.

    Some of it ends threads that a fork does not copy, as a ROS 2 context's; the process would crash.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()


def go_on_without_parent() -> None:
    """Have this process continued, if somebody has stopped it, when its parent ends: nobody else would."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGCONT)


def end_with_parent() -> None:
    """Have this process killed when its parent ends."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
