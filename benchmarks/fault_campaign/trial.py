# SPDX-License-Identifier: Apache-2.0
"""One bad input: the real command on it in a process of its own, and what is judged about that.

A command ends within the limit with an allowed status. If it refuses, it says so in one line that
names the culprit, and leaves its folder as it was: nothing half-written, nothing overwritten. Never a
traceback, a warning of a library, or anything that the input smuggled in.
"""

from __future__ import annotations

import gc
import hashlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

LIMIT_S, PATIENCE_S = 30.0, 300.0  # of processor time, of any time
MEMORY_BYTES = 1 << 30  # of a command and of those that it starts
DENIED_BYTES = 2 << 30  # beyond which a process gets none, lest it takes the machine's
LONGEST_MESSAGE = 1000
PREFIX = "pam-orthosis: error: "
CANARY = "smuggled"  # a file of this name appears if something in an input is executed
REFUSED, JUDGED, ANY = (2,), (0, 1), (0, 1, 2)
CONSOLE = [sys.executable, "-c", "import sys; from pam_orthosis.cli.main import main; sys.exit(main())"]


@dataclass(frozen=True)
class Trial:
    """A command on an input that `make` writes into the trial's own folder.

    Attributes:
        kind: of input, for the table.
        what: the mutation.
        make: writes the input into a folder, returns the arguments of the command.
        allowed: exit statuses.
        names: a refusal names one of these (nothing asked if empty).
        prepare: called in the command's process before it, e.g. to fill the disk.
        updated: name of the file that the command is asked to change, if it succeeds.
    """

    kind: str
    what: str
    make: Callable[[Path], Sequence[str]]
    allowed: tuple[int, ...] = ANY
    names: tuple[str, ...] = ()
    prepare: Callable[[Path], None] | None = None
    updated: str = ""


@dataclass
class Result:
    """What came of a trial.

    Attributes:
        status: of the command's end; None: killed as a hang.
        took_s: processor time, s.
        message: of its refusal.
        memory: most that a process of it had, bytes.
        verb: that was tried.
        faults: what is wrong about it.
    """

    trial: Trial
    status: int | None
    took_s: float
    message: str = ""
    memory: int = 0
    verb: str = ""
    faults: list[str] = field(default_factory=list)


def attempt(trial: Trial, folder: Path, console: bool = False) -> Result:
    """Carry a trial out in an empty folder; `console`: start a new interpreter instead of a fork."""
    arguments = [str(argument) for argument in trial.make(folder)]
    before = _contents(folder)
    with open(folder.with_suffix(".out"), "w+") as out, open(folder.with_suffix(".err"), "w+") as err:
        started = _spawned if console and not trial.prepare else _forked
        status, took_s, memory = _ended(started(trial, arguments, folder, out, err))
        err.seek(0)
        said = err.read()
    for stream in (out, err):
        os.unlink(stream.name)
    result = Result(trial, status, took_s, _message(said), memory, arguments[0] if arguments else "")
    result.faults = list(_faults(result, said, before, _contents(folder)))
    return result


def _faults(result: Result, said: str, before: dict, after: dict):
    trial, status = result.trial, result.status
    if status is None:
        yield f"hangs: no end within {LIMIT_S:g} s of work or {PATIENCE_S:g} s"
    elif status not in trial.allowed:
        yield f"exit status {status}, expected {' or '.join(map(str, trial.allowed))}"
    if result.memory > MEMORY_BYTES or "not enough memory" in said:
        yield f"memory: {result.memory >> 20} MiB, at most {MEMORY_BYTES >> 20}"
    if "Traceback" in said or "error: unforeseen" in said:
        yield "traceback: " + said.strip().splitlines()[-1]
    lines = said.strip().splitlines()
    errors = [line for line in lines if line.startswith(PREFIX)]
    if any("Warning" in line for line in lines):
        yield "a library's warning: " + next(line for line in lines if "Warning" in line)
    if any(name.endswith(CANARY) for name in after):
        yield "executed what stood in the input"
    updated = trial.updated if status == 0 else None
    if any(after.get(name) != content for name, content in before.items() if name != updated):
        yield "an existing file was changed or removed"
    if status == 2:
        yield from _refusal_faults(trial, lines, errors, set(after) - set(before))


def _refusal_faults(trial: Trial, lines: list[str], errors: list[str], new: set[str]):
    if len(errors) != 1 or lines[-1] != errors[0]:
        yield f"not one error line but {len(errors)}, of {len(lines)} lines"
    elif len(errors[0]) > LONGEST_MESSAGE:
        yield f"a message of {len(errors[0])} characters"
    elif trial.names and not any(name in errors[0] for name in trial.names):
        yield f"the message names none of {', '.join(trial.names)}"
    if new:
        yield f"left {', '.join(sorted(new))}"


def _message(said: str) -> str:
    errors = [line for line in said.splitlines() if line.startswith(PREFIX)]
    return errors[-1].removeprefix(PREFIX) if errors else ""


def _contents(folder: Path) -> dict[str, str]:
    """Return relative path -> digest of each file below, and of each folder nothing."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in sorted(folder.rglob("*"))
        if "__pycache__" not in path.parts
    }


def _forked(trial: Trial, arguments: list[str], folder: Path, out, err) -> int:
    """Run the command in a copy of this process, which has everything loaded already; return its id."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return pid
    gc.freeze()  # the parent's garbage may need threads that a fork does not copy
    status = 99
    try:
        os.setsid()
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        sys.stdout, sys.stderr = os.fdopen(1, "w", closefd=False), os.fdopen(2, "w", closefd=False)
        _limit(0)
        os.chdir(folder)
        if trial.prepare:
            trial.prepare(folder)
        status = _main(arguments)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


def _main(arguments: list[str]) -> int:
    """Call the entry script as the interpreter would: what escapes it is shown and ends with 1."""
    from pam_orthosis.cli.main import main

    try:
        return main(arguments)
    except SystemExit as end:
        return end.code or 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
        return 1


def _spawned(trial: Trial, arguments: list[str], folder: Path, out, err) -> int:
    """Start the command in a new interpreter, as the console script does; return its process id."""
    pid = subprocess.Popen([*CONSOLE, *arguments], cwd=folder, stdout=out, stderr=err,
                           start_new_session=True).pid  # fmt: skip
    _limit(pid)
    return pid


def _limit(pid: int) -> None:
    resource.prlimit(pid, resource.RLIMIT_DATA, (DENIED_BYTES, DENIED_BYTES))
    resource.prlimit(pid, resource.RLIMIT_CPU, (round(LIMIT_S), round(LIMIT_S)))


def _ended(pid: int) -> tuple[int | None, float, int]:
    """Wait for a process; return its status, its processor time, s, and its most memory, bytes.

    Processor time decides, so that a busy machine makes nothing a hang. What does not end is killed, its
    session too; its status is None.
    """
    began, pause = time.monotonic(), 0.002
    while time.monotonic() - began < PATIENCE_S:
        done, status, used = os.wait4(pid, os.WNOHANG)
        if done:
            code = os.waitstatus_to_exitcode(status)
            return None if code in (-signal.SIGXCPU, -signal.SIGKILL) else code, *_spent(used)
        time.sleep(pause)
        pause = min(2 * pause, 0.05)
    os.killpg(pid, signal.SIGKILL)
    return None, *_spent(os.wait4(pid, 0)[2])


def _spent(used: resource.struct_rusage) -> tuple[float, int]:
    return used.ru_utime + used.ru_stime, used.ru_maxrss * 1024
