# SPDX-License-Identifier: Apache-2.0
"""A ROS node whose publishers and subscriptions follow the table of topics."""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from pam_orthosis.bag.cdr import Reader, Template, Unreadable
from pam_orthosis.bag.topics import (
    PLANT,
    PUBLISHED_DEPTH,
    RECORDER,
    SLOW,
    Topic,
    Topics,
    asked_beside,
    in_leg,
)
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.device import legs_from, parameters_of
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes.agreement import ALIKE
from pam_orthosis.nodes.barrier import Barrier
from pam_orthosis.nodes.exchange import Outlet
from pam_orthosis.nodes.join import HoldingJoin, Join
from pam_orthosis.nodes.layout import layout
from pam_orthosis.nodes.managed import ManagedNode
from pam_orthosis.nodes.ownership import Ownership
from pam_orthosis.nodes.parameters import MACHINE, Setting, declare_rows, declare_settings, machine_of
from pam_orthosis.nodes.transport import QUEUE_DEPTH, message_class, qos

MODE = {
    **MACHINE,
    "realtime": Setting(False, "samples come by the wall clock; otherwise in lockstep with the voltages"),
    "with_plant": Setting(True, "the emulated hardware takes part; otherwise a driver stands in for it"),
    "replay": Setting(False, "a player stands in for all peers, and feeds a recorded bag"),
    "leg": Setting(
        "", "name of the leg if it is one of several: the prefix of its frames; none: the namespace"
    ),
}

Numbers = tuple[float, ...]


