# SPDX-License-Identifier: Apache-2.0
"""Node: leads the graph of two legs through the programme of a session, as a therapist would.

It sets modes and cadence by the parameters of the nodes, rests and goes on by their services, reads trips in
the health reports, and prints at the end what was done, as JSON. Nothing waits for it: a stage begins some
steps after its instant.

python -m pam_orthosis.nodes.entry session_conductor PROGRAMME
"""

import json
import os
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pam_orthosis.bag.topics import CLOCK, DIAGNOSTICS, PLANT, POSITION, SAFETY, SECOND_NS, TRAJECTORY, Topics
from pam_orthosis.control.limits import Trip, trips_in
from pam_orthosis.control.programme import Programme, Stage, read_programme
from pam_orthosis.control.session import Course, Leg, as_led
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import process
from pam_orthosis.nodes.layout import PACE, RESTING
from pam_orthosis.nodes.transport import message_class, qos

CADENCE, SETS = "scenario.cycle_time", "set_parameters_atomically"
SERVICES: dict[Any, tuple[str, ...]] = {
    Trigger: (f"{TRAJECTORY}/start", f"{TRAJECTORY}/stop", f"{SAFETY}/resume"),
    SetParametersAtomically: tuple(f"{node}/{SETS}" for node in (TRAJECTORY, POSITION, PLANT)),
}
UNDER_WAY = "it has not answered yet"


class LedLeg(Leg):
    """A leg of a graph: what a programme changes of it is asked of its nodes.

    `call`: (service of the leg, parameters to set or nothing) -> what holds the answer.
    """

    def __init__(self, parameters: Parameters, call: Callable[[str, Mapping[str, Any] | None], Any]):
        super().__init__(parameters)
        self._call, self._accepted_ns = call, -1
        self._trips: list[Trip] = []
        self._resuming: Any = None
        self._asked: list[tuple[str, Mapping[str, Any] | None, Any]] = []  # and not known to be done

    def enter(self, stage: Stage, time_ns: int) -> None:
        """Take mode and cadence of a stage; rest or go on."""
        before = self.parameters
        super().enter(stage, time_ns)
        changed = {key: one for key in stage.changes if (one := self.parameters.at(key)) != before.at(key)}
        if cadence := changed.pop(CADENCE, None):
            self._ask(TRAJECTORY, {CADENCE: cadence})
            self._ask(PLANT, {PACE: cadence})
        if changed:
            self._ask(POSITION, changed)

    def stop(self, time_ns: int) -> None:
        """Come to rest, and the person too."""
        if not self.trajectory.stopped:
            self._ask(f"{TRAJECTORY}/stop")
            self._ask(PLANT, {RESTING: True})
        super().stop(time_ns)

    def go_on(self, time_ns: int) -> None:
        """Walk on, and the person too."""
        super().go_on(time_ns)
        self._ask(f"{TRAJECTORY}/start")
        self._ask(PLANT, {RESTING: False})

    def refusal(self) -> str:
        """Return what a node has refused since this was last called, and why, or nothing."""
        answered = [one for one in self._asked if one[-1].done()]
        self._asked = [one for one in self._asked if one not in answered]
        refusals = (_refusal(service, values, call.result()) for service, values, call in answered)
        return next(filter(None, refusals), "")

    def _ask(self, service: str, values: Mapping[str, Any] | None = None) -> None:
        self._asked.append((service, values, self._call(service, values)))

    def hear(self, report: DiagnosticStatus) -> None:
        """Take a health report of the safety monitor; what it was resumed from is over."""
        found = trips_in(report.message) if report.level == DiagnosticStatus.ERROR else []
        self._trips = [trip for trip in found if trip.time_ns > self._accepted_ns]

    def trips(self) -> list[Trip]:
        """Return the limits that were exceeded, until it is resumed."""
        return self._trips

    def resume(self) -> str:
        """Have the monitor let it go on; return why it does not, or nothing."""
        if self._resuming is None:
            self._resuming = self._call(f"{SAFETY}/resume", None)
        if not self._resuming.done():
            return UNDER_WAY
        answer, self._resuming = self._resuming.result(), None
        if not answer.success:
            return str(answer.message)
        self._accepted_ns = max((trip.time_ns for trip in self._trips), default=-1)
        self._trips = []
        return ""


