# SPDX-License-Identifier: Apache-2.0
"""Fits in several processes: the same answers, whatever happens to one of them is said, none is left."""

import gc
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from threading import Barrier, BrokenBarrierError

import pytest

from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.errors import OrthosisError

PATIENCE_S = 60.0  # with what goes on for ever, before it fails


class Memory:
    def __init__(self):
        self.known, self.reported = [], 0

    def news(self):
        new, self.reported = self.known[self.reported :], len(self.known)
        return new

    def learn(self, news):
        self.known += news


@pytest.mark.parametrize("jobs", [1, 2, 5])
def test_results_come_in_the_order_of_their_items(jobs):
    reported, items = [], [3, -1, 2, 0]
    found = Workers(jobs).forked(
        lambda x: x * x, items, None, lambda *words: reported.append(words), "fitting"
    )
    assert found == [9, 1, 4, 0]
    assert reported == [("fitting", done, 4) for done in range(5)]
    assert Workers(jobs).map(abs, items) == [3, 1, 2, 0]
    assert Workers(jobs).forked(abs, []) == []


def test_they_are_other_processes_that_fork_no_more_and_what_they_learn_is_kept():
    workers, memory = Workers(2), Memory()
    memory.known, mine = ["before"], os.getpid()

    def work(item):
        memory.known.append(item)
        return os.getpid(), workers.jobs, workers.map(abs, [-1, 2])

    found = workers.forked(work, [1, 2, 3], memory)
    assert len({pid for pid, *_ in found} - {mine}) == 2
    assert all(one[1:] == (1, [1, 2]) for one in found)
    assert memory.known[0] == "before"
    assert sorted(memory.known[1:]) == [1, 2, 3]


def test_cores_that_nothing_is_left_for_help_the_last_one_along():
    workers = Workers(2)

    def at_once():
        both = Barrier(2)  # a thread alone waits in vain
        with suppress(BrokenBarrierError):
            return workers.map(lambda _: both.wait(0.1), [1, 2])

    def work(item):
        end, met = time.monotonic() + PATIENCE_S, None
        while item == 1 and not met and time.monotonic() < end:
            met = at_once()
        return met

    found = workers.forked(work, [1, 2, 3])
    assert found[0]
    assert found[1:] == [None, None]


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_one_raises_is_raised(jobs):
    def work(item):
        if item == 2:
            raise OrthosisError("mine")

    with pytest.raises(OrthosisError, match="mine"):
        Workers(jobs).forked(work, [1, 2, 3])


def test_garbage_of_this_process_is_not_collected_in_others():
    class Loud:
        def __init__(self):
            self.me = self

        def __del__(self):
            if os.getpid() != mine:
                os._exit(1)

    mine = os.getpid()
    gc.disable()
    try:
        Loud()
        assert Workers(2).forked(lambda item: gc.collect() * 0 + item, [1, 2]) == [1, 2]
        assert gc.get_freeze_count() == 0
    finally:
        gc.enable()


def test_one_that_is_killed_is_said():
    with pytest.raises(OrthosisError, match="was killed by SIGKILL; if memory is short, --jobs 1"):
        Workers(2).forked(lambda item: os.kill(os.getpid(), signal.SIGKILL), [1, 2])


def test_what_a_process_that_hangs_leaves_is_done_here(monkeypatch):
    monkeypatch.setattr("pam_orthosis.discrepancy.workers.HUNG_SECONDS", 0.4)
    mine = os.getpid()

    def work(item):
        while item == 2 and os.getpid() != mine:
            signal.pause()
        return item

    assert Workers(2).forked(work, [1, 2, 3]) == [1, 2, 3]


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_they_leave_it_to_the_search_to_end(how):
    def work(item):
        os.kill(os.getpid(), how)
        return item

    assert Workers(2).forked(work, [1, 2]) == [1, 2]


ENDLESS = """
import os, signal, threading
from pam_orthosis.discrepancy.workers import Workers

def work(item):
    os.write(1, b"%d\\n" % os.getpid())
    threading.Event().wait()

signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it
Workers(2).forked(work, [1, 2])
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_none_outlives_the_search(how):
    with subprocess.Popen(
        [sys.executable, "-c", ENDLESS], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        start_new_session=True,
    ) as search:  # fmt: skip
        try:
            pids = [int(search.stdout.readline()) for _ in range(2)]
            os.killpg(search.pid, how) if how == signal.SIGINT else os.kill(search.pid, how)
            _, said = search.communicate(timeout=PATIENCE_S)  # until nobody holds its output
        except subprocess.TimeoutExpired:
            pytest.fail(f"processes of the search go on, {PATIENCE_S} s after it was ended")
        finally:
            with suppress(ProcessLookupError):
                os.killpg(search.pid, signal.SIGKILL)
    assert said.count("KeyboardInterrupt") == (how == signal.SIGINT), said
    assert len(set(pids)) == 2
