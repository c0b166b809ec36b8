# SPDX-License-Identifier: Apache-2.0
"""Works off units: failures are tried again and listed, what is done is kept and not done again."""

import json
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, wait
from pathlib import Path
from typing import Any

from pam_orthosis.batch.unit import Answer, Unit, work
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import (
    Write,
    as_bytes,
    as_text,
    locked,
    refuse_used,
    status,
    write_files,
    write_folder,
)
from pam_orthosis.reading import from_json, read_text
from pam_orthosis.results import REMAKE, as_written, digest, refuse_foreign, write_results

RESULT, SUMMARY, PAGE = "result.json", "batch.json", "batch.html"


class Batch:
    """Units and the folder of their results: a folder a unit, and a summary.

    Args:
        units: of different names.
        folder: may hold the results of an earlier batch. What a result lists as its files is replaced if the
            unit is done again; nothing else is.
        overwrite: whether a summary with further units is replaced too.

    Raises:
        OrthosisError: the folder holds something else.
    """

    def __init__(self, units: Sequence[Unit], folder: Path, overwrite: bool = False):
        self.units, self.folder = tuple(units), folder
        refuse_foreign(folder, (SUMMARY, PAGE), True, {*(unit.name for unit in units), *_results(folder)})
        others = _summarised(folder) - {unit.name for unit in units}
        if others and not overwrite:
            more = f"{min(others)} and {len(others) - 1} more" if len(others) > 1 else min(others)
            raise OrthosisError(
                f"{folder / PAGE} exists, with {more}: give these too, choose another --out{REMAKE}"
            )
        self._states = {unit.name: unit.state() for unit in units}
        self.results = {unit.name: one for unit in units if (one := self._finished(unit)) is not None}
        self.failed: dict[str, dict[str, Any]] = {}
        self.skipped = tuple(self.results)

    def run(
        self,
        executor: Executor,
        lives: Callable[[], bool],
        retries: int,
        show: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Work off what is missing; the results are stored one by one, as soon as they are there.

        Args:
            lives: whether the executor can still be waited for.
            retries: how often a unit that fails is tried again.
            show: gets a line on each unit.

        Raises:
            OrthosisError: the executor is gone, or the results cannot be written.
        """
        with locked(self.folder):
            try:
                self._run(executor, lives, retries, show)
            except OrthosisError as error:
                if not self.results:
                    raise
                done = f"{len(self.results)} of {len(self.units)} results are kept in {self.folder}"
                raise OrthosisError(f"{error}; {done}") from error

    def _run(
        self, executor: Executor, lives: Callable[[], bool], retries: int, show: Callable[[str], None]
    ) -> None:
        tries = {unit.name: 0 for unit in self.units if unit.name not in self.results}
        waiting = {executor.submit(work, unit): unit for unit in self.units if unit.name in tries}
        try:
            for future in _as_done(waiting, lives):
                unit, answer = waiting.pop(future), _answer(future)
                tries[unit.name] += 1
                if not answer.complaint:
                    self._keep(unit, answer, tries[unit.name])
                elif tries[unit.name] <= retries:
                    waiting[executor.submit(work, unit)] = unit
                else:
                    self.failed[unit.name] = {"tries": tries[unit.name], "why": answer.complaint}
                show(self._line(unit, answer, tries[unit.name]))
        finally:
            for future in waiting:
                future.cancel()
            self.write(SUMMARY, as_text(json.dumps(self.summary(), indent=2) + "\n"))

    def write(self, name: str, write: Write) -> None:
        """Write the summary or its page, again if they are there."""
        write_results(self.folder, {name: write}, overwrite=True)

    @property
    def done(self) -> int:
        """Number of units that need no more work."""
        return len(self.results) + len(self.failed)

    def summary(self) -> dict[str, Any]:
        """Return what came of all units, as plain data: yes, no, failed (with the reason), missing."""
        names = [unit.name for unit in self.units]
        return {
            "yes": [name for name in names if self.results.get(name, {}).get("status") == 0],
            "no": [name for name in names if self.results.get(name, {}).get("status") == 1],
            "failed": self.failed,
            "missing": [name for name in names if name not in self.results and name not in self.failed],
        }

    def _finished(self, unit: Unit) -> dict[str, Any] | None:
        result = self._earlier(unit)
        return result if result and result.get("read", []) == self._states[unit.name] else None

    def _earlier(self, unit: Unit) -> dict[str, Any]:
        """Return the result that is there already, be what the unit reads as it was then or not."""
        home = self.folder / unit.name
        if not (home / RESULT).exists():
            if status(home):
                refuse_used(home)
            return {}
        result = _object(home / RESULT)
        if {key: result.get(key) for key in unit.identity()} != unit.identity():
            raise OrthosisError(f"{home / RESULT} is the result of another command: give another --out")
        return result

    def _keep(self, unit: Unit, answer: Answer, tries: int) -> None:
        """Store an answer; the result's file, which says that the unit is done, comes last."""
        home = self.folder / unit.name
        files = {name: as_bytes(data) for name, data in answer.files.items()}
        earlier = self._earlier(unit)
        result = {
            "name": unit.name, **unit.identity(), "read": self._states[unit.name], "status": answer.status,
            "tries": tries, "seconds": round(answer.seconds, 2), "answer": answer.result,
            "files": {name: digest(data) for name, data in sorted(answer.files.items())},
        }  # fmt: skip
        files[RESULT] = as_text(json.dumps(result, indent=2) + "\n")
        if earlier:
            ours = {
                home / RESULT,
                *(home / name for name, one in earlier["files"].items() if as_written(home / name, one)),
            }
            write_files({home / name: write for name, write in files.items()}, ours)
        else:
            write_folder(home, files)
        self.results[unit.name] = result

    def _line(self, unit: Unit, answer: Answer, tries: int) -> str:
        outcome = (
            {0: "yes", 1: "no"}[answer.status] if not answer.complaint else f"failed: {answer.complaint}"
        )
        again = ", is tried again" if answer.complaint and unit.name not in self.failed else ""
        line = f"{unit.name}: {outcome} ({answer.seconds:.1f} s, try {tries}{again})"
        return f"{self.done}/{len(self.units)} {line}"


def _summarised(folder: Path) -> set[str]:
    """Return the names in the summary of an earlier batch."""
    earlier = _object(folder / SUMMARY) if (folder / SUMMARY).exists() else {}
    return {str(name) for names in earlier.values() if isinstance(names, (list, dict)) for name in names}


def _results(folder: Path) -> set[str]:
    """Return the names of the folders that hold results."""
    return {one.parent.name for one in folder.glob(f"*/{RESULT}")}


def _as_done(waiting: dict[Future[Answer], Unit], lives: Callable[[], bool]) -> Iterator[Future[Answer]]:
    """Yield futures as they are done; more may be added to `waiting` meanwhile."""
    look_seconds = 1.0  # how often it is looked whether the executor still lives
    while waiting:
        done, _ = wait(waiting, timeout=look_seconds, return_when=FIRST_COMPLETED)
        if not lives() or any(future.cancelled() for future in done):
            raise OrthosisError(
                "the connection to the cluster is lost; the same command again does what is missing"
            )
        yield from done


def _answer(future: Future[Answer]) -> Answer:
    """Return the answer of a unit that is done; one that took its worker with it has failed."""
    try:
        return future.result()
    except (Exception, CancelledError) as error:
        return Answer(-1, None, f"{type(error).__name__}: {error}".splitlines()[0], 0.0)


def _object(file: Path) -> dict[str, Any]:
    """Return the JSON object in a file; empty if it holds none."""
    try:
        result = from_json(read_text(file), str(file))
    except OrthosisError:
        return {}
    return result if isinstance(result, dict) else {}
