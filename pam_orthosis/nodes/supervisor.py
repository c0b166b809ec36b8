# SPDX-License-Identifier: Apache-2.0
"""Watch the processes of a run: all of them end well, or the run stops and names the culprit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from pam_orthosis.bag.topics import NODES, RECORDER
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes.launch import COMPOSED

HEARTBEAT_VARIABLE = "PAM_ORTHOSIS_HEARTBEAT"
ERROR_PREFIX = "pam-orthosis: error: "
NOTE_PREFIX = "pam-orthosis: note: "
INFO_PREFIX = "[INFO] "  # of ROS
POLL_SECONDS = 0.02
LOOK_SECONDS = 0.2  # no look counts for more: if none came for longer, the machine stood still
SILENCE_SECONDS, STARVED_SECONDS = 1.2, 20.0
START_SECONDS, IDLE_START_SECONDS = 60.0, 5.0
STOP_SECONDS, RECORDER_STOP_SECONDS = 0.6, 5.0  # a recorder that answers is not robbed of its data
STOP_GRACE_SECONDS = 10.0
HELPER_SECONDS = 1.0  # for what a node has started to write down what it got


class Child:
    """A process of the run, and what its heartbeat says last (`graph.Heartbeat`)."""

    def __init__(self, name: str, command: Sequence[str], environment: Mapping[str, str], log: Path):
        self.name = name
        self.status = ""
        self.let_go = False
        self.log = log
        self._pipe, inherited = os.pipe()
        os.set_blocking(self._pipe, False)
        self._looked, self._silence, self._used = time.monotonic(), 0.0, 0.0
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

    @property
    def time_ns(self) -> int:
        """How far the run is, as the process sees it."""
        return int(self.status.split()[1]) if self.status.startswith("running") else 0

    def listen(self) -> None:
        """Take in the heartbeats that have come."""
        now = time.monotonic()
        self._silence += min(now - self._looked, LOOK_SECONDS)
        self._looked = now
        try:
            lines = os.read(self._pipe, 65536).decode().splitlines()
        except BlockingIOError:
            lines = []
        if lines:
            self.status = lines[-1]
        if lines or (not self.status and self._busy()):
            self._silence, self._used = 0.0, _turn(self.process.pid)[1]

    def expected(self) -> None:
        """Note that the graph is stepping: from now on this process must beat, even if it never did."""
        if not self.status:
            self.status, self._silence = "starting", 0.0

    def stopped(self) -> bool:
        """Whether somebody has stopped the process (SIGSTOP), at whatever stage it was."""
        if self.process.returncode is not None:
            return False
        # look only: it may be continued; asked about its end as well, since it may end at any moment
        options = os.WSTOPPED | os.WEXITED | os.WNOHANG | os.WNOWAIT
        found = os.waitid(os.P_PID, self.process.pid, options)
        return found is not None and found.si_code == os.CLD_STOPPED

    def silent(self) -> bool:
        """Whether the process has begun to beat, or should have, and does not.

        On a busy machine it may wait for its turn: it is not silent before it had some. When it has
        said that its run is over, it may take longer to take itself apart.
        """
        limit = STOP_GRACE_SECONDS if self.status in ("ended", "leaving") else SILENCE_SECONDS
        if not self.status or self._silence <= limit:
            return False
        return self._silence > STARVED_SECONDS or not self._starved()

    def idle(self) -> bool:
        """Whether the process has never beaten, and has done nothing for long: it will not come up."""
        return not self.status and self._silence > IDLE_START_SECONDS

    def _busy(self) -> bool:
        """Whether the process does something, or waits for its turn or for the disk."""
        state, used = _turn(self.process.pid)
        return state != "S" or used > self._used

    def _starved(self) -> bool:
        """Whether the process is ready to run and has hardly been let since it was last heard."""
        state, used = _turn(self.process.pid)
        return state == "R" and used - self._used < SILENCE_SECONDS / 2

    def has_nothing_to_lose(self) -> bool:
        """Whether the process has said that its run is over, and writes no bag."""
        leg, _, name = self.name.rpartition("/")
        of_leg = bool(leg) and name == COMPOSED  # of several legs: the recorder is a process of its own
        return self.status == "ended" and (of_leg or name in set(NODES) - {RECORDER})

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
                deadline = time.monotonic() + seconds
                while time.monotonic() < deadline:
                    os.killpg(self.process.pid, number)
                    time.sleep(POLL_SECONDS / 4)

    def release(self) -> None:
        """Close the pipe."""
        os.close(self._pipe)


def _turn(pid: int) -> tuple[str, float]:
    """Return the scheduler's letter for a process' main thread, and its processor time, s."""
    try:
        words = Path(f"/proc/{pid}/task/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:  # it has ended
        return "", 0.0
    return words[0], (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def supervise(
    commands: Mapping[str, Sequence[str]],
    environment: Mapping[str, str],
    logs: Path,
    progress: Callable[[int], None],
) -> None:
    """Run processes until all have ended well.

    Args:
        commands: name -> command line.
        environment: of all processes.
        logs: folder for what they print.
        progress: called now and then with the simulated time in ns.

    Raises:
        RunFailed: a process died, does not answer or never came up; all are stopped by then.
    """
    children: list[Child] = []
    try:
        for name, command in commands.items():
            children.append(Child(name, command, environment, logs / f"{name.replace('/', '_')}.log"))
        _watch(children, progress)
    except KeyboardInterrupt:
        raise RunFailed("interrupted; what was recorded until then is in the bag") from None
    finally:
        _stop(children)


def _watch(children: Sequence[Child], progress: Callable[[int], None]) -> None:
    began = time.monotonic()
    while any(child.process.poll() is None for child in children):
        time.sleep(POLL_SECONDS)
        for child in children:
            child.listen()
            _judge(child)
        late = [child.name for child in children if child.status in ("", "starting")]
        if late and time.monotonic() - began > START_SECONDS:
            raise RunFailed(f"not ready after {START_SECONDS:g} s: {', '.join(late)}")
        reached = max(child.time_ns for child in children)
        if reached > 0:
            for child in children:
                child.expected()
        progress(reached)
    for child in children:  # one may have ended between its last judgement and the loop's condition
        _judge(child)


def _judge(child: Child) -> None:
    code = child.process.poll()
    if child.let_go:
        return
    if code is not None:
        child.listen()  # its last words may have come since
    if code is not None and (code != 0 or child.status != "ended"):
        how = f"was killed by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"
        if code < 0 and child.has_nothing_to_lose():  # while it was taken apart
            child.let_go = True
            print(f"{NOTE_PREFIX}node {child.name} {how} when its run was over", file=sys.stderr)
            return
        raise RunFailed(f"node {child.name} {how}{_quoted(child.last_words())}")
    if child.status == "refused":
        raise RunFailed(f"node {child.name} refused to go on{_quoted(child.last_words())}")
    if child.stopped():
        raise RunFailed(f"node {child.name} was stopped (SIGSTOP)")
    if code is None and child.silent() and child.has_nothing_to_lose():
        # now and then the middleware never comes back from its own end
        child.let_go = True
        child.process.kill()
        return
    if code is None and child.silent():
        raise RunFailed(f"node {child.name} did not answer for {SILENCE_SECONDS:g} s")
    if code is None and child.idle():
        raise RunFailed(f"node {child.name} hung while it was started, for {IDLE_START_SECONDS:g} s")


def _quoted(words: str) -> str:
    return f": {words}" if words else ""


def _stop(children: Sequence[Child]) -> None:
    """End what still runs, politely and the recorder last, so that its bag holds what the others did."""
    recorders = [child for child in children if child.name == RECORDER]
    _end([child for child in children if child not in recorders], STOP_SECONDS)
    for recorder in recorders:
        recorder.listen()
    _end(recorders, RECORDER_STOP_SECONDS)


def _end(children: Sequence[Child], seconds: float) -> None:
    """End processes; in the end by force."""
    for child in children:
        child.stop()
    deadline = time.monotonic() + seconds
    while any(child.process.poll() is None for child in children) and time.monotonic() < deadline:
        time.sleep(POLL_SECONDS)
    for child in children:
        if child.process.poll() is None:
            child.process.kill()
            child.process.wait()
        child.end_helpers(HELPER_SECONDS)
        child.release()
