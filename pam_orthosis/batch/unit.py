# SPDX-License-Identifier: Apache-2.0
"""One unit of work: a command of this program in a process of its own, here or on another machine.

A process that crashes, hangs or runs out of memory takes nothing with it but its unit. Units are worked off
behind one interface, that of `concurrent.futures.Executor`: on this machine some at a time, or by an existing
Dask scheduler.
"""

import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from pam_orthosis.errors import OrthosisError

ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # units share cores, not work within one
_RUNNING: set[subprocess.Popen[str]] = set()
PATIENCE = "10s"  # until a scheduler has to answer


@dataclass(frozen=True)
class Unit:
    """What is to be done.

    Attributes:
        name: of its folder in the results.
        module: that is run, `python -m`.
        arguments: that it gets.
        writes: it gets `--out FOLDER` too, and the files it leaves there are part of the answer.
        answers: with a JSON object on standard output; exit status 1 is an answer, too ("no").
        seconds: after which it is ended; None: it may take as long as it takes.
        reads: file or folder that the answer is on: if it changes, the answer is out of date.
    """

    name: str
    module: str
    arguments: tuple[str, ...]
    writes: bool = False
    answers: bool = True
    seconds: float | None = None
    reads: Path | None = None

    def identity(self) -> dict[str, Any]:
        """Return what distinguishes this unit's results from those of another, as plain data."""
        return {"module": self.module, "arguments": list(self.arguments)}

    def state(self) -> list[list[Any]]:
        """Return name, size and age of each file that it reads: they differ if it reads something else."""
        if self.reads is None:
            return []
        files = sorted(self.reads.iterdir()) if self.reads.is_dir() else [self.reads]
        return [[one.name, one.stat().st_size, one.stat().st_mtime_ns] for one in files if one.is_file()]


@dataclass(frozen=True)
class Answer:
    """What came of a unit; `complaint` says why there is no answer, and is empty if there is one."""

    status: int
    result: Mapping[str, Any] | None
    complaint: str
    seconds: float
    files: Mapping[str, bytes] = field(default_factory=dict, repr=False)


def work(unit: Unit) -> Answer:
    """Do a unit of work and return what came of it; files come back by value, wherever it was done."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="pam-orthosis-batch-") as folder:
        out = Path(folder, "out")
        command = [sys.executable, "-m", unit.module, *unit.arguments]
        command += ["--out", str(out)] if unit.writes else []
        try:
            done = _run(command, unit.seconds)
        except subprocess.TimeoutExpired:
            return Answer(-1, None, f"not done after {unit.seconds:g} s", time.monotonic() - began)
        result, complaint = _judged(unit, done)
        return Answer(done.returncode, result, complaint, time.monotonic() - began, _files(out))


def end_all() -> None:
    """Kill the processes of all units that this process works on."""
    for process in list(_RUNNING):
        process.kill()


def _run(command: Sequence[str], seconds: float | None) -> subprocess.CompletedProcess[str]:
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True,
        errors="replace", env=ENVIRONMENT | os.environ,
    )  # fmt: skip
    _RUNNING.add(process)
    try:
        result, complained = process.communicate(timeout=seconds)
    except BaseException:
        process.kill()
        process.communicate()
        raise
    finally:
        _RUNNING.discard(process)
    return subprocess.CompletedProcess(command, process.returncode, result, complained)


def _judged(unit: Unit, done: subprocess.CompletedProcess[str]) -> tuple[dict[str, Any] | None, str]:
    """Return the answer, and what is wrong if there is none."""
    if done.returncode not in ((0, 1) if unit.answers else (0,)):
        return None, _last_line(done.stderr) or f"ended with status {done.returncode}"
    if not unit.answers:
        return {}, ""
    try:
        result = json.loads(done.stdout)
    except ValueError:
        result = None
    if not isinstance(result, dict):  # a crash of Python ends with status 1, as "no" does
        return None, _last_line(done.stderr) or "printed no answer"
    return result, ""


def _last_line(text: str) -> str:
    lines = text.strip().splitlines()
    longest_complaint = 500
    return lines[-1].removeprefix("pam-orthosis: error: ")[:longest_complaint] if lines else ""


def _files(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@contextmanager
def local(workers: int) -> Iterator[tuple[Executor, Callable[[], bool]]]:
    """Yield an executor on this machine (a thread waits for each unit's process), and whether it lives."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield pool, lambda: True
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)  # or the next ones would be begun
        end_all()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def cluster(address: str) -> Iterator[tuple[Executor, Callable[[], bool]]]:
    """Yield an executor on the workers of a Dask scheduler, and whether it lives.

    Raises:
        OrthosisError: Dask is not installed, nobody answers at the address, or there are no workers.
    """
    if find_spec("distributed") is None:
        raise OrthosisError("a cluster needs Dask: pip install 'distributed>=2024.1'")
    from distributed import Client

    for name in ("distributed", "tornado", "asyncio"):  # what they say of a lost connection is said below
        logging.getLogger(name).setLevel(logging.CRITICAL)

    def connected() -> Client:
        return Client(address, timeout=PATIENCE, set_as_default=False)

    try:
        try:
            client = connected()
        except AssertionError:  # Dask's own, on a starved machine
            client = connected()
    except (OSError, ValueError, ImportError, AssertionError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise OrthosisError(f"no Dask scheduler at {address}: {reason}") from None
    try:
        if not client.scheduler_info()["workers"]:
            raise OrthosisError(
                f"the Dask scheduler at {address} has no workers: start `dask worker {address}`"
            )
        yield client.get_executor(pure=False), lambda: client.status == "running"
    finally:
        with suppress(Exception):  # there may be nobody left to say goodbye to
            client.close(timeout=1)
