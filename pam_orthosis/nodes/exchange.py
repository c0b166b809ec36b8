# SPDX-License-Identifier: Apache-2.0
"""Messages between nodes of one process, handed on without the middleware while nobody else listens."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rclpy.executors import Executor
    from rclpy.publisher import Publisher

AT_ONCE = 64  # messages, some steps, in one turn of the executor: timers, services and others have theirs

Listener = Callable[[bytes], None]


class Outlet:
    """Sends serialised messages of a topic: straight to the listeners in its process, or to all who listen.

    Each message goes one of the two ways, so that none comes twice. From the turn on in which the middleware
    knows of a listener elsewhere (`ros2 topic echo`, a recorder, a node in a process of its own) it carries
    them all, to those in this process too.
    """

    def __init__(self, publisher: Publisher):
        self.topic = publisher.topic_name
        self._publisher = publisher
        self._count = publisher.handle.get_subscription_count  # rclpy's own method takes twice as long
        self._listeners: Sequence[Listener] = ()
        self._exchange: Exchange | None = None
        self._alone, self._turn = False, -1

    def connect(self, listeners: Sequence[Listener], exchange: Exchange) -> None:
        """Know all listeners of the topic in this process, and who hands messages to them."""
        self._listeners, self._exchange = listeners, exchange

    def send(self, data: bytes) -> None:
        """Send a message."""
        exchange = self._exchange
        if exchange and self._listeners and self._is_alone(exchange.turn):
            exchange.post(self._listeners, data)
        else:
            self._publisher.publish(data)

    def _is_alone(self, turn: int) -> bool:
        """Return whether nobody else listens; that nobody does holds for a turn of the exchange."""
        if not self._alone or self._turn != turn:
            self._turn = turn
            self._alone = self._count() == len(self._listeners)
        return self._alone


class Exchange:
    """Hands messages to their listeners in the order of sending, each behind the present callback.

    `fail` takes what a listener raised: it must not leave a task, of which the events executor of Jazzy dies
    (ros2/rclpy, issue 1641). `turn` is the number of the turn in which messages are handed on.
    """

    def __init__(self, executor: Executor, fail: Callable[[Exception], None]):
        self._executor, self._fail = executor, fail
        self._waiting: deque[tuple[Sequence[Listener], bytes]] = deque()
        self._due = False
        self.turn = 0

    def connect(self, outlets: Iterable[Outlet], inlets: Iterable[tuple[str, Listener]]) -> None:
        """Join what is sent to the listeners, each given with its topic's full name."""
        listening: dict[str, list[Listener]] = defaultdict(list)
        for topic, listener in inlets:
            listening[topic].append(listener)
        for outlet in outlets:
            outlet.connect(listening[outlet.topic], self)

    def post(self, listeners: Sequence[Listener], data: bytes) -> None:
        """Have a message handed on."""
        self._waiting.append((listeners, data))
        if not self._due:
            self._due = True
            self._executor.create_task(self._hand_on)

    def _hand_on(self) -> None:
        waiting = self._waiting
        self.turn += 1
        try:
            for _ in range(AT_ONCE):
                if not waiting:
                    break
                listeners, data = waiting.popleft()
                for listener in listeners:
                    listener(data)
        except Exception as error:
            self._fail(error)
        self._due = bool(waiting)
        if waiting:
            self._executor.create_task(self._hand_on)
