# SPDX-License-Identifier: Apache-2.0
"""What a bag has in store for the nodes that it is fed to again, instant by instant.

A node is given the inputs of an instant if the bag holds its answer to them: in real time nodes skip
samples, and a node that took others than it did then would answer otherwise.
"""

from bisect import bisect_right
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from pam_orthosis.bag.read import raw_messages, recorded_machine
from pam_orthosis.bag.topics import (
    ANSWERED,
    CLOCK,
    PLANT,
    RECORDER,
    REFERENCE,
    SAMPLE,
    SECOND_NS,
    SLOW,
    TRAJECTORY,
    Topic,
    Topics,
)
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters

TIMES = SAMPLE  # whose stamps are the instants
Messages = Mapping[str, Mapping[int, bytes]]


class Instant(NamedTuple):
    """What is fed at an instant (topic, serialised message), and on which topics an answer is due."""

    stamp_ns: int
    fed: list[tuple[str, bytes]]
    due: list[str]


class Script:
    """Nodes that a bag can be fed to, and what they are fed.

    Args:
        path: bag.
        namespace: of the leg.
        nodes: names of nodes to feed; all that the bag has what it takes for, if none.
        held_ns: for so long what slow nodes say is held, if they are slower than the others.
        beside: optional topics of the nodes' run.
    """

    def __init__(
        self,
        path: Path,
        namespace: str = "",
        nodes: Collection[str] = (),
        held_ns: int = 0,
        beside: Collection[str] = (),
    ):
        table = Topics(recorded_machine(path, namespace))
        run = table.of_run(beside=beside)
        self._topics = {name: topic for name, topic in run.items() if topic.rate == "step"}
        self.messages: Messages = raw_messages(path, [*self._topics, ANSWERED], namespace)
        # joints of one mechanism move together: none of them is there for a plant of its own
        others = (RECORDER, PLANT) if table.machine.coupled else (RECORDER,)
        self.missing = {node: self._missing(node) for node in table.nodes if node not in others}
        served = (node for node, topic in self.missing.items() if not topic)
        self.nodes = tuple(node for node in served if not nodes or node in nodes)
        self._check(path, nodes)
        self._held_ns = held_ns
        self._held = {name for name, topic in self._topics.items() if held_ns and self._is_held(topic)}
        self._answered = {node: self._answered_stamps(node) for node in self.nodes}

    def inputs(self, node: str) -> list[str]:
        """Return the topics that a node hears at each step."""
        return [name for name, topic in self._topics.items() if node in topic.consumers]

    def outputs(self, node: str, recorded: bool = True) -> list[str]:
        """Return the topics on which a node answers, those that the bag holds or the others."""
        made = [name for name, topic in self._topics.items() if node in topic.producers]
        return [name for name in made if bool(self.messages.get(name)) == recorded]

    def fed_topics(self) -> dict[str, int]:
        """Return the topics that are fed, and to how many nodes each."""
        counts = {name: _count(topic, self.nodes) for name, topic in self._topics.items()}
        return {name: count for name, count in counts.items() if count}

    def instants(self) -> Iterator[Instant]:
        """Hand out the instants in order; the message of the clock is for the player to make (b"")."""
        # what is held may be older than the first sample that was recorded
        commands = [self.messages[topic] for topic in self._held]
        for stamp_ns in sorted(set(self.messages[TIMES]).union(*self._answered.values(), *commands)):
            answering = [node for node in self.nodes if stamp_ns in self._answered[node]]
            hearing = [t for name, t in self._topics.items() if _count(t, answering) or name in self._held]
            there = [t.name for t in hearing if t.name == CLOCK or stamp_ns in self.messages[t.name]]
            fed = [(name, b"" if name == CLOCK else self.messages[name][stamp_ns]) for name in there]
            due = [name for node in answering for name in self.outputs(node)]
            yield Instant(stamp_ns, fed, [name for name in due if stamp_ns in self.messages[name]])

    def _missing(self, node: str) -> str:
        """Return the topic that is missing in the bag for a node, none if it has all."""
        if node == PLANT and (self.messages.get(ANSWERED) or 0 not in self.messages.get(TIMES, ())):
            return "a start in lockstep"  # elsewhere the plant's state is not known, nor when it was driven
        needed = [TIMES, *(topic for topic in self.inputs(node) if topic != CLOCK)]
        absent = [topic for topic in needed if not self.messages.get(topic)]
        return absent[0] if absent else "" if self.outputs(node) else "any answer of the node"

    def _answered_stamps(self, node: str) -> set[int]:
        if node == TRAJECTORY:  # it publishes ahead: it hears of each sample from its first message on
            first = min(self.messages[REFERENCE])
            heard = {stamp for stamp in self.messages[TIMES] if stamp >= first}
            return heard | ({first} if self._held_ns else set())  # which gives the steps of slow nodes
        inputs = self.inputs(node)
        held = [topic for topic in inputs if topic in self._held]
        there = [*(t for t in inputs if t not in held), *(t for t in self.outputs(node) if t != CLOCK)]
        answered = self._common(there)
        return answered & self._commanded(self._common(held), answered) if held else answered

    def _common(self, topics: Collection[str]) -> set[int]:
        """Return the stamps that all these topics have."""
        return set.intersection(*(set(self.messages[topic]) for topic in topics))

    def _commanded(self, slow: set[int], stamps: set[int]) -> set[int]:
        """Return the stamps for which one of the slow ones is held."""
        known = sorted(slow)
        newest = {stamp: bisect_right(known, stamp) - 1 for stamp in stamps}
        return {stamp for stamp, i in newest.items() if i >= 0 and stamp - known[i] < self._held_ns}

    def _is_held(self, topic: Topic) -> bool:
        """Whether nodes that are fed hold between the steps of slow nodes what is said on a topic."""
        return topic.slow and _count(topic, set(self.nodes) - set(SLOW)) > 0

    def _check(self, path: Path, nodes: Collection[str]) -> None:
        for node in nodes:
            if node not in self.missing:
                raise OrthosisError(f"no node {node}: choose of {', '.join(self.missing)}")
            if self.missing[node]:
                raise OrthosisError(f"{path} cannot be fed to {node}: {self.missing[node]} is missing in it")
        if not self.nodes:
            lacking = "; ".join(f"{topic} for {node}" for node, topic in self.missing.items())
            raise OrthosisError(f"{path} cannot be fed to any node: {lacking} is missing in it")


def _count(topic: Topic, nodes: Collection[str]) -> int:
    return sum(node in topic.consumers for node in nodes)


def held_ns(parameters: Parameters) -> int:
    """Return for how long what slow nodes say is held, ns; 0 if they are no slower than the others."""
    every = parameters.control.position.every
    return every * round(parameters.scenario.control_period * SECOND_NS) if every > 1 else 0
