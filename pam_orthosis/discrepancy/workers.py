# SPDX-License-Identifier: Apache-2.0
"""Several fits at once, in processes that are forked from this one: each has all that this one knows.

What comes back does not depend on how many there are: each starts from the same state. Cores that the others
leave free, since nothing is left to begin, help the last ones along.
"""

import mmap
import os
import pickle
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from pam_orthosis.errors import OrthosisError
from pam_orthosis.processes import (
    Idleness,
    deaf_children,
    end_with_parent,
    garbage_left_to_parent,
    how_it_ended,
    turns_of_tree,
)
from pam_orthosis.progress import Progress, silent

LOOK_SECONDS = 0.2
HUNG_SECONDS = 120.0  # a process forked beside other threads may inherit a lock that nobody opens

One = TypeVar("One")
Result = TypeVar("Result")
# sums over threads differ in their last bits, and wait for each other
alone = partial(threadpool_limits, 1, "blas")


class Memory(Protocol):
    """What processes learn beside their results, as machine code: it is handed on to the others."""

    def news(self) -> Any:
        """Return what was learned since the last call."""

    def learn(self, news: Any) -> None:
        """Take what another process has learned."""


class Workers:
    """The cores that a search may use.

    Args:
        jobs: how many (those that this process may run on).
    """

    def __init__(self, jobs: int | None = None):
        self.jobs = jobs or cores()
        self._free: Callable[[], int] = lambda: self.jobs
        self._threads: tuple[int, ThreadPoolExecutor] | None = None

    def map(self, function: Callable[[One], Result], items: Iterable[One]) -> list[Result]:
        """Return what a short function gives for each item: in threads, since it leaves the interpreter."""
        count = self._free()
        if count == 1:
            return list(map(function, items))
        if self._threads is None or self._threads[0] < count:
            self._threads = count, ThreadPoolExecutor(count)
        return list(self._threads[1].map(function, items))

    def forked(
        self,
        function: Callable[[One], Result],
        items: Sequence[One],
        memory: Memory | None = None,
        progress: Progress = silent,
        what: str = "fitting",
    ) -> list[Result]:
        """Return what a long function gives for each item, in their order; raises what it raises."""
        found: dict[int, Result] = {}
        progress(what, 0, len(items))
        if min(self.jobs, len(items)) > 1 and "fork" in get_all_start_methods():
            for number, result in self._forked(function, items, memory):
                found[number] = result
                progress(what, len(found), len(items))
        with alone():
            for number in sorted({*range(len(items))} - found.keys()):
                found[number] = function(items[number])
                progress(what, len(found), len(items))
        return [found[number] for number in range(len(items))]

    def _forked(
        self, function: Callable[[One], Result], items: Sequence[One], memory: Memory | None
    ) -> Iterator[tuple[int, Result]]:
        """Yield number and result of items as they come; no more of them if a process hangs."""
        team: list[_Worker] = []
        busy = _Count(min(self.jobs, len(items)))
        try:
            with deaf_children(), garbage_left_to_parent():
                for _ in range(busy.value):
                    begin = partial(self._share, busy)
                    team.append(_Worker(lambda number: function(items[number]), memory, begin))
            yield from _work_off(team, len(items), memory, busy)
        finally:
            for worker in team:
                worker.end()

    def _share(self, busy: "_Count") -> None:
        """Be one of several processes from now on: fork no more, and use what the others leave free."""
        all_cores = self.jobs
        self.jobs, self._threads = 1, None
        self._free = lambda: max(1, all_cores // max(1, busy.value))


def cores() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Count:
    """A small number that forked processes see: one writes it."""

    def __init__(self, value: int):
        self._shared = mmap.mmap(-1, 8)
        self.value = value

    @property
    def value(self) -> int:
        """The number."""
        return int.from_bytes(self._shared[:], "little")

    @value.setter
    def value(self, value: int) -> None:
        self._shared[:] = value.to_bytes(8, "little")


class _Worker:
    """A forked process that answers one number after the other."""

    def __init__(self, function: Callable[[int], Any], memory: Memory | None, begin: Callable[[], None]):
        context = get_context("fork")
        self.connection, other = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_answer, args=(other, function, memory, begin), daemon=True
        )
        self._process.start()
        self._idleness = Idleness(self._process.pid or 0, of=turns_of_tree)
        self._asked = False
        other.close()

    def ask(self, number: int) -> None:
        """Have a number answered."""
        self.connection.send(number)
        self._idleness.begin()
        self._asked = True

    def answer(self) -> Any:
        """Return what was answered, an exception among it."""
        self._asked = False
        try:
            return pickle.loads(self.connection.recv_bytes())
        except EOFError:
            self._process.join()
            ended = how_it_ended(self._process.exitcode or 0)
            raise OrthosisError(
                f"a process of the search {ended}; if memory is short, --jobs 1 needs the least"
            ) from None

    def hangs(self) -> bool:
        """Whether the process was asked, and has done nothing for long."""
        self._idleness.look()
        return self._asked and self._idleness.resting > HUNG_SECONDS

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _answer(
    connection: Connection, function: Callable[[int], Any], memory: Memory | None, begin: Callable[[], None]
) -> None:
    """Answer numbers until nobody asks."""
    end_with_parent()
    begin()
    if memory:
        memory.news()  # what was known before
    with alone():
        while True:
            number = connection.recv()
            try:
                answer: Any = number, function(number), memory.news() if memory else None
            except Exception as error:  # raised again where it is waited for
                answer = error
            connection.send_bytes(_packed(answer))


def _packed(answer: Any) -> bytes:
    try:
        return pickle.dumps(answer, protocol=pickle.HIGHEST_PROTOCOL)
    except Exception as error:  # what cannot be handed on
        return pickle.dumps(RuntimeError(f"{type(answer).__name__}: {answer} ({error})"))


def _work_off(
    team: Sequence[_Worker], count: int, memory: Memory | None, busy: _Count
) -> Iterator[tuple[int, Any]]:
    """Yield numbers and their answers until all are there or a process hangs; who is free gets the next."""
    by_connection: dict[Any, _Worker] = {worker.connection: worker for worker in team}
    rest = iter(range(count))
    for worker in team:
        worker.ask(next(rest))
    answered = 0
    while answered < count:
        ready = wait(list(by_connection), LOOK_SECONDS)
        hung = [worker for worker in team if worker.hangs()]
        if hung and not ready:
            return
        for worker in map(by_connection.__getitem__, ready):
            answer = worker.answer()
            if isinstance(answer, Exception):
                raise answer
            number, result, news = answer
            if memory:
                memory.learn(news)
            answered += 1
            if (following := next(rest, None)) is not None:
                worker.ask(following)
            else:
                busy.value -= 1
            yield number, result
