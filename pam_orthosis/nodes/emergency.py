# SPDX-License-Identifier: Apache-2.0
"""An emergency stop that the nodes at both ends of the valves' commands share, so that it outlives either.

Its end is a reset for all: what vents for good is tried again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from pam_orthosis.bag.topics import EMERGENCY_STOP
from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes import messages

if TYPE_CHECKING:
    from pam_orthosis.nodes.graph import GraphNode

ENDS = "ends_ns"  # of a release: the stamp of the newest stop that its sender knew of


class StopState:
    """Whether there is a stop, of what all who know of it report, in whatever order that comes.

    A stop that was pressed before its sender heard of a release goes on: the release does not end it.

    Attributes:
        newest_ns: the latest stamp of all that was heard.
    """

    def __init__(self) -> None:
        self.newest_ns = self.stopped_ns = self._ended_ns = 0

    @property
    def active(self) -> bool:
        """Whether a stop is not over."""
        return self.stopped_ns > self._ended_ns

    def hear(self, report: DiagnosticArray) -> bool:
        """Take a report; return whether it is of a newer stop, or ends the last."""
        if not report.status:
            return False
        known_ns, before = self.stopped_ns, self.active
        stamp_ns = messages.nanoseconds(report.header.stamp)
        self.newest_ns = max(self.newest_ns, stamp_ns)
        if any(one.level == DiagnosticStatus.ERROR for one in report.status):
            self.stopped_ns = max(known_ns, stamp_ns)
        else:
            self._ended_ns = max(self._ended_ns, _ends_ns(report, stamp_ns))
        return self.stopped_ns > known_ns if self.active else before


def _ends_ns(report: DiagnosticArray, stamp_ns: int) -> int:
    """Return the stamp up to which a release ends stops: all before it if it does not say."""
    said = (pair.value for one in report.status for pair in one.values if pair.key == ENDS)
    return next((int(value) for value in said if value.isdecimal()), stamp_ns - 1)


class EmergencyStop:
    """Offers `~/emergency_stop` and `~/reset`, and follows what its peers report.

    The state is published on a latched topic, by each who knows it: one that is started again hears it of the
    other. While it is `active` all valves are to vent. It lasts so long at least, in
    the time of the run; `over` is called then.
    """

    def __init__(self, node: GraphNode, shortest_ns: int = 0, over: Callable[[], None] = lambda: None):
        self._node, self._shortest_ns, self._over = node, shortest_ns, over
        self.active = self._reset_asked = False
        self._since_ns, self._state = 0, StopState()
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
        self.active, self._reset_asked, self._since_ns = active, False, self._node.time_ns
        stamp_ns = max(time.time_ns(), self._state.newest_ns + 1)  # the clock may have been set back
        level, word = (DiagnosticStatus.ERROR, "stopped") if active else (DiagnosticStatus.OK, "released")
        name = f"{self._node.full_role()}: emergency stop"
        ends = {} if active else {ENDS: self._state.stopped_ns}
        report = messages.diagnostics(stamp_ns, name, level, word, ends)
        self._state.hear(report)
        self._publish(report)
        if not active:
            self._over()

    def _hear(self, report: DiagnosticArray) -> None:
        if not self._state.hear(report):
            return
        self._reset_asked = self.active and not self._state.active
        if self._state.active:
            self.active, self._since_ns = True, self._node.time_ns
        self._publish(report)

    def _publish(self, report: DiagnosticArray) -> None:
        for publisher in self._publishers:
            publisher.publish(report)


def hear_reset(node: GraphNode, reset: Callable[[], None]) -> None:
    """Have a node that keeps no stop of its own call something when one is over."""
    state = StopState()

    def hear(report: DiagnosticArray) -> None:
        if state.hear(report) and not state.active:
            reset()

    node.listen_to(EMERGENCY_STOP, hear, latched=True)