class TopicNode(ManagedNode):
    """A node of the table: declares its parameters, makes its publishers, subscriptions and services.

    Args:
        name, place: as of a `ManagedNode`.
        settings: parameters beside those of `config/`.
        role: name in the table of topics if not `name`, with settings in braces.

    Attributes:
        failure: ends the run; it makes the error when all is safe.
        machine, table: whose graph this is, and its topics.
        topics, beside: those of this run, and the names of the optional ones among them.
        acts: it is active, and no failure has ended its run.
        stranger: somebody who does not belong there was met by a node that has to end last.
    """

    def __init__(
        self,
        name: str,
        settings: Mapping[str, Setting] | None,
        role: str | None,
        place: Sequence[str] = (),
    ):
        self._wall = Clock(clock_type=ClockType.STEADY_TIME)
        self._own_settings, self._role_of = settings or {}, role or name
        self.forget()
        super().__init__(name, place)

    def configure(self) -> None:
        """Declare its parameters, and make what looks for peers and strangers."""
        self.forget()
        self.settings = declare_settings(self, {**self._own_settings, **MODE})
        self.realtime = self.settings["realtime"]
        self.machine = machine_of(self.settings)
        self.table = Topics(self.machine)
        self.role = self._role_of.format(**self.settings)
        specs = layout(self.table)
        if self.role not in specs:
            names = ", ".join(self.machine.names)
            raise OrthosisError(f"{self.get_name()}: parameter muscle must be one of {names}")
        self.spec = specs[self.role]
        self.parameters = declare_rows(self, self.machine, self.spec)
        self.legs = tuple(self._differences())
        self.beside = {topic for leg in self.legs for topic in asked_beside(self.parameters_of(leg))}
        self._tables = {leg: self.topics_of(leg) for leg in self.legs}
        self.topics = {name: one for table in self._tables.values() for name, one in table.items()}
        self.every: int = self.parameters.control.position.every
        self.control_ns: int = round(self.parameters.scenario.control_period * 1e9)
        self.period_ns: int = self.control_ns * (self.every if self.role in SLOW else 1)  # of its own steps
        self.ownership = Ownership(self, self.refuse)
        self.barrier = Barrier(self, self.come_up, self.fail)

    def forget(self) -> None:
        """Be as before the first run."""
        self.stranger = self.acts = False
        self.failure: Callable[[], OrthosisError] | None = None
        self.outlets: list[Outlet] = []
        self.inlets: list[tuple[str, Callable[[bytes], None]]] = []
        self._held: list[Callable[[], None]] = []  # hand on what came while the node was not active
        self.unreadable = 0  # messages that came

    def _differences(self) -> dict[str, dict[str, Any]]:
        """Return what differs in each leg that the node serves, by namespaces inside its own."""
        return legs_from(self.settings.get("legs", ""), self.role)

    def parameters_of(self, leg: str) -> Parameters:
        """Return the parameters that the node has for one of its legs."""
        own = self._differences()[leg]
        return parameters_of(own, self.parameters) if own else self.parameters

    def topics_of(self, leg: str) -> dict[str, Topic]:
        """Return the topics of one of the node's legs by name: each may be of another machine."""
        parameters = self.parameters_of(leg)
        table = self.table if parameters.declared == self.machine else Topics(parameters.declared)
        realtime, with_plant, replay = (self.settings[key] for key in ALIKE)
        return table.of_run(realtime, with_plant, replay, asked_beside(parameters))

    @property
    def leg(self) -> str:
        """The prefix of its frames: the leg if it is one of several, else the namespace if there is one."""
        return self.settings["leg"] or self.get_namespace().strip("/")

    def full_role(self, leg: str = "") -> str:
        """Return the node's role in one of its legs with its namespace, `left/position_controller`."""
        return "/".join(filter(None, (self.get_namespace().strip("/"), leg, self.role)))

    def wall_timer(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Create a timer of the wall clock, whatever the time of the node is."""
        return self.create_timer(seconds, callback, clock=self._wall)

    def waits_for(self) -> list[str]:
        """Return who or what must be there before the node can become active and is not."""
        return self.barrier.missing() if self.configured else ["its configuration"]

    def activate(self) -> None:
        """Take part; OrthosisError if a peer is missing."""
        if missing := self.barrier.missing():
            raise OrthosisError(f"{self.get_name()} waits for {', '.join(missing)}")
        self.active = self.acts = True
        self.begin()
        for hand_on in self._held:
            hand_on()

    def deactivate(self) -> None:
        """Take no more part."""
        self.acts = False

    def begin(self) -> None:
        """Do what is due when all peers are there."""

    def refuse(self, failure: Callable[[], OrthosisError]) -> None:
        """End the run."""
        self.failure = failure

    def fail(self, error: OrthosisError) -> None:
        """End the run from a timer: what is raised in one goes into the log with a traceback."""
        self.refuse(lambda: error)

    def met_stranger(self, topic: str, leg: str) -> None:
        """Note that somebody who does not belong there publishes on a topic; the run is ended."""

    def publish_to(self, topic: str, latched: bool = False, leg: str = "") -> Publisher:
        """Create a publisher of the table, and wait for its subscribers before the start."""
        entry, name = self.entry(topic, leg), self._name(topic, leg)
        quality = qos(PUBLISHED_DEPTH, self._lasts(entry, latched))
        publisher = self.create_publisher(message_class(entry.type), name, quality)
        if len(self._owners(topic, leg)) == 1 and entry.subscribers:
            self.ownership.publishes(publisher.topic_name)
        count = len(entry.subscribers)
        if not latched:  # who comes later gets it too
            there = lambda: publisher.get_subscription_count() >= count  # noqa: E731
            self.barrier.await_peer(f"a listener on {name}", there)
        return publisher

    def entry(self, topic: str, leg: str) -> Topic:
        """Return a topic of a leg's table."""
        return self._tables.get(leg, self.topics)[topic]

    def publish_numbers(self, topic: str, *examples: Any, leg: str = "") -> Callable[..., None]:
        """Create a publisher of the table for messages like these; return `send(stamp_ns, *numbers)`.

        The numbers are those of type float64 in the order of the message; as many belong to one example.
        """
        outlet, kind = Outlet(self.publish_to(topic, leg=leg)), self.entry(topic, leg).type
        self.outlets.append(outlet)
        made = [Template(serialize_message(example), kind) for example in examples]
        templates, send = {template.count: template for template in made}, outlet.send
        return lambda stamp_ns, *numbers: send(templates[len(numbers)](stamp_ns, *numbers))

    def listen_to_numbers(
        self, topic: str, fields: Sequence[str], callback: Callable[[int, Numbers], None], **options: Any
    ) -> None:
        """Listen to a topic of the table; call `callback(stamp_ns, numbers)` with these of its fields.

        A number that a message lacks is NaN, which guards take care of. A slow node passes over what is
        between its steps unread, where it knows these instants beforehand.
        """
        own_ns = self.period_ns if self.is_lockstep() and self.period_ns > self.control_ns else 0
        read = Reader(self.entry(topic, options.get("leg", "")).type, fields)

        def receive(data: bytes) -> None:
            try:
                if own_ns and read.stamp_ns(data) % own_ns:
                    return
                stamp_ns, numbers = read(data)
            except Unreadable:
                self.unreadable += 1
            else:
                callback(stamp_ns, numbers)

        self.listen_to(topic, receive, raw=True, **options)

    def listen_to(
        self, topic: str, callback: Callable[[Any], None], leg: str = "", **options: Any
    ) -> Subscription:
        """Subscribe to a topic of the table, and wait for its publishers before the start.

        Options are `depth`, `latched` (quality of service), `raw` (serialised messages) and `near`, which
        takes raw messages instead that come from this process, with zeros for padding. In real time the
        measurements are taken as they come, as from any sensor, once all peers are there.
        """
        entry, name, raw = self.entry(topic, leg), self._name(topic, leg), options.pop("raw", False)
        near = options.pop("near", callback)
        if self.realtime and entry.rate == "step":
            options["reliable"] = PLANT not in entry.producers
        if self.role == RECORDER:  # it records what comes until all have ended
            pass
        elif entry.rate == "step":
            most = 0 if self.realtime else options.get("depth", QUEUE_DEPTH)
            callback, near = (self._while_active(each, most) for each in (callback, near))
        else:
            callback, near = self._unless_failed(callback), self._unless_failed(near)
        count, awaited = len(entry.producers), not options.pop("latched", False)
        kind, quality = message_class(entry.type), qos(latched=self._lasts(entry, not awaited), **options)
        subscribe = partial(self.create_subscription, kind, name, qos_profile=quality, raw=raw)
        if entry.shared:
            subscription = subscribe(callback)
        else:
            met = partial(self.met_stranger, topic, leg)
            back = partial(self._may_come_again, topic)
            subscription = self.ownership.listen(subscribe, callback, self._owners(topic, leg), met, back)
        if raw:
            self.inlets.append((subscription.topic_name, near))
        if awaited:  # what is latched comes by itself
            peer = f"{name} of {' and '.join(entry.producers)}"
            self.barrier.await_peer(peer, lambda: subscription.get_publisher_count() >= count)
        return subscription

    def join_inputs(
        self, inputs: Mapping[str, Sequence[str]], step: Callable[..., None], newest: bool = False
    ) -> Join | HoldingJoin:
        """Listen to topics; call `step(stamp_ns, *fields of each)` once all of an instant are there.

        With `newest`, in real time, a node that is behind skips to the newest measurements: it answers
        fewer samples, not older ones. What they cause downstream then comes no faster than it can.
        What slow nodes say is held until their next instant; `step` then takes as its last argument how
        old that is, s.
        """
        slow = [topic for topic in inputs if self.topics[topic].slow]
        holds = slow and self.every > 1 and self.role not in SLOW
        join = HoldingJoin(inputs, slow, step, self.every * self.control_ns) if holds else Join(inputs, step)
        for topic, fields in inputs.items():
            measured = PLANT in self.topics[topic].producers
            # of so many samples one is of an instant at which a slow node works
            depth = self.every if newest and measured and self.realtime else QUEUE_DEPTH
            self.listen_to_numbers(topic, fields, partial(join.add, topic), depth=depth)
        return join

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

    def _name(self, topic: str, leg: str) -> str:
        """Return the name of a topic of a leg: what other programs use too is common to all legs."""
        return topic if self.entry(topic, leg).shared else in_leg(topic, leg, self.legs)

    def _owners(self, topic: str, leg: str = "") -> tuple[str, ...]:
        """Return who publishes on a topic, by role; in a replay the nodes that are fed say of themselves."""
        of_all = self.settings["replay"] and topic in ("ready", "configuration")
        return self.table.nodes if of_all else self.entry(topic, leg).producers

    def _may_come_again(self, topic: str, nodes: set[str]) -> bool:
        """Whether silent nodes of these names may have been killed."""
        a_driver = not self.settings["with_plant"] and PLANT in self.topics[topic].producers
        return a_driver or nodes <= set(self._owners(topic))

    def _lasts(self, entry: Topic, latched: bool) -> bool:
        """Whether a topic's last messages are kept for who comes again: in lockstep all wait for him."""
        return latched or (self.is_lockstep() and (entry.rate == "step" or entry.name == "recorded"))

    def is_lockstep(self) -> bool:
        """Whether the run begins at the time 0, and goes on when all have answered."""
        return not self.realtime and not self.settings["replay"]

    def _while_active(self, callback: Callable[[Any], None], most: int) -> Callable[[Any], None]:
        """Return a callback that acts upon nothing while the node is not active, or after a failure.

        So many that have come last wait until it is active.
        """
        waiting: deque[Any] = deque(maxlen=most)

        def receive(message: Any) -> None:
            if self.acts:
                callback(message)
            elif not self.failure:
                waiting.append(message)

        def hand_on() -> None:
            while waiting and self.acts:
                callback(waiting.popleft())

        self._held.append(hand_on)
        return receive

    def _unless_failed(self, callback: Callable[[Any], None]) -> Callable[[Any], None]:
        """Return a callback that acts upon nothing once a stranger or another fault has ended the run."""
        return lambda message: None if self.failure else callback(message)
