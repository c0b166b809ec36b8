# SPDX-License-Identifier: Apache-2.0
"""Who may publish on a topic and answer a service of the graph; anybody else is a stranger.

DDS takes anybody at his word, and a message does not say who sent it. But a publisher is matched before
its first message is delivered, so that one publisher too many is noticed before anything that it says is
acted upon. A node that was killed stays known until its lease ends: one of its name that comes while it is
silent takes its place. Where several speak, names alone tell who belongs there.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from typing import TYPE_CHECKING, Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import NodeNameNonExistentError
from rclpy.subscription import Subscription

from pam_orthosis.errors import OrthosisError, RunFailed

if TYPE_CHECKING:
    from pam_orthosis.nodes.topic_node import TopicNode

NAME_SECONDS = 1.0  # at most, until the graph knows which node a stranger's publisher belongs to
PATIENCE_SECONDS = 5.0  # the same for one who may have come again: a starved machine answers late
SILENT_SECONDS = 0.25  # five control periods of the longest kind, after which an owner that speaks is gone
LEASE_SECONDS = 25.0  # at most, until the middleware forgets who was killed: 20 s if nothing else is set

Refuse = Callable[[Callable[[], OrthosisError]], None]


class Ownership:
    """Notices strangers beside the node's inputs, at once, and beside what it publishes and offers, soon.

    `refuse` takes what makes the error that names the stranger.
    """

    def __init__(self, node: TopicNode, refuse: Refuse):
        self._node, self._refuse = node, refuse
        self._topics: list[str] = []
        self._services: list[str] = []
        self._inputs: list[Callable[[], None]] = []
        self._namesakes = 1
        node.wall_timer(0.5, self._look)

    def publishes(self, topic: str) -> None:
        """Note that this node alone publishes on a topic."""
        self._topics.append(topic)

    def offers(self, service: str) -> None:
        """Note that this node alone offers a service."""
        self._services.append(self._node.resolve_service_name(service))

    def absent(self, nodes: Sequence[str]) -> list[str]:
        """Return which of these nodes are not known here, nor in the root as one that serves all legs."""
        here, known = self._node.get_namespace(), self._all_names()
        return [node for node in nodes if not {_joined(node, here), f"/{node}"}.intersection(known)]

    def listen(
        self,
        subscribe: Callable[..., Subscription],
        callback: Callable[[Any], None],
        owners: Collection[str],
        met: Callable[[], None],
        replaceable: Callable[[set[str]], bool],
    ) -> Subscription:
        """Subscribe where nobody but the owners, given by name, may publish.

        `met` is called when somebody else is there, before `callback` gets anything of his. Nodes of
        such names, whom nobody hears any more, were killed if one of the same name comes.

        The executor may hand out a message before the event that its publisher was matched: the count of
        publishers, which the middleware keeps, is asked for at each message. What comes before it is known
        who came again waits.
        """

        def look() -> bool:
            # not the total: one that went and came again, a driver say, is no stranger
            right = place.is_right(count())
            if right is False:
                met()
                self._refuse(lambda: RunFailed(self._publisher_too_many(subscription.topic_name, owners)))
            return right is not None

        def settle() -> None:
            if look() and waiting:
                place.heard = time.monotonic()
                while waiting:
                    callback(waiting.popleft())

        def receive(message: Any) -> None:
            waiting.append(message)
            settle()

        waiting: deque[Any] = deque(maxlen=1000)
        place = _Place(len(owners), replaceable, lambda: self._names(subscription.topic_name))
        self._inputs.append(settle)
        events = SubscriptionEventCallbacks(matched=lambda _status: settle())
        subscription = subscribe(receive, event_callbacks=events)
        count = subscription.handle.get_publisher_count
        return subscription

    def _look(self) -> None:
        """Look for strangers where no message of theirs comes to this node, or just now none."""
        for settle in self._inputs:
            settle()
        node, own = self._node, self._node.get_fully_qualified_name()
        for topic in self._topics:
            if node.count_publishers(topic) > 1 and (others := _without(own, self._publishing(topic))):
                self._refuse_named(f"a stranger publishes on {topic}", others)
        for service in self._services:
            if node.count_services(service) > 1 and (others := _without(own, self._offering(service))):
                self._refuse_named(f"a stranger offers the service {service}", others)
        namesakes = self._all_names().count(own)
        if namesakes > self._namesakes:
            self._refuse(lambda: RunFailed(f"another node has the name {own}"))
        self._namesakes = max(1, namesakes)

    def _refuse_named(self, what: str, others: Sequence[str]) -> None:
        self._refuse(lambda: RunFailed(f"{what}: {', '.join(others)}"))

    def _publisher_too_many(self, topic: str, owners: Collection[str]) -> str:
        """Name who publishes where it should not: a publisher is matched before its node is known."""
        until = time.monotonic() + NAME_SECONDS
        while len(names := self._publishing(topic)) <= len(owners) and time.monotonic() < until:
            time.sleep(0.01)
        what = f"a stranger publishes on {topic}"
        others = [each for each in names if each.rpartition("/")[2] not in owners]
        if len(others) == 1 < len(names) or (others and len(names) - len(others) == len(owners)):
            return f"{what}: {', '.join(others)}"
        return f"{what}: of {', '.join(names)} one does not belong here" if names else what

    def _publishing(self, topic: str) -> list[str]:
        """Return the full names of the nodes that are known to publish on a topic."""
        return sorted(set(self._names(topic)))

    def _names(self, topic: str) -> list[str]:
        """Return the full name of the node of each publisher on a topic that is known."""
        there = self._node.get_publishers_info_by_topic(topic)
        known = [one for one in there if "UNKNOWN" not in one.node_name]
        return [_joined(one.node_name, one.node_namespace) for one in known]

    def _offering(self, service: str) -> list[str]:
        """Return the full names of the nodes that are known to offer a service."""
        nodes = set(self._node.get_node_names_and_namespaces())
        return sorted(_joined(*each) for each in nodes if service in self._services_of(*each))

    def _services_of(self, name: str, namespace: str) -> set[str]:
        try:
            return {one for one, _ in self._node.get_service_names_and_types_by_node(name, namespace)}
        except NodeNameNonExistentError:  # it has just gone
            return set()

    def _all_names(self) -> list[str]:
        return [_joined(*each) for each in self._node.get_node_names_and_namespaces()]


def _without(own: str, names: Sequence[str]) -> list[str]:
    return [name for name in names if name != own]


def _joined(name: str, namespace: str) -> str:
    return f"{namespace.rstrip('/')}/{name}"


class _Place:
    """Whether those who publish on a topic are its owners, some perhaps twice: killed, and back."""

    def __init__(
        self, most: int, replaceable: Callable[[set[str]], bool], names: Callable[[], Sequence[str]]
    ):
        self._most, self._replaceable, self._names = most, replaceable, names
        self._granted, self._until = most, 0.0
        self._since: float | None = None  # somebody is there whose name is not known yet
        self.heard = -SILENT_SECONDS

    def is_right(self, count: int) -> bool | None:
        """Whether so many publishers belong there; None: not known yet."""
        if count <= self._most:
            self._granted, self._since = self._most, None
            return True
        if count <= self._granted and time.monotonic() < self._until:
            return True
        if again := self._is_taken_again(count):
            self._granted, self._until, self._since = count, time.monotonic() + LEASE_SECONDS, None
        return again

    def _is_taken_again(self, count: int) -> bool | None:
        """Whether its one owner is silent, and no more different nodes are there than belong there."""
        now = time.monotonic()
        if self._since is None:
            if self._most == 1 and now - self.heard < SILENT_SECONDS:
                return False
            self._since = now
        names = self._names()
        if len(names) < count:
            return None if now - self._since < PATIENCE_SECONDS else False
        nodes = {name.rpartition("/")[2] for name in names}
        return len(set(names)) <= self._most and self._replaceable(nodes)
