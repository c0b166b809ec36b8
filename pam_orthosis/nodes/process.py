# SPDX-License-Identifier: Apache-2.0
"""The process that nodes run in: its beginning, signals, beats for the supervisor, last words, its end."""

import faulthandler
import os
import re
import signal
import sys
import time
import traceback
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import Executor
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError, RunFailed
from pam_orthosis.nodes.exchange import Exchange
from pam_orthosis.nodes.graph import GraphNode
from pam_orthosis.nodes.supervisor import ERROR_PREFIX, HEARTBEAT_SECONDS, HEARTBEAT_VARIABLE

BY_HAND = ("--ros-args", "-p", "autostart:=false")  # of a node that was cleaned up


class Heartbeat:
    """Tells the supervisor through an inherited pipe that this process answers, and how far it is.

    Each line is `starting <peers that are missing>`, `running <stamp in ns>`, `refused` (a stranger is here;
    end the others first), `leaving` (cut short), `ended`, and `closed` when what the nodes of an ended run
    wrote is on the disk. Without a supervisor it is silent.
    """

    def __init__(self) -> None:
        descriptor = os.environ.get(HEARTBEAT_VARIABLE)
        self._pipe = int(descriptor) if descriptor else None
        self._last = 0.0
        self._armed = 0.0
        self.orphaned = False
        if self._pipe is not None:
            os.set_blocking(self._pipe, False)

    @property
    def supervised(self) -> bool:
        """Whether a supervisor listens."""
        return self._pipe is not None

    def beat(self, nodes: Sequence[GraphNode]) -> bool:
        """Write a line if one is due; return whether the supervisor still lives."""
        ended = all(node.ended for node in nodes)
        now = time.monotonic()
        if self._pipe is None or (now - self._last < HEARTBEAT_SECONDS and not ended):
            return True
        self._last = now
        if now - self._armed > 5.0:  # each time costs a thread
            self._armed = now
            self.ends_within(60.0)
        return self.write(_status(nodes, ended))

    def ends_within(self, seconds: float | None) -> None:
        """Let the process end itself, in whatever call it is stuck, if nothing is heard for so long.

        None takes that back. A peer that was killed can leave the middleware waiting for ever; where the
        process was stuck is then in its log.
        """
        if self._pipe is None:
            return
        if seconds is None:
            faulthandler.cancel_dump_traceback_later()
        else:
            faulthandler.dump_traceback_later(seconds, exit=True)

    def write(self, status: str) -> bool:
        """Write a line; return whether the supervisor still lives."""
        try:
            if self._pipe is not None:
                os.write(self._pipe, f"{status}\n".encode())
        except BlockingIOError:  # the supervisor sleeps: nothing is lost
            pass
        except BrokenPipeError:
            self.orphaned = True
        return not self.orphaned


def _status(nodes: Sequence[GraphNode], ended: bool) -> str:
    if ended:
        return "ended"
    if any(node.stranger for node in nodes):
        return "refused"
    if not all(node.active or node.stepped for node in nodes):
        return f"starting {sum(len(node.waits_for()) for node in nodes)}"
    return f"running {min(node.time_ns for node in nodes)}"


def _say_end(nodes: Sequence[GraphNode]) -> None:
    """Say in the log of a process how the run ended, where no error does."""
    if any(node.stepped for node in nodes):
        how = "is over" if _ended(nodes) else "was cut short"
        reached = max(node.time_ns for node in nodes) / SECOND_NS
        nodes[0].get_logger().info(f"the run {how} at {reached:.3f} s")


class _Watch:
    """Looks between callbacks whether nodes are to spin on, by a timer and at each step.

    A timer alone has to queue behind all that has arrived, which is much on a busy machine.
    """

    def __init__(self, nodes: Sequence[GraphNode], signals: Sequence[int]):
        self._nodes, self._signals, self._due = nodes, signals, 0.0
        self.over, self.heartbeat = Future(), Heartbeat()
        self.errors: list[Exception] = []
        nodes[0].wall_timer(HEARTBEAT_SECONDS, self.look)
        for node in nodes:
            node.pulse, node.alarm, node.supervised = self.pulse, self.look, self.heartbeat.supervised
            node.alone = len(nodes) == 1

    def pulse(self) -> None:
        """Look, if there is a signal or it is time."""
        if self._signals or time.monotonic() >= self._due:
            self.look()

    def look(self) -> None:
        """End the spinning at the run's end, a failure, a signal, or without the supervisor."""
        self._due = time.monotonic() + HEARTBEAT_SECONDS
        failed = self._signals or any(node.failure or node.over or node.worn for node in self._nodes)
        ended = all(node.ended for node in self._nodes)
        if failed or not self.heartbeat.beat(self._nodes) or ended:
            self.over.set_result(None)

    def fail(self, error: Exception) -> None:
        """Take what a callback raised."""
        self.errors.append(error)
        self.over.set_result(None)


