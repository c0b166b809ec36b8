# SPDX-License-Identifier: Apache-2.0
"""An emergency stop that the nodes at both ends of the valves' commands share, so that it outlives either.

Its end is a reset for all: what vents for good is tried again.
"""

import time
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from pam_orthosis.bag.topics import EMERGENCY_STOP
from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.graph import GraphNode


class EmergencyStop:
    """Offers `~/emergency_stop` and `~/reset`, and follows what its peers report.

    The state is published on a latched topic, by each who knows it: one that is started again hears it of the
    other. The newest state counts. While it is `active` all valves are to vent. It lasts so long at least, in
    the time of the run; `over` is called then.
    """

    def __init__(self, node: GraphNode, shortest_ns: int = 0, over: Callable[[], None] = lambda: None):
        self._node, self._shortest_ns, self._over = node, shortest_ns, over
        self.active = self._reset_asked = False
        self._since_ns = self._reported_ns = 0
        self._publishers = [node.publish_to(EMERGENCY_STOP, latched=True, leg=leg) for leg in node.legs]
        for leg in node.legs:  # a stop in one of them is a stop in all
            node.listen_to(EMERGENCY_STOP, self._hear, leg=leg, latched=True)
        node.offer("~/emergency_stop", self.stop)
        node.offer("~/reset", self.reset)

    def step(self) -> bool:
        """Return whether to vent; a reset takes effect when the stop has lasted for long enough."""
        if self._reset_asked and self._node.time_ns - self._since_ns >= self._shortest_ns:
            self._become(False)
        return self.active

    def stop(self) -> str:
        """Stop; return what that does."""
        self._become(True)
        return f"{' and '.join(self._node.machine.names)} are vented until reset"

    def reset(self) -> str:
        """End the stop; return what that does; OrthosisError if there is none."""
        if not self.active:
            raise OrthosisError(
                "there is no emergency stop to reset; what vents for good is tried again after one"
            )
        self._reset_asked = True
        least = f", {self._shortest_ns * 1e-9:g} s after the stop at the earliest" * (self._shortest_ns > 0)
        return f"the valves follow their commands again{least}; the joint is led back once it rests"

    def _become(self, active: bool) -> None:
        self.active, self._reset_asked, self._reported_ns = active, False, time.time_ns()
        self._since_ns = self._node.time_ns
        level, word = (DiagnosticStatus.ERROR, "stopped") if active else (DiagnosticStatus.OK, "released")
        name = f"{self._node.full_role()}: emergency stop"
        self._publish(messages.diagnostics(self._reported_ns, name, level, word, {}))
        if not active:
            self._over()

    def _hear(self, report: DiagnosticArray) -> None:
        stamp_ns = messages.nanoseconds(report.header.stamp)
        if stamp_ns <= self._reported_ns or not report.status:
            return
        self._reported_ns = stamp_ns
        active = says_stopped(report)
        self._reset_asked = self.active and not active
        if active:
            self.active, self._since_ns = True, self._node.time_ns
        self._publish(report)

    def _publish(self, report: DiagnosticArray) -> None:
        for publisher in self._publishers:
            publisher.publish(report)


def hear_reset(node: GraphNode, reset: Callable[[], None]) -> None:
    """Have a node that keeps no stop of its own call something when one is over."""
    stopped = False

    def hear(report: DiagnosticArray) -> None:
        nonlocal stopped
        before, stopped = stopped, says_stopped(report)
        if before and not stopped:
            reset()

    node.listen_to(EMERGENCY_STOP, hear, latched=True)


def says_stopped(report: DiagnosticArray) -> bool:
    """Whether a message says that there is an emergency stop."""
    return any(one.level == DiagnosticStatus.ERROR for one in report.status)
