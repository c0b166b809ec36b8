# SPDX-License-Identifier: Apache-2.0
"""Node: limits apart from the controllers; it allows the valves a pressure, and can stop them by itself."""

from collections.abc import Sequence
from functools import partial
from typing import Any

from pam_orthosis.bag.topics import ALLOWED, SAFETY, SAMPLE
from pam_orthosis.control.limits import SafetyMonitor
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import voltage_of
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.emergency import EmergencyStop
from pam_orthosis.nodes.topic_node import Numbers


class SafetyMonitorNode(graph.GraphNode):
    """Answers each sample with the pressure that it allows, and hears what the valves are commanded.

    The valves' node waits for this answer: without a monitor no air gets in. Beyond a limit it also stops
    those who own the valves, whatever the nodes between do. The service `~/resume` goes on, slowly.
    """

    def __init__(self, place: Sequence[str] = ()) -> None:
        super().__init__(SAFETY, place=place)

    def configure(self) -> None:
        """Make the monitor, and what it hears and says."""
        super().configure()
        if ALLOWED not in self.topics:
            raise OrthosisError(
                "safety_monitor: set control.limits.enabled to true, for all nodes of the run"
            )
        self._monitor = SafetyMonitor(self.parameters)
        self._stop = EmergencyStop(self)
        self._trips = 0
        self._allowed = self.publish_numbers(ALLOWED, messages.fluid_pressure(0, "", 0.0, leg=self.leg))
        pressures = {f"{name}/pressure": messages.PRESSURE for name in self.machine.names}
        self._join = self.join_inputs({SAMPLE: ["position[0]"], **pressures}, self._step)
        for line, topic in enumerate(self.table.commands):
            self.listen_to_numbers(topic, messages.SPOOL, partial(self._heard, line))
        self.offer("~/resume", self._resume)
        if self.realtime:
            self.wall_timer(self.parameters.control.limits.stale_time / 2, self._look)

    def health(self) -> dict[str, Any]:
        """Count trips and lost inputs; report an emergency stop."""
        return {
            "trips": self._trips + len(self._monitor.trips),
            "emergency_stop": self._stop.active,
            "dropped_inputs": self._join.dropped,
        }

    def figures(self) -> dict[str, Any]:
        """Return the pressure that is allowed."""
        return {"allowed_pressure_pa": self._monitor.allowed}

    def latched(self) -> str:
        """Return which limits were exceeded, until `~/resume`."""
        return ", ".join(map(str, self._monitor.trips))

    def retune(self, parameters: Parameters) -> None:
        """Take other limits of the patient from the next step on."""
        self._monitor.retune(parameters)

    def _step(self, stamp_ns: int, sample: Numbers, *pressures: Numbers) -> None:
        (position,) = sample
        self._monitor.step(stamp_ns, position, [pressure for (pressure,) in pressures])
        self._vent_if_due()
        self._allowed(stamp_ns, self._monitor.allowed, 0.0)
        self.step_done(stamp_ns)

    def _heard(self, line: int, _stamp_ns: int, spool: Numbers) -> None:
        (position,) = spool
        self._monitor.heard(line, voltage_of(position, self.parameters.valve))
        self._vent_if_due()

    def _look(self) -> None:
        if self.stepped and not self.ended:
            self._monitor.silent(self.now_ns())
            self._vent_if_due()

    def _vent_if_due(self) -> None:
        """Stop, also anew if somebody has released the stop at the other end meanwhile."""
        if self._monitor.venting and not self._stop.step():
            self._stop.stop()
            self.get_logger().error(f"vented until ~/resume: {self.latched()}")

    def _resume(self) -> str:
        trips = len(self._monitor.trips)
        if why_not := self._monitor.resume():
            raise OrthosisError(f"not resumed: {why_not}")
        self._trips += trips
        if self._stop.active:
            self._stop.reset()
            self._stop.step()
        return f"the pressure rises within {self.parameters.control.limits.resume_time:g} s"


def main() -> int:
    """Run the node."""
    return process.run(lambda: [SafetyMonitorNode()])
