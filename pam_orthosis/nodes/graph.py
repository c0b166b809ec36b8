# SPDX-License-Identifier: Apache-2.0
"""What all nodes share: topics of the table, start barrier, parameters, health, end of the run."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from std_msgs.msg import String
from std_srvs.srv import Trigger

from pam_orthosis.bag.cdr import Reader, Template, Unreadable
from pam_orthosis.bag.topics import NODES, PLANT, PUBLISHED_DEPTH, RECORDER, SECOND_NS, SLOW, in_leg, table
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.ages import Ages
from pam_orthosis.nodes.agreement import ALIKE, Agreement
from pam_orthosis.nodes.exchange import Outlet
from pam_orthosis.nodes.join import HoldingJoin, Join
from pam_orthosis.nodes.layout import LAYOUT
from pam_orthosis.nodes.ownership import Ownership
from pam_orthosis.nodes.parameters import (
    Setting,
    declare_rows,
    declare_settings,
    refuse_sim_time,
    take_changes,
)
from pam_orthosis.nodes.transport import QUEUE_DEPTH, message_class, qos

PEER_POLL_SECONDS = 0.02
PEER_SECONDS, PEER_REPORT_SECONDS = 5.0, 30.0  # until it is said who is waited for, and said again
MOST_PERIODS = 20  # of missed samples that controllers make up for
MODE = {
    "realtime": Setting(False, "samples come by the wall clock; otherwise in lockstep with the voltages"),
    "with_plant": Setting(True, "the emulated hardware takes part; otherwise a driver stands in for it"),
    "replay": Setting(False, "a player stands in for all peers, and feeds a recorded bag"),
    "leg": Setting("", "name of the leg if it is one of several: the prefix of its frames"),
}


class GraphNode(Node):
    """A node of the table: declares its parameters, waits for its peers, reports its health.

    A subclass makes its publishers and subscriptions with `publish_to`, `listen_to` and, for what comes
    with each step, `publish_numbers`, `listen_to_numbers` and `join_inputs`, calls `step_done` at the end
    of each step, and overrides what it has to of `started`, `retune`, `health`, `figures`, `on_end` and
    `close`.

    Args:
        name: in the graph.
        settings: parameters beside those of `config/`.
        role: name in the table of topics if not `name`, with settings in braces.

    Raises:
        OrthosisError: unusable parameters.
    """

    def __init__(self, name: str, settings: Mapping[str, Setting] | None = None, role: str | None = None):
        super().__init__(name)
        self.settings = declare_settings(self, {**(settings or {}), **MODE})
        self.realtime = self.settings["realtime"]
        self.topics = table(self.realtime, self.settings["with_plant"], self.settings["replay"])
        self.role = (role or name).format(**self.settings)
        spec = LAYOUT[self.role]
        self.parameters = declare_rows(self, spec.branches, spec.live)
        self._changed: dict[str, Any] = {}
        take_changes(self, spec.live, self._take_changes)
        refuse_sim_time(self)  # asked before what stands above it
        self.every = self.parameters.control.position.every
        self.control_ns = round(self.parameters.scenario.control_period * 1e9)
        self.period_ns = self.control_ns * (self.every if self.role in SLOW else 1)  # of its own steps
        begins_at_0 = not self.realtime and not self.settings["replay"]
        self._own_ns = self.period_ns if begins_at_0 and self.period_ns > self.control_ns else 0
        self._origin_ns: int | None = None
        self.time_ns = 0
        self._reported_second = -1
        self.ready = False
        self.ended = False
        # found where none can be raised; ends the run, and is made when all is safe
        self.failure: Callable[[], OrthosisError] | None = None
        self.stranger = False  # was met by a node that has to end last
        # `spin` looks around in both: now and then at each step, at once when something has happened
        self.pulse: Callable[[], None] = lambda: None
        self.alarm: Callable[[], None] = lambda: None
        self._ages = Ages(self.control_ns)  # a slow node holds up the others
        self._unreadable = 0
        self._peers: dict[str, Callable[[], bool]] = {}
        self.ownership = Ownership(self, self.refuse)
        self.outlets: list[Outlet] = []
        self.inlets: list[tuple[str, Callable[[bytes], None]]] = []
        self.legs = self.served_legs()
        self._diagnostics = [self.publish_to("diagnostics", leg=leg) for leg in self.legs]
        self._ready = [self.publish_to("ready", latched=True, leg=leg) for leg in self.legs]
        self._agreements = [self._agree(leg) for leg in self.legs]
        if self.role in self.topics["end"].consumers:
            self.listen_to("end", self.on_end)
        self._report_due = time.monotonic() + PEER_SECONDS
        self._barrier = self.create_timer(PEER_POLL_SECONDS, self._wait_for_peers)

    def served_legs(self) -> tuple[str, ...]:
        """Return the namespaces, inside the node's own, of the legs that it serves."""
        return ("",)

    def parameters_of(self, leg: str) -> Parameters:
        """Return the parameters that the node has for one of its legs."""
        return self.parameters

    def await_peer(self, peer: str, there: Callable[[], bool]) -> None:
        """Do not start before this one is there; `peer` names it in the log."""
        self._peers[peer] = there

    def publish_to(self, topic: str, latched: bool = False, leg: str = "") -> Publisher:
        """Create a publisher of the table, and wait for its subscribers before the start."""
        entry, name = self.topics[topic], in_leg(topic, leg, self.legs)
        quality = qos(PUBLISHED_DEPTH, latched)
        publisher = self.create_publisher(message_class(entry.type), name, quality)
        if len(self._owners(topic)) == 1 and entry.subscribers:
            self.ownership.publishes(publisher.topic_name)
        count = len(entry.subscribers)
        if not latched:  # who comes later gets it too
            self.await_peer(f"a listener on {name}", lambda: publisher.get_subscription_count() >= count)
        return publisher

    def publish_numbers(self, topic: str, *examples: Any) -> Callable[..., None]:
        """Create a publisher of the table for messages like these; return `send(stamp_ns, *numbers)`.

        The numbers are those of type float64 in the order of the message; as many belong to one example.
        """
        outlet, kind = Outlet(self.publish_to(topic)), self.topics[topic].type
        self.outlets.append(outlet)
        made = [Template(serialize_message(example), kind) for example in examples]
        templates, send = {template.count: template for template in made}, outlet.send
        return lambda stamp_ns, *numbers: send(templates[len(numbers)](stamp_ns, *numbers))

    def listen_to_numbers(
        self, topic: str, fields: Sequence[str], callback: Callable[..., None], **options: Any
    ) -> None:
        """Listen to a topic of the table; call `callback(stamp_ns, *numbers)` with these of its fields.

        A number that a message lacks is NaN, which guards take care of. A slow node passes over what is
        between its steps unread, where it knows these instants beforehand.
        """
        read, own_ns = Reader(self.topics[topic].type, fields), self._own_ns

        def receive(data: bytes) -> None:
            try:
                if own_ns and read.stamp_ns(data) % own_ns:
                    return
                stamp_ns, numbers = read(data)
            except Unreadable:
                self._unreadable += 1
            else:
                callback(stamp_ns, *numbers)

        self.listen_to(topic, receive, raw=True, **options)

    def listen_to(self, topic: str, callback: Callable, leg: str = "", **options: Any) -> Subscription:
        """Subscribe to a topic of the table, and wait for its publishers before the start.

        Options are `depth`, `latched` (quality of service), `raw` (serialised messages) and `near`, which
        takes raw messages instead that come from this process, with zeros for padding. In real time the
        measurements are taken as they come, as from any sensor, once all peers are there.
        """
        entry, name, raw = self.topics[topic], in_leg(topic, leg, self.legs), options.pop("raw", False)
        near = options.pop("near", callback)
        if self.realtime and entry.rate == "step":
            callback, near = self._once_ready(callback), self._once_ready(near)
            options["reliable"] = PLANT not in entry.producers
        if self.role != RECORDER:  # it records what comes until all have ended
            callback, near = self._unless_failed(callback), self._unless_failed(near)
        count = len(entry.producers)
        kind, quality = message_class(entry.type), qos(**options)
        subscribe = partial(self.create_subscription, kind, name, qos_profile=quality, raw=raw)
        if entry.shared:
            subscription = subscribe(callback)
        else:
            met = partial(self.met_stranger, topic, leg)
            back = partial(self._may_come_again, topic)
            subscription = self.ownership.listen(subscribe, callback, self._owners(topic), met, back)
        if raw:
            self.inlets.append((subscription.topic_name, near))
        if not options.get("latched"):  # what is there comes by itself
            peer = f"{name} of {' and '.join(entry.producers)}"
            self.await_peer(peer, lambda: subscription.get_publisher_count() >= count)
        return subscription

    def _unless_failed(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that acts upon nothing once a stranger or another fault has ended the run."""
        return lambda message: None if self.failure else callback(message)

    def _may_come_again(self, topic: str, nodes: set[str]) -> bool:
        """Whether silent nodes of these names may have been killed: the end is said once, whoever lives."""
        a_driver = not self.settings["with_plant"] and PLANT in self.topics[topic].producers
        return topic != "end" and (a_driver or nodes <= set(self._owners(topic)))

    def met_stranger(self, topic: str, leg: str) -> None:
        """Note that somebody who does not belong there publishes on a topic; the run is ended."""

    def refuse(self, failure: Callable[[], OrthosisError]) -> None:
        """End the run, but for one that is over."""
        if not self.ended and not self.failure:
            self.failure = failure
            self.alarm()

    def fail(self, error: OrthosisError) -> None:
        """End the run from a timer: what is raised in one goes into the log with a traceback."""
        self.refuse(lambda: error)

    def _owners(self, topic: str) -> tuple[str, ...]:
        """Return who publishes on a topic, by role; in a replay the nodes that are fed say of themselves."""
        of_all = self.settings["replay"] and topic in ("ready", "configuration")
        return NODES if of_all else self.topics[topic].producers

    def join_inputs(
        self, inputs: Mapping[str, Sequence[str]], step: Callable[..., None], newest: bool = False
    ) -> Join | HoldingJoin:
        """Listen to topics; call `step(stamp_ns, *fields of each)` once all of an instant are there.

        With `newest`, in real time, a node that is behind skips to the newest measurements: it answers
        fewer samples, not older ones. What they cause downstream then comes no faster than it can.
        What slow nodes say is held until their next instant; `step` then takes as its last argument how
        old that is, s.
        """
        join = self._join(list(inputs), step)
        for topic, fields in inputs.items():
            measured = PLANT in self.topics[topic].producers
            # of so many samples one is of an instant at which a slow node works
            depth = self.every if newest and measured and self.realtime else QUEUE_DEPTH
            self.listen_to_numbers(topic, fields, _adder(join, topic), depth=depth)
        return join

    def _join(self, inputs: list[str], step: Callable[..., None]) -> Join | HoldingJoin:
        slow = [topic for topic in inputs if self.topics[topic].slow]
        if self.every == 1 or not slow or self.role in SLOW:
            return Join(inputs, step)
        return HoldingJoin(inputs, slow, step, self.every * self.control_ns)

    def offer(self, service: str, act: Callable[[], str]) -> None:
        """Offer a std_srvs/Trigger; `act` returns what it did, or raises OrthosisError to refuse."""

        def answer(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message, response.success = act(), True
            except OrthosisError as error:
                response.message, response.success = str(error), False
            self.get_logger().info(f"{service}: {response.message}")
            return response

        self.create_service(Trigger, service, answer)
        self.ownership.offers(service)

    def wait_until_delivered(self, seconds: float) -> None:
        """Wait until all listeners have what was published, for so long at most: one may be dead."""
        until = time.monotonic() + seconds
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, until - time.monotonic())))

    def step_done(self, stamp_ns: int) -> None:
        """Note that the step of an instant is computed; report health once a second."""
        self._origin_ns = stamp_ns if self._origin_ns is None else self._origin_ns
        self.time_ns = stamp_ns - self._origin_ns
        if self.realtime:
            self._ages.add(self.now_ns() - stamp_ns)
        if stamp_ns // SECOND_NS > self._reported_second:
            self._reported_second = stamp_ns // SECOND_NS
            self._report_health(stamp_ns)
        self.pulse()

    @property
    def stepped(self) -> bool:
        """Whether the node has done a step."""
        return self._origin_ns is not None

    def periods_since(self, stamp_ns: int) -> int:
        """Return how many of the node's periods an instant is later than the step that was done last.

        More than one if samples were missed; after a long silence no more than `MOST_PERIODS`.
        """
        if self._origin_ns is None:
            return 1
        passed = stamp_ns - self._origin_ns - self.time_ns
        return min(max(1, round(passed / self.period_ns)), MOST_PERIODS)

    def now_ns(self) -> int:
        """Return the present time of the node's clock."""
        return self.get_clock().now().nanoseconds

    def started(self) -> None:
        """Do what is due when all peers are there."""

    def health(self) -> dict[str, Any]:
        """Return counters that are zero while all is well; they depend on the run alone."""
        return {}

    def figures(self) -> dict[str, Any]:
        """Return what else the health report tells; called once a second of the run's time."""
        return {}

    def retune(self, parameters: Parameters) -> None:
        """Take parameters of which the live ones are new; raise OrthosisError to refuse them."""

    def on_end(self, _stamp: Time) -> None:
        """Stop spinning: the plant says that the run is over."""
        self.ended = True
        self.alarm()

    def abandon(self) -> bool:
        """Leave the hardware safe when the run is cut short; return whether that takes last messages.

        Called before `close`.
        """
        return False

    def hears(self) -> bool:
        """Whether something has come since this was last asked: last words may stand behind it."""
        return False

    def close(self) -> None:
        """Release what the node holds; called once, however the run ended."""

    def _take_changes(self, changes: dict[str, Any]) -> None:
        changed = self.parameters.changed(changes)
        self.retune(changed)
        self.parameters = changed
        self._changed |= changes
        self.get_logger().info(f"from now on {_told(changes)}")

    def _report_health(self, stamp_ns: int) -> None:
        told = {"set_while_running": _told(self._changed)} if self._changed else {}
        health, figures = self.health(), {**self.figures(), **told}
        if self._unreadable:
            health["unreadable_inputs"] = self._unreadable
        if self.realtime:
            health["missed_deadlines"] = self._ages.missed
            figures |= self._ages.figures()
        report = messages.diagnostics(stamp_ns, self.role, health, figures)
        for publisher in self._diagnostics:
            publisher.publish(report)

    def _once_ready(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        return lambda message: callback(message) if self.ready else None

    def _agree(self, leg: str) -> Agreement:
        """Say what the node was started with, and hear it of the others: all have to before the start."""
        values = {name: self.settings[name] for name in ALIKE} | self.parameters_of(leg).flat()
        others = self.topics["configuration"].producers
        agreement = Agreement(self.get_fully_qualified_name(), self.role, values, others)
        self.listen_to("configuration", agreement.add, leg=leg, latched=True)
        self.publish_to("configuration", latched=True, leg=leg).publish(agreement.message)
        return agreement

    def missing_peers(self) -> list[str]:
        """Return who or what must be there before the start and is not."""
        absent = [role for agreement in self._agreements for role in agreement.absent]
        return absent or [peer for peer, there in self._peers.items() if not there()]

    def _wait_for_peers(self) -> None:
        broken = [each for each in self._agreements if each.text]
        if broken:
            if broken[0].known_to_all():
                self.fail(OrthosisError(broken[0].text))
            return
        if missing := self.missing_peers():
            if time.monotonic() > self._report_due:
                self._report_due = time.monotonic() + PEER_REPORT_SECONDS
                self.get_logger().info(f"waiting for {', '.join(missing)}")
            return
        self._barrier.cancel()
        if self.realtime:  # what is there now stays: the collector need not look through it in each pause
            gc.collect()
            gc.freeze()
        self.ready = True
        for publisher in self._ready:
            publisher.publish(String(data=self.role))
        self.started()


def _told(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in values.items())


def _adder(join: Join, topic: str) -> Callable[..., None]:
    return lambda stamp_ns, *numbers: join.add(topic, stamp_ns, numbers)