def spin(nodes: Sequence[GraphNode], signals: Sequence[int]) -> bool:
    """Run nodes until the run ends, one of `caught_signals` is there or the supervisor is gone; close them.

    Returns whether the run came to its end. Signals are looked at between callbacks, so that a step is never
    cut in two.
    """
    watch = _Watch(nodes, signals)
    executor = EventsExecutor()  # the fast one; it needs a finite time-out to dispatch at all
    for node in nodes:
        executor.add_node(node)
    outlets = [outlet for node in nodes for outlet in node.outlets]
    Exchange(executor, watch.fail).connect(outlets, [inlet for node in nodes for inlet in node.inlets])
    failed = True
    try:
        while not watch.over.done():
            executor.spin_until_future_complete(watch.over, timeout_sec=3600.0)
        if watch.errors:
            raise watch.errors[0]
        failed = False
    finally:
        _close(nodes, executor, watch.heartbeat, patient=not failed)
        executor.shutdown()  # before its nodes are destroyed: the other way round its threads stay
    if _ended(nodes):
        watch.heartbeat.write("closed")
    for node in nodes:
        if node.failure:
            raise node.failure()
    _say_end(nodes)
    for node in nodes:
        node.destroy_node()
    return _ended(nodes)


def _ended(nodes: Sequence[GraphNode]) -> bool:
    return all(node.ended for node in nodes)


def _close(nodes: Sequence[GraphNode], executor: Executor, heartbeat: Heartbeat, patient: bool) -> None:
    """Close nodes; those of a run that is cut short say and hear last words before."""
    heartbeat.ends_within(10.0 if heartbeat.orphaned else None)
    if not _ended(nodes):
        heartbeat.write("leaving")
        seconds = 0.45 if heartbeat.orphaned else 0.1  # an orphan's recorder need not end last
        _abandon(nodes, executor, seconds, patient)
    for node in nodes:
        if node.configured:
            node.close()


def _abandon(nodes: Sequence[GraphNode], executor: Executor, seconds: float, patient: bool = True) -> None:
    """Let nodes say and hear last words; one that is not `patient` does not wait until the others are silent.

    Who has failed leaves first: the others go on until the supervisor sees that.
    """
    stay = [node.abandon() for node in nodes if node.configured]
    until = time.monotonic() + 2.0  # of a process of its own that still hears something
    turns = 2  # of silence, after which there is no more: in one the machine may have stood still
    silent = 0 if any(stay) else turns
    while silent < turns:
        executor.spin_until_future_complete(Future(), timeout_sec=seconds)
        heard = patient and len(nodes) == 1 and nodes[0].configured and nodes[0].hears()
        silent = 0 if heard and time.monotonic() < until else silent + 1


def run(make_nodes: Callable[[], Sequence[GraphNode]]) -> int:
    """Run the nodes of one process; return its exit status.

    A run that was cut short has no time to take the process apart; it leaves the middleware, so that its
    peers need not wait until they forget it.
    """
    nodes: list[GraphNode] = []
    signals = caught_signals()  # who is asked to end while it is made leaves the middleware too
    try:
        start_ros()
        nodes += make_nodes()
        whole, status = spin(nodes, signals), 0
    except Exception as error:
        whole, status = False, _reported(error)
    if not whole:
        sys.stderr.flush()
        leave(nodes)
        if status == 0 and len(nodes) == 1 and nodes[0].worn:
            os.execv(sys.executable, [*sys.orig_argv, *BY_HAND])
        os._exit(status)
    rclpy.try_shutdown()
    return status


def spin_while(node: Node, goes_on: Callable[[], bool]) -> None:
    """Spin a node that no run waits for."""
    executor = EventsExecutor()
    executor.add_node(node)
    while goes_on():
        executor.spin_once(timeout_sec=0.2)  # the executor dispatches nothing without a time-out


def follow(watch: Callable[[], None]) -> int:
    """Let a node watch runs that do not wait for it; return the exit status."""
    try:
        start_ros()
        watch()
    except OrthosisError as error:
        return _reported(error)
    finally:
        rclpy.try_shutdown()
    return 0


def leave(nodes: Sequence[Node]) -> None:
    """Tell all peers that these nodes are gone; end the process if the middleware does not come back."""
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, 1.0)
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()
    signal.setitimer(signal.ITIMER_REAL, 0.0)


def start_ros() -> None:
    """Start ROS with the command line's arguments, its signal handlers off; OrthosisError if it refuses."""
    try:
        rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rclpy's errors have no narrower ancestor
        said = re.sub(r", at [^ ]+:\d+", "", str(error).removeprefix("failed to initialize rcl: "))
        raise OrthosisError(f"cannot use the arguments behind --ros-args: {said}") from error


def _reported(error: Exception) -> int:
    """Tell an error in one line, after the traceback if nobody foresaw it; return the exit status."""
    if isinstance(error, OrthosisError):
        print(f"{ERROR_PREFIX}{error}", file=sys.stderr)
        return error.exit_status
    traceback.print_exception(error)
    print(f"{ERROR_PREFIX}{_culprit(error)}{type(error).__name__}: {error}", file=sys.stderr)
    return RunFailed.exit_status


def _culprit(error: Exception) -> str:
    """Return whose callback failed: several nodes may share the process."""
    frames = [frame.f_locals.get("self") for frame, _ in traceback.walk_tb(error.__traceback__)]
    roles = [each.role for each in frames if isinstance(each, GraphNode)]
    return f"in {roles[-1]}: " if roles else ""


def caught_signals() -> list[int]:
    """Return the list to which SIGINT and SIGTERM are appended from now on.

    rclpy's own handlers would end the context under a callback that is about to publish.
    """
    caught: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _frame: caught.append(number))
    return caught
