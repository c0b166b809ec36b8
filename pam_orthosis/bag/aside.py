# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes: who records does not pack, compress and wait for the disk."""

from __future__ import annotations

import fcntl
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.errors import OrthosisError
from pam_orthosis.files import told

MARK = "pam-orthosis bag: "  # before each answer: something else may print too
READY, DONE = "ready", "done"
PIPE_BYTES = 1 << 20  # two seconds of a graph at 200 Hz, for which the disk may stand still
CUT_SHORT = EOFError, pickle.UnpicklingError  # who sends was killed, perhaps in the midst of something


class BagWriterAside:
    """Takes messages for a `BagWriter` in a process of its own.

    What that one raises, as OrthosisError, comes with a later call, at the latest with `close`. If this
    process is killed the other one writes down what it has got and leaves the bag unclosed, as a killed
    recorder does.

    Args:
        folder: created if need be; must not hold a bag.
        run: run metadata.

    Raises:
        OrthosisError: the system starts no process.
    """

    def __init__(self, folder: Path, run: Mapping[str, str]):
        command = [sys.executable, "-m", "pam_orthosis.bag.aside"]
        with told(folder):
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        with suppress(OSError):  # more than the system allows
            fcntl.fcntl(self._process.stdin, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        self._said = b""
        self._tell(str(Path(folder).absolute()), dict(run))

    def ready(self) -> bool:
        """Return whether the bag is begun."""
        self._flush()
        return READY in self._answers()

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic (absolute name) of a standard ROS 2 type, once; `latched`: transient local."""
        self._tell("add_topic", topic, msgtype, latched)

    def write_all(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append messages: topic, stamp, data."""
        if batch := [*messages]:
            self._tell("write_all", batch)

    def close(self) -> None:
        """Have the bag finished, and wait until it is."""
        self._tell("close")
        self._flush()
        self._answers(to_the_end=True)
        self._process.wait()

    def _flush(self) -> None:
        with suppress(BrokenPipeError):  # the answer says why
            self._process.stdin.flush()

    def _tell(self, *said: Any) -> None:
        """Send something, now or together with what follows."""
        try:
            pickle.dump(said, self._process.stdin, pickle.HIGHEST_PROTOCOL)
        except BrokenPipeError:
            self._answers(to_the_end=True)

    def _answers(self, to_the_end: bool = False) -> list[str]:
        """Return what has been answered; OrthosisError if that is an error, or no more can come."""
        os.set_blocking(self._process.stdout.fileno(), to_the_end)
        more = self._process.stdout.read()  # None if nothing is there yet
        self._said += more or b""
        lines = self._said.decode("utf-8", "surrogateescape").splitlines()
        answers = [line.removeprefix(MARK) for line in lines if line.startswith(MARK)]
        for error in set(answers) - {READY, DONE}:
            raise OrthosisError(error)
        if (to_the_end or more == b"") and DONE not in answers:
            raise OrthosisError("the process that writes the bag died")
        return answers


def serve(source: BinaryIO, answer: Callable[[str], None]) -> None:
    """Write the bag of a `BagWriterAside`; answer `READY` and `DONE`, or an error.

    Where nothing comes any more the bag stays unclosed.
    """
    writer, name = None, ""
    try:
        folder, run = pickle.load(source)
        writer = BagWriter(Path(folder), run)
        answer(READY)
        while name != "close":
            name, *arguments = pickle.load(source)
            getattr(writer, name)(*arguments)
        answer(DONE)
    except OrthosisError as error:
        answer(str(error))
    except CUT_SHORT:
        with suppress(OrthosisError):  # nobody is there to be told
            if writer:
                writer.flush()


def _print(answer: str) -> None:
    with suppress(BrokenPipeError):
        os.write(1, f"{MARK}{answer}\n".encode("utf-8", "surrogateescape"))


if __name__ == "__main__":
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # it ends with what it is sent
        signal.signal(number, signal.SIG_IGN)
    serve(sys.stdin.buffer, _print)