def _refusal(service: str, values: Mapping[str, Any] | None, answer: Any) -> str:
    """Return what a node refuses and why, or nothing if it does what it was asked."""
    if values is None:
        return "" if answer.success else f"{service} is refused: {answer.message}"
    asked = ", ".join(f"{key} = {value}" for key, value in values.items())
    return "" if answer.result.successful else f"{service} refuses {asked}: {answer.result.reason}"


class SessionConductor(Node):
    """Follows the clock of a graph, and leads its legs."""

    def __init__(self, programme: Programme):
        super().__init__("session_conductor")
        self._called = {  # made early: who is not known yet hears nothing
            name: self.create_client(kind, name)
            for leg in programme.legs
            for kind, services in SERVICES.items()
            for name in (f"/{leg}/{service}" for service in services)
        }
        legs = {
            name: LedLeg(as_led(one, programme, 1.0), partial(self._call, name))
            for name, one in programme.legs.items()
        }
        self._legs, self.course, self.over = legs, Course(programme, legs), False
        self._table = Topics(next(iter(programme.legs.values())).declared)
        self._silent = {leg: {*self._table.nodes, SAFETY} - {PLANT} for leg in legs}
        for leg in legs:
            ready = partial(self._on_ready, leg)
            self.create_subscription(String, f"/{leg}/ready", ready, qos(latched=True))

    def _on_ready(self, leg: str, role: String) -> None:
        """Listen once nobody counts his listeners any more: he would take this node for a peer."""
        waited = any(self._silent.values())
        self._silent[leg].discard(role.data)
        if waited and not any(self._silent.values()):
            self.course.begin()
            newest = qos(reliable=False, depth=1)
            self.create_subscription(Clock, CLOCK, self._on_clock, newest)
            kind = message_class(self._table.by_name[DIAGNOSTICS].type)
            self.create_subscription(kind, DIAGNOSTICS, self._on_report, qos())
            kind = message_class(self._table.by_name["end"].type)
            self.create_subscription(kind, f"/{next(iter(self._legs))}/end", self._on_end, qos())

    def _on_clock(self, message: Clock) -> None:
        time_ns = message.clock.sec * SECOND_NS + message.clock.nanosec
        if self.course.over:
            return
        index = time_ns // self.course.period_ns
        refusals = [f"{name}/{why}" for name, leg in self._legs.items() if (why := leg.refusal())]
        if refusals:
            self.course.give_up(index, refusals[0])
        else:
            self.course.after(index)

    def _on_report(self, reports: DiagnosticArray) -> None:
        for report in reports.status:
            leg, _, node = report.name.partition("/")
            if leg in self._legs and node == f"{SAFETY}: loop":
                self._legs[leg].hear(report)

    def _on_end(self, _message: Time) -> None:
        self.over = True

    def _call(self, leg: str, service: str, values: Mapping[str, Any] | None) -> Any:
        client = self._called[f"/{leg}/{service}{'' if values is None else f'/{SETS}'}"]
        kind: Any = client.srv_type  # whose parts rclpy does not declare
        request = kind.Request()
        if values is not None:
            request.parameters = [Parameter(key, value=one).to_parameter_msg() for key, one in values.items()]
        return client.call_async(request)


def main() -> int:
    """Lead until the run ends, SIGINT, SIGTERM or the end of whoever started it; print what was done."""
    signals, parent = process.caught_signals(), os.getppid()

    def lead() -> None:
        given = remove_ros_args(sys.argv)[1:]
        if not given:
            raise OrthosisError("no programme is given: name its file, session_conductor PROGRAMME")
        node = SessionConductor(read_programme(Path(given[0])))
        process.spin_while(node, lambda: not (signals or node.over) and os.getppid() == parent)
        course = node.course
        ended = course.ended or ("" if course.over else "the run was over before the programme")
        found = {"strides": course.strides, "trips": course.trips, "ended": ended}
        print(json.dumps(found), flush=True)

    return process.follow(lead)
