# SPDX-License-Identifier: Apache-2.0
"""Watch the processes of a run: all of them end well, or the run stops and names the culprit."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from pam_orthosis.bag.topics import RECORDER
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes.launch import COMPOSED, PLAYER
from pam_orthosis.processes import (
    SILENCE_SECONDS,
    Idleness,
    how_it_ended,
    running_in_group,
    stopped,
    turns_of_group,
    turns_of_tree,
)

HEARTBEAT_VARIABLE = "PAM_ORTHOSIS_HEARTBEAT"
ERROR_PREFIX = "pam-orthosis: error: "
NOTE_PREFIX = "pam-orthosis: note: "
INFO_PREFIX = "[INFO] "  # of ROS
OVER = ("ended", "closed")
POLL_SECONDS = 0.02
HEARTBEAT_SECONDS = 0.1
# of processor time, or in beats, without being one peer nearer to the start
START_SECONDS = 60.0
IDLE_START_SECONDS = 5.0
STOP_GRACE_SECONDS = 10.0


class Child:
    """A process of the run, and what its heartbeat says last (`process.Heartbeat`), at first nothing.

    Time in which the process waits for its turn on a busy machine is not held against it.
    """

    def __init__(self, name: str, command: Sequence[str], environment: Mapping[str, str], log: Path):
        self.name = name
        self.status = ""
        self.let_go = False
        self.log = log
        self._pipe, inherited = os.pipe()
        os.set_blocking(self._pipe, False)
        self._beats = 0  # of the same status
        with open(log, "wb") as output:
            self.process = subprocess.Popen(
                command,
                env={**environment, HEARTBEAT_VARIABLE: str(inherited)},
                pass_fds=[inherited],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        os.close(inherited)
        self._idleness = Idleness(self.process.pid, of=turns_of_tree)

    @property
    def time_ns(self) -> int:
        """How far the run is, as the process sees it."""
        return int(self.status.split()[1]) if self.status.startswith("running") else 0

    @property
    def waited(self) -> float:
        """How long it has been at the same point of its start, by what it did meanwhile, s."""
        return self._beats * HEARTBEAT_SECONDS if self.status else self._idleness.used

    def starting(self) -> bool:
        """Whether the process is not yet ready."""
        return not self.status or self.status.startswith("starting")

    def listen(self) -> None:
        """Take in the heartbeats that have come."""
        try:
            lines = os.read(self._pipe, 65536).decode().splitlines()
        except BlockingIOError:
            lines = []
        if not lines:
            self._idleness.look()
            return
        if not self.status:
            self._idleness = Idleness(self.process.pid)
        self._beats = self._beats + len(lines) if lines[-1] == self.status else 0
        self.status = lines[-1]
        self._idleness.begin()

    def expected(self) -> None:
        """Note that the graph is stepping: from now on this process must beat, even if it never did."""
        if not self.status:
            self.status, self._idleness = "starting", Idleness(self.process.pid)

    def stopped(self) -> bool:
        """Whether somebody has stopped the process (SIGSTOP), at whatever stage it was."""
        return self.process.returncode is None and stopped(self.process.pid)

    def silent(self) -> bool:
        """Whether the process has begun to beat, or should have, and does not.

        When it has said that its run is over, it may take longer to take itself apart.
        """
        limit = STOP_GRACE_SECONDS if self.status in (*OVER, "leaving") else SILENCE_SECONDS
        return bool(self.status) and self._idleness.silent(limit)

    def idle(self) -> bool:
        """Whether the process has never beaten, and has done nothing for long: it will not come up."""
        return not self.status and self._idleness.resting > IDLE_START_SECONDS

    def has_nothing_to_lose(self) -> bool:
        """Whether the process has said that its run is over, and that its bag is closed if it writes one."""
        return self.status == "closed" or (self.status == "ended" and not self.records)

    @property
    def records(self) -> bool:
        """Whether the process writes a bag; a leg among several does not: their recorder stands outside."""
        return self.name in (RECORDER, COMPOSED, PLAYER)

    def stop(self) -> None:
        """Ask the process to end; one that cannot hear is killed."""
        if self.process.poll() is None:
            deaf = self.silent() or self.idle() or self.stopped()
            self.process.send_signal(signal.SIGKILL if deaf else signal.SIGTERM)

    def last_words(self) -> str:
        """Return the error that the process reported, or else the last line that it printed."""
        lines = [line for line in self.log.read_text(errors="replace").splitlines() if line.strip()]
        reported = [line for line in lines if line.startswith(ERROR_PREFIX)]
        others = [line for line in lines if not line.startswith((NOTE_PREFIX, INFO_PREFIX))]
        return (reported or others or [""])[-1].removeprefix(ERROR_PREFIX)

    def end_helpers(self, seconds: float) -> None:
        """Wait for what the process has started, which is in its group, to end; after so long by force."""
        with suppress(ProcessLookupError):  # there is nothing more
            for number in (0, signal.SIGKILL):
                idleness = Idleness(self.process.pid, of=turns_of_group)
                while running_in_group(self.process.pid) and not idleness.silent(seconds):
                    os.killpg(self.process.pid, number)
                    time.sleep(POLL_SECONDS / 4)
                    idleness.look()

    def release(self) -> None:
        """Close the pipe."""
        os.close(self._pipe)


def supervise(
    commands: Mapping[str, Sequence[str]],
    environment: Mapping[str, str],
    logs: Path,
    progress: Callable[[int], None],
) -> None:
    """Run processes until all have ended well; RunFailed, when all are stopped, if one did not.

    Args:
        commands: name -> command line.
        environment: of all processes.
        logs: folder for what they print.
        progress: called now and then with the simulated time in ns.
    """
    children: list[Child] = []
    try:
        for name, command in commands.items():
            children.append(Child(name, command, environment, logs / f"{name.replace('/', '_')}.log"))
        _watch(children, progress)
    except KeyboardInterrupt:
        raise RunFailed("interrupted") from None
    finally:
        try:
            _stop(children)
        except KeyboardInterrupt:  # the first; others are not heard while it is dealt with
            _stop(children)
            raise
        finally:
            for child in children:
                child.release()


def _watch(children: Sequence[Child], progress: Callable[[int], None]) -> None:
    while any(child.process.poll() is None for child in children):
        time.sleep(POLL_SECONDS)
        for child in children:
            child.listen()
            _judge(child)
        _judge_start(children)
        reached = max(child.time_ns for child in children)
        if reached > 0:
            for child in children:
                child.expected()
        progress(reached)
    for child in children:  # one may have ended between its last judgement and the loop's condition
        _judge(child)


def _judge_start(children: Sequence[Child]) -> None:
    """Raise RunFailed if the start makes no progress: those that wait may wait for those that still load."""
    late = [child for child in children if child.starting()]
    loading = [child.waited for child in late if not child.status]
    waited = max(loading) if loading else min((child.waited for child in late), default=0.0)
    if waited > START_SECONDS:
        raise RunFailed(f"not ready after {START_SECONDS:g} s: {', '.join(child.name for child in late)}")


def _judge(child: Child) -> None:
    code = child.process.poll()
    if child.let_go:
        return
    if code is None:
        _judge_running(child)
    else:
        child.listen()  # its last words may have come since
        if code != 0 or child.status not in OVER:
            _judge_end(child, code)


def _judge_end(child: Child, code: int) -> None:
    """Let go who was killed while it was taken apart; raise RunFailed for anybody else."""
    how = how_it_ended(code) if code else "ended before the run"
    if code > 0 or not child.has_nothing_to_lose():
        raise RunFailed(f"node {child.name} {how}{_quoted(child.last_words())}")
    child.let_go = True
    print(f"{NOTE_PREFIX}node {child.name} {how} when its run was over", file=sys.stderr)


def _judge_running(child: Child) -> None:
    if child.status == "refused":
        raise RunFailed(f"node {child.name} refused to go on{_quoted(child.last_words())}")
    if child.stopped():
        raise RunFailed(f"node {child.name} was stopped (SIGSTOP)")
    if child.silent():
        if not child.has_nothing_to_lose():
            raise RunFailed(f"node {child.name} did not answer for {SILENCE_SECONDS:g} s")
        child.let_go = True  # now and then the middleware never comes back from its own end
        child.process.kill()
    elif child.idle():
        raise RunFailed(f"node {child.name} hung while it was started, for {IDLE_START_SECONDS:g} s")


def _quoted(words: str) -> str:
    return f": {words}" if words else ""


def _stop(children: Sequence[Child]) -> None:
    """End what still runs, politely and the recorder last, so that its bag holds what the others did."""
    recorders = [child for child in children if child.name == RECORDER]
    _end([child for child in children if child not in recorders])
    for recorder in recorders:
        recorder.listen()
    _end(recorders)


def _end(children: Sequence[Child]) -> None:
    """End processes; by force those that have had so much time of their own."""
    for child in children:
        child.stop()
    left = {child: Idleness(child.process.pid) for child in children if child.process.poll() is None}
    while left:
        time.sleep(POLL_SECONDS)
        for child, idleness in list(left.items()):
            idleness.look()
            seconds = 5.0 if child.records else 0.6  # a recorder that answers is not robbed of its data
            if child.process.poll() is None and idleness.silent(seconds, longest=3 * seconds):
                child.process.kill()
                child.process.wait()
            if child.process.poll() is not None:
                del left[child]
    for child in children:
        child.end_helpers(1.0)  # in which they write down what they got
