# SPDX-License-Identifier: Apache-2.0
"""Node: shows a running graph in the browser: its legs as they move, errors, pressures, emergency stop.

It prints the address of its page, which this host alone can open, and listens once the nodes of the graph are
ready. Nothing waits for it. A button calls the service of each leg at both ends of the valves' commands. The
machine is that of the parameters, as with `leg_state_publisher`.
"""

import os
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pam_orthosis.bag.cdr import Reader, Unreadable
from pam_orthosis.bag.topics import EMERGENCY_STOP, PLANT, VALVE, Topics, in_leg
from pam_orthosis.nodes import process
from pam_orthosis.nodes.emergency import StopState
from pam_orthosis.nodes.layout import SHOWN, VIEWER, NodeSpec
from pam_orthosis.nodes.live_server import LiveServer
from pam_orthosis.nodes.parameters import MACHINE, Setting, declare_rows, declare_settings, machine_of
from pam_orthosis.nodes.transport import message_class, qos
from pam_orthosis.report.live import Input, LiveLeg, inputs, live_page

SERVICES = {"stop": "emergency_stop", "reset": "reset"}
ANSWER_SECONDS = 2.0  # in which a service answers
HANGS_SECONDS = 2 * ANSWER_SECONDS  # without an answer of the node itself
WAITING, RUNNING, STOPPED, OVER = "waiting", "running", "stopped", "over"


class _Pressed(NamedTuple):
    """A button that was pressed: who was called in each leg, by which call; until when; where to answer."""

    calls: Mapping[str, list[tuple[Client, Any]]]
    until: float
    answer: Future[str]


