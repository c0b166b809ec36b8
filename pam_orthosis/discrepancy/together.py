# SPDX-License-Identifier: Apache-2.0
"""Several fits at once, in processes that are forked from this one: each has all that this one knows.

What comes back does not depend on how many there are: each starts from the same state and has one thread.
"""

import os
import pickle
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from multiprocessing import get_all_start_methods, get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any, Protocol, TypeVar

from threadpoolctl import threadpool_limits

from pam_orthosis.errors import OrthosisError
from pam_orthosis.processes import deaf_children, end_with_parent, how_it_ended
from pam_orthosis.progress import Progress, silent

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
        self._threads: ThreadPoolExecutor | None = None

    def map(self, function: Callable[[One], Result], items: Iterable[One]) -> list[Result]:
        """Return what a short function gives for each item: in threads, since it leaves the interpreter."""
        if self.jobs == 1:
            return list(map(function, items))
        if self._threads is None:
            self._threads = ThreadPoolExecutor(self.jobs)
        return list(self._threads.map(function, items))

    def together(
        self,
        function: Callable[[One], Result],
        items: Sequence[One],
        memory: Memory | None = None,
        progress: Progress = silent,
        what: str = "fitting",
    ) -> list[Result]:
        """Return what a long function gives for each item, in their order; raises what it raises."""
        count = min(self.jobs, len(items))
        progress(what, 0, len(items))
        if count < 2 or "fork" not in get_all_start_methods():
            results = []
            with alone():
                for item in items:
                    results.append(function(item))
                    progress(what, len(results), len(items))
            return results
        team: list[_Worker] = []
        try:
            with deaf_children():
                for _ in range(count):
                    team.append(_Worker(lambda number: function(items[number]), memory, self))
            return _work_off(team, len(items), memory, lambda done: progress(what, done, len(items)))
        finally:
            for worker in team:
                worker.end()

    def alone(self) -> None:
        """Use one core from now on: what is forked has one."""
        self.jobs, self._threads = 1, None


def cores() -> int:
    """Return the number of cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Worker:
    """A forked process that answers one number after the other."""

    def __init__(self, function: Callable[[int], Any], memory: Memory | None, workers: Workers):
        context = get_context("fork")
        self.connection, other = context.Pipe()
        self._process: BaseProcess = context.Process(
            target=_answer, args=(other, function, memory, workers), daemon=True
        )
        self._process.start()
        other.close()

    def answer(self) -> Any:
        """Return what was answered, an exception among it."""
        try:
            return pickle.loads(self.connection.recv_bytes())
        except EOFError:
            self._process.join()
            ended = how_it_ended(self._process.exitcode or 0)
            raise OrthosisError(
                f"a process of the search {ended}; if memory is short, --jobs 1 needs the least"
            ) from None

    def end(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def _answer(
    connection: Connection, function: Callable[[int], Any], memory: Memory | None, workers: Workers
) -> None:
    """Answer numbers until nobody asks."""
    end_with_parent()
    workers.alone()
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
    team: Sequence[_Worker], count: int, memory: Memory | None, progress: Callable[[int], None]
) -> list[Any]:
    """Return the answers to all numbers; whoever is free gets the next one."""
    results: list[Any] = [None] * count
    by_connection: dict[Any, _Worker] = {worker.connection: worker for worker in team}
    rest = iter(range(count))
    for worker in team:
        worker.connection.send(next(rest))
    for done in range(1, count + 1):
        worker = by_connection[wait(list(by_connection))[0]]
        answer = worker.answer()
        if isinstance(answer, Exception):
            raise answer
        number, results[number], news = answer
        if memory:
            memory.learn(news)
        progress(done)
        if (following := next(rest, None)) is not None:
            worker.connection.send(following)
    return results
