# SPDX-License-Identifier: Apache-2.0
"""The messages of a leg in an open bag, as they are today."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from pam_orthosis.bag import earlier_layout, messages
from pam_orthosis.bag.record import message_definition
from pam_orthosis.bag.topics import Signal, resolve
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Section


class LegMessages:
    """The messages of the leg of a namespace; `valve` are the rows of its valves."""

    def __init__(self, reader: Reader, path: Path, namespace: str, valve: Section):
        self._reader, self.path, self._namespace, self.valve = reader, path, namespace, valve
        self._there = {one.topic: one for one in reader.connections}
        self._earlier = earlier_layout.is_earlier(reader.connections)

    def has(self, topic: str) -> bool:
        """Whether the bag holds messages of a topic of the table."""
        return self._name(topic) in self._there

    def missing(self, signal: Signal) -> OrthosisError:
        """Return the error that there is no topic for a signal."""
        what = f"{self.path} has no topic {resolve(signal.topic, self._namespace)}, needed for {signal.name}"
        return OrthosisError(what + _legs_there(self._there))

    def check(self, topic: str, expected: str) -> None:
        """Check that a topic is of the type that is expected; OrthosisError if not."""
        expected = earlier_layout.type_of(topic, expected) if self._earlier else expected
        there, name = self._there[self._name(topic)], f"{self.path}: topic {self._name(topic)}"
        if there.msgtype != expected:
            raise OrthosisError(f"{name} is of type {there.msgtype}, not {expected}")
        if there.digest not in ("", message_definition(expected)[1]):
            raise OrthosisError(f"{name} is of another version of the type {expected}")

    def raw(self, topics: Iterable[str]) -> Iterator[tuple[str, bytes]]:
        """Yield topic and serialised message, in the order of the bag."""
        for topic, connection, data in self._recorded(topics):
            if not (self._earlier and earlier_layout.differs(topic)):
                yield topic, bytes(data)
            elif (message := self._as_today(topic, connection, data)) is not None:
                yield topic, messages.serialised(message.__msgtype__, message)

    def _as_today(self, topic: str, connection: Connection, data: bytes) -> Any:
        message = messages.deserialised(connection.msgtype, data)  # not by the types that the bag declares
        return earlier_layout.as_today(topic, message, self._namespace.strip("/"), self.valve)

    def _recorded(self, topics: Iterable[str]) -> Iterator[tuple[str, Connection, bytes]]:
        wanted: dict[str, list[str]] = defaultdict(list)
        for topic in dict.fromkeys(topics):
            wanted[self._name(topic)].append(topic)
        connections = [one for one in self._reader.connections if one.topic in wanted]
        for connection, _, data in self._reader.messages(connections) if connections else ():
            for topic in wanted[connection.topic]:
                yield topic, connection, data

    def _name(self, topic: str) -> str:
        """Return the name under which a topic is in the bag."""
        return resolve(earlier_layout.name_of(topic) if self._earlier else topic, self._namespace)


def _legs_there(topics: Iterable[str]) -> str:
    """Return the hint that a bag has its legs in namespaces, if it has."""
    legs = sorted(parts[1] for parts in (topic.split("/") for topic in topics) if parts[2:] == ["reference"])
    return f"; it has the legs {', '.join(legs)}: give one by --namespace" if legs else ""