class LiveView(Node):
    """Follows the legs of a graph, and takes what buttons of its page ask for."""

    def __init__(self) -> None:
        super().__init__(VIEWER)
        legs = Setting("", "namespaces of all legs, comma between; none: one leg")
        self.settings = declare_settings(self, {**MACHINE, "legs": legs})
        self._legs = self.settings["legs"].split(",")
        parameters = declare_rows(self, machine_of(self.settings), NodeSpec(VIEWER, VIEWER, SHOWN))
        self._views = {leg: LiveLeg(parameters) for leg in self._legs}
        self._table = Topics(parameters.declared)
        self._ready: dict[str, set[str]] = {leg: set() for leg in self._legs}
        self._stops = {leg: StopState() for leg in self._legs}
        self._times: dict[str, float] = {}
        self._fresh: dict[str, list[dict[str, Any]]] = {}
        self._over, self._shown = False, ""
        self._presses: SimpleQueue[tuple[str, Future[str]]] = SimpleQueue()
        self._pressed: list[_Pressed] = []
        services = [(leg, service) for leg in self._legs for service in SERVICES.values()]
        self._ends = {one: self._clients_of(*one) for one in services}
        page = live_page(self._views[self._legs[0]], self._legs)
        self.server = LiveServer(page, {act: partial(self._press, name) for act, name in SERVICES.items()})
        for leg in self._legs:
            self._latched("ready", leg, partial(self._on_ready, leg))
            self._latched(EMERGENCY_STOP, leg, partial(self._on_stop, leg))
        self._heard: dict[str, list[Any]] = {}
        self.create_timer(0.05, self._turn, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def close(self) -> None:
        """Let the page know that the run is over."""
        self._over = True
        self._say(last=True)
        self.server.close()

    def _name(self, topic: str, leg: str) -> str:
        return in_leg(topic, leg, self._legs)

    def _clients_of(self, leg: str, service: str) -> list[Any]:
        names = [self._name(f"{end}/{service}", leg) for end in (VALVE, PLANT)]
        return [self.create_client(Trigger, name) for name in names]

    def _latched(self, topic: str, leg: str, callback: Callable[[Any], None]) -> None:
        kind = message_class(self._table.by_name[topic].type)
        self.create_subscription(kind, self._name(topic, leg), callback, qos(latched=True))

    def _on_ready(self, leg: str, role: String) -> None:
        self._ready[leg].add(role.data)

    def _on_stop(self, leg: str, report: DiagnosticArray) -> None:
        self._stops[leg].hear(report)

    def _turn(self) -> None:
        """Do what is due some 20 times a second."""
        while not self._presses.empty():
            service, answer = self._presses.get()
            if answer.set_running_or_notify_cancel() or service == SERVICES["stop"]:  # late, but safe
                self._call(service, answer)
        self._pressed = [one for one in self._pressed if not self._answered(one)]
        for leg in self._legs:
            if leg not in self._heard and self._all_ready(leg):
                self._listen(leg)
        if self._fresh or self._state() != self._shown:
            self._say()

    def _say(self, last: bool = False) -> None:
        self._shown = self._state()
        self.server.say({"state": self._shown, "legs": self._fresh}, last)
        self._fresh = {}

    def _state(self) -> str:
        if self._over:
            return OVER
        if not self._times:
            return WAITING
        return STOPPED if any(one.active for one in self._stops.values()) else RUNNING

    def _all_ready(self, leg: str) -> bool:
        """Return whether all nodes of a leg have started, also those that a run may leave out.

        Before, each counts the subscribers of its topics to see whether its peers are there, and would take
        this node for one of them.
        """
        ready = self._ready[leg]
        said = self.count_publishers(self._name("ready", leg))
        return ready.issuperset(set(self._table.nodes) - {PLANT}) and said <= len(ready)

    def _listen(self, leg: str) -> None:
        """Listen to what is shown of a leg; what gets lost nobody sends again."""
        subscribe = partial(self.create_subscription, qos_profile=qos(reliable=False))
        end = self._name("end", leg)
        self._heard[leg] = [
            subscribe(message_class(self._table.by_name["end"].type), end, partial(self._on_end, leg)),
            *(
                subscribe(message_class(one.type), self._name(one.topic, leg), self._take(leg, one), raw=True)
                for one in inputs(self._table.machine)
            ),
        ]

    def _on_end(self, leg: str, _at: Any) -> None:
        """Note that a leg's run is over; of the next one its nodes are to be ready again."""
        self._over = True
        self._ready[leg].clear()
        for subscription in self._heard.pop(leg):
            self.destroy_subscription(subscription)

    def _take(self, leg: str, one: Input) -> Callable[[bytes], None]:
        read, view = Reader(one.type, [one.field]), self._views[leg]

        def take(data: bytes) -> None:
            try:
                stamp_ns = read.stamp_ns(data)
                picture = view.due(stamp_ns) and view.add(one.topic, stamp_ns, *read(data)[1])
            except Unreadable:
                return
            if picture:
                self._show(leg, picture)

        return take

    def _show(self, leg: str, picture: dict[str, Any]) -> None:
        last = self._times.get(leg, picture["time"])
        if abs(picture["time"] - last) > 1.0:  # another run
            self._over = False
        self._times[leg] = picture["time"]
        self._fresh.setdefault(leg, []).append(picture)

    def _press(self, service: str) -> str:
        """Return what a service answers. It is called in the thread of the node: this one is the server's."""
        answer: Future[str] = Future()
        self._presses.put((service, answer))
        try:
            return answer.result(HANGS_SECONDS)
        except TimeoutError:
            answer.cancel()
            return f"no answer within {HANGS_SECONDS:g} s: press again"

    def _call(self, service: str, answer: Future[str]) -> None:
        there = {leg: filter(Client.service_is_ready, self._ends[leg, service]) for leg in self._legs}
        calls = {
            leg: [(end, end.call_async(Trigger.Request())) for end in ends] for leg, ends in there.items()
        }
        self._pressed.append(_Pressed(calls, time.monotonic() + ANSWER_SECONDS, answer))

    def _answered(self, one: _Pressed) -> bool:
        """Whether a button has its answer: of all, or of those who answered in time."""
        under_way = [(end, call) for calls in one.calls.values() for end, call in calls if not call.done()]
        if under_way and time.monotonic() < one.until:
            return False
        for end, call in under_way:
            end.remove_pending_request(call)
        words = (
            f"{leg}{leg and ': '}{_words([call for _, call in calls])}" for leg, calls in one.calls.items()
        )
        if not one.answer.cancelled():
            one.answer.set_result("; ".join(words))
        return True


def _words(calls: list[Any]) -> str:
    """Return what either end did, or else why not."""
    answers = [call.result() for call in calls if call.done()]
    done: list[str] = [one.message for one in answers if one.success]
    return (done or [one.message for one in answers] or ["nobody answers: does the graph run?"])[0]


def main() -> int:
    """Run the node until SIGINT, SIGTERM or the end of whoever started it."""
    signals, parent = process.caught_signals(), os.getppid()

    def watch() -> None:
        node = LiveView()
        try:
            print(node.server.url, flush=True)
            process.spin_while(node, lambda: not signals and os.getppid() == parent)
        finally:
            node.close()

    return process.follow(watch)
