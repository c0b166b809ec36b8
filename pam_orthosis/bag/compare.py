# SPDX-License-Identifier: Apache-2.0
"""Compare the messages of two bags by topic and stamp: equal to the bit, or how far apart."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_orthosis.bag.cdr import canonical
from pam_orthosis.bag.read import aligned, raw_messages, read_bag, recorded_machine
from pam_orthosis.bag.topics import Signal, Topics

Messages = Mapping[int, bytes]


@dataclass(frozen=True)
class TopicComparison:
    """A topic in two bags.

    `compared` messages have a stamp that both bags hold, `equal` of them are the same to the bit,
    `alone` are in the first bag only. `differences`: signal -> largest |difference|, in its unit.
    """

    topic: str
    compared: int
    equal: int
    alone: int
    differences: Mapping[str, float]

    @property
    def identical(self) -> bool:
        """Whether there is something to compare, and it is equal."""
        return 0 < self.compared == self.equal

    @property
    def whole(self) -> bool:
        """Whether most of what was recorded could be compared."""
        return self.alone <= self.compared


def compare(first: Path, second: Path, topics: Iterable[str], namespace: str = "") -> list[TopicComparison]:
    """Compare topics of two bags, the first's leg in a namespace; OrthosisError if one is unusable."""
    topics, table = list(topics), Topics(recorded_machine(first, namespace))
    recorded = raw_messages(first, topics, namespace)
    other = raw_messages(second, topics, "", table)
    return [
        _comparison(table, topic, (recorded.get(topic, {}), other.get(topic, {})), (first, second, namespace))
        for topic in topics
    ]


def _comparison(
    table: Topics, topic: str, messages: tuple[Messages, Messages], bags: tuple[Path, Path, str]
) -> TopicComparison:
    recorded, other = messages
    shared = recorded.keys() & other.keys()
    kind = table.by_name[topic].type
    equal = sum(canonical(recorded[stamp], kind) == canonical(other[stamp], kind) for stamp in shared)
    signals = [signal for signal in table.signals.values() if signal.topic == topic]
    differences = _differences(signals, *bags) if equal < len(shared) else {}
    return TopicComparison(topic, len(shared), equal, len(recorded) - len(shared), differences)


def _differences(signals: Iterable[Signal], first: Path, second: Path, namespace: str) -> dict[str, float]:
    signals = list(signals)
    one, two = read_bag(first, signals, namespace=namespace), read_bag(second, signals)
    pairs = {signal: aligned(one[signal.name], two[signal.name])[1] for signal in signals}
    return {signal.name: float(np.abs(a - b).max()) for signal, (a, b) in pairs.items()}
