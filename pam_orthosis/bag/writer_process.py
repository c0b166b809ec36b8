# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes: who records does not pack, compress and wait for the disk."""

import fcntl
import os
import pickle
import select
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, BinaryIO

from pam_orthosis.bag.information import METADATA_FILE
from pam_orthosis.bag.record import BagWriter, OnDisk
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.files import writing
from pam_orthosis.processes import (
    SILENCE_SECONDS,
    STARVED_SECONDS,
    Idleness,
    deaf_children,
    go_on_without_parent,
    how_it_ended,
    stopped,
)

NAME = "bag_writer"
READY, DONE, HERE, ON_DISK, ERROR = "ready", "done", "here", "on disk", "error"
WAITING_BYTES = 1 << 22  # beside the pipe, before who records has to wait
CUT_SHORT = EOFError, pickle.UnpicklingError  # who sends was killed, perhaps in the midst of something


class BagWriterProcess:
    """Takes messages for a `BagWriter` in a process of its own.

    What that one raises, as OrthosisError, comes with a later call, at the latest with `close`. If it dies,
    is stopped or does not answer, RunFailed comes with the next call, and the bag goes on in another file
    that this process writes: behind what is known to be on the disk, so that nothing is lost. If this
    process is killed the other one writes down what it has got. Both leave the bag unclosed, as a killed
    recorder does. `waiting` is called now and then while this process has to wait for the other one.
    """

    def __init__(self, folder: Path, run: Mapping[str, str], waiting: Callable[[], None] = lambda: None):
        self._folder, self._run, self._waiting = Path(folder).absolute(), dict(run), waiting
        self._answered, answers = Pipe(duplex=False)
        command = [sys.executable, "-m", "pam_orthosis.bag.writer_process", str(answers.fileno())]
        silent: dict[str, Any] = {"stdout": subprocess.DEVNULL, "pass_fds": [answers.fileno()]}
        with writing(folder), deaf_children(), answers:  # it ends with what it is sent
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, bufsize=0, **silent)
        assert self._process.stdin is not None  # it is a pipe
        self._pipe = self._process.stdin
        with suppress(OSError):  # more than the system allows
            two_seconds = 1 << 20  # bytes of a graph at 200 Hz, for which the disk may stand still
            fcntl.fcntl(self._pipe, fcntl.F_SETPIPE_SZ, two_seconds)
        os.set_blocking(self._pipe.fileno(), False)
        self._idleness, self._asked = Idleness(self._process.pid), False
        self._topics: list[tuple[str, str, bool]] = []
        self._unsent = bytearray()
        self._count, self._unconfirmed = 0, deque[tuple[int, bytes]]()  # messages up to there, as sent
        self._on_disk = OnDisk(0, 0, 0)
        self._answers = set[str]()
        self._error: OrthosisError | None = None
        self._here: BagWriter | None = None
        self._say(str(self._folder), self._run)

    def ready(self) -> bool:
        """Return whether the bag is begun."""
        self.look()
        return READY in self._answers

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic (absolute name) of a standard ROS 2 type, once; `latched`: transient local."""
        self._topics.append((topic, msgtype, latched))
        self._say("add_topic", topic, msgtype, latched)

    def write_all(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append messages: topic, stamp, data."""
        if not (batch := [*messages]):
            return
        if self._here:
            self._here.write_all(batch)
        else:
            self._say("write_all", batch, count=len(batch))

    def look(self) -> None:
        """Send what waits and hear what was answered: an OrthosisError from now on always.

        RunFailed, once, if the other process died, was stopped or does not answer.
        """
        if self._here:
            return
        self._send()
        code = self._process.poll()
        self._hear()
        if code is None and stopped(self._process.pid):
            self._lost("was stopped (SIGSTOP)")
        if code is not None and DONE not in self._answers:
            self._lost(how_it_ended(code))
        self._idleness.look()
        if self._idleness.asleep > SILENCE_SECONDS or self._idleness.passed > STARVED_SECONDS:
            self._lost(f"did not answer for {SILENCE_SECONDS:g} s")
        if not self._asked:
            self._asked = True
            self._say(HERE)

    def close(self) -> None:
        """Have the bag finished, and wait until it is; RunFailed if it went on here, unclosed."""
        try:
            if self._here:
                raise self._loss
            self._say("close")
            while DONE not in self._answers:
                self._wait()
            self._process.wait()
        finally:
            if self._here:
                self._here.leave()

    def _say(self, *said: Any, count: int = 0) -> None:
        """Send something, now or together with what follows."""
        if self._error:
            raise self._error
        data = pickle.dumps(said, pickle.HIGHEST_PROTOCOL)
        self._unsent += data
        if count:
            self._count += count
            self._unconfirmed.append((self._count, data))
        if len(self._unsent) >= 1 << 13:
            self._send()
            while len(self._unsent) > WAITING_BYTES:
                self._wait()

    def _send(self) -> None:
        with suppress(BlockingIOError, BrokenPipeError):  # it stands still, or has ended: both are seen
            while self._unsent:
                del self._unsent[: os.write(self._pipe.fileno(), self._unsent)]

    def _wait(self) -> None:
        """Wait a moment for the other process."""
        self.look()
        writable = [self._pipe] if self._unsent else []
        select.select([self._answered], writable, [], 0.05)
        self._waiting()

    def _hear(self) -> None:
        """Take in what was answered."""
        with suppress(EOFError):  # it has ended, which is seen
            while self._answered.poll():
                self._take(*self._answered.recv())
        if self._error:
            raise self._error

    def _take(self, answer: str, *more: Any) -> None:
        self._idleness.begin()
        self._asked = False
        self._answers.add(answer)
        if answer == ERROR:
            self._error = OrthosisError(*more)
        if answer == ON_DISK:
            self._on_disk = OnDisk(*more)
            while self._unconfirmed and self._unconfirmed[0][0] <= self._on_disk.messages:
                self._unconfirmed.popleft()

    def _lost(self, how: str) -> None:
        """Go on here, behind what is known to be on the disk, and say what has happened."""
        self._loss = RunFailed(f"{NAME} {how}")
        self._process.kill()
        self._process.wait()
        self._hear()
        if READY in self._answers and not (self._folder / METADATA_FILE).exists():
            self._go_on_here()
        raise self._loss

    def _go_on_here(self) -> None:
        self._here = BagWriter(self._folder, self._run, behind=self._on_disk)
        for topic in self._topics:
            self._here.add_topic(*topic)
        for up_to, data in self._unconfirmed:
            _, batch = pickle.loads(data)
            self._here.write_all(batch[max(0, self._on_disk.messages - up_to + len(batch)) :])
        self._here.flush()


def serve(source: BinaryIO, answer: Callable[..., None]) -> None:
    """Write the bag of a `BagWriterProcess`; answer `READY`, how much is on the disk and `DONE`, or an error.

    Where nothing comes any more the bag stays unclosed.
    """
    writer, name, known = None, "", None
    try:
        folder, run = pickle.load(source)
        writer = BagWriter(Path(folder), run)
        answer(READY)
        while name != "close":
            if writer.on_disk != known:
                known = writer.on_disk
                answer(ON_DISK, *known)
            name, *arguments = pickle.load(source)
            if name == HERE:
                answer(HERE)
            else:
                getattr(writer, name)(*arguments)
        answer(DONE)
    except OrthosisError as error:
        answer(ERROR, str(error))
    except CUT_SHORT:
        with suppress(OrthosisError):  # nobody is there to hear it
            if writer:
                writer.flush()


def main() -> None:
    """Serve who has started this process, who waits for answers at the descriptor that was given."""
    answers = Connection(int(sys.argv[1]), readable=False)

    def answer(*said: Any) -> None:
        with suppress(BrokenPipeError):
            answers.send(said)

    go_on_without_parent()
    serve(sys.stdin.buffer, answer)


if __name__ == "__main__":
    main()
