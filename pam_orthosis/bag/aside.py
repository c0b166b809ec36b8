# SPDX-License-Identifier: Apache-2.0
"""A bag that another process writes: who records does not wait for packing, compression and disk."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.errors import OrthosisError

DONE = "done"
CUT_SHORT = EOFError, pickle.UnpicklingError  # who sends was killed, perhaps in the midst of something


class BagWriterAside:
    """Takes messages for a `BagWriter` in a process of its own.

    What that one raises, as OrthosisError, comes with a later call, at the latest with `close`. If this
    process is killed the other one writes down what it has got and leaves the bag unclosed, as a killed
    recorder does.

    Args:
        folder: created if need be; must not hold a bag.
        run: run metadata.
    """

    def __init__(self, folder: Path, run: Mapping[str, str]):
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pam_orthosis.bag.aside"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for this process
        )
        self._error: OrthosisError | None = None
        self._tell(str(Path(folder).absolute()), dict(run))

    def add_topic(self, topic: str, msgtype: str, latched: bool = False) -> None:
        """Declare a topic (absolute name) of a standard ROS 2 type, once; `latched`: transient local."""
        self._tell("add_topic", topic, msgtype, latched)

    def write_all(self, messages: Iterable[tuple[str, int, bytes]]) -> None:
        """Append messages: topic, stamp, data."""
        self._tell("write_all", [*messages])

    def close(self) -> None:
        """Have the bag finished, and wait until it is."""
        self._tell("close")
        with suppress(BrokenPipeError):  # the answer says why
            self._process.stdin.close()
        self._check_answer()

    def _tell(self, *said: Any) -> None:
        """Send something, now or together with what follows."""
        try:
            pickle.dump(said, self._process.stdin, pickle.HIGHEST_PROTOCOL)
        except BrokenPipeError:
            self._check_answer()

    def _check_answer(self) -> None:
        """Wait for the end of the other process; raise what it raised, now and whenever asked again."""
        answer = self._process.stdout.read().decode().strip()
        self._process.wait()
        if answer != DONE:
            died = "the process that writes the bag died"
            self._error = self._error or OrthosisError(answer or died)
            raise self._error


def serve(source: BinaryIO) -> str:
    """Write the bag of a `BagWriterAside`; return what to answer: `DONE`, an error, or nothing to nobody.

    Where nothing comes any more the bag stays unclosed.
    """
    writer, name = None, ""
    try:
        folder, run = pickle.load(source)
        writer = BagWriter(Path(folder), run)
        while name != "close":
            name, *arguments = pickle.load(source)
            getattr(writer, name)(*arguments)
    except OrthosisError as error:
        return str(error)
    except CUT_SHORT:
        with suppress(OrthosisError):  # nobody is there to be told
            if writer:
                writer.flush()
        return ""
    return DONE


if __name__ == "__main__":
    sys.stdout.write(serve(sys.stdin.buffer))
