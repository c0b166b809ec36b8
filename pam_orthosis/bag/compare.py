# SPDX-License-Identifier: Apache-2.0
"""Compare the messages of two bags by topic and stamp: equal to the bit, but for rounding, or how far apart.

On another processor the mathematics library may round sines and exponentials otherwise in the last bit. What
the nodes make of these is up to 7e-15 of a signal's largest value apart.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pam_orthosis.bag.cdr import Unreadable, canonical, split
from pam_orthosis.bag.read import aligned, raw_messages, read_bag, recorded_machine
from pam_orthosis.bag.topics import Signal, Topics

Messages = Mapping[int, bytes]
ROUNDING = 1e-12  # of the largest |value| of a number in its topic: less is rounding


@dataclass(frozen=True)
class TopicComparison:
    """A topic in two bags.

    `compared` messages have a stamp that both bags hold, `equal` of them are the same to the bit,
    `rounded` of them but for rounding; `alone` are in the first bag only. `differences`: signal -> largest
    |difference|, in its unit. `rounding`: largest |difference| of the rounded ones, of the largest |value|.
    """

    topic: str
    compared: int
    equal: int
    rounded: int
    alone: int
    differences: Mapping[str, float]
    rounding: float

    @property
    def identical(self) -> bool:
        """Whether there is something to compare, and it is equal to the bit."""
        return 0 < self.compared == self.equal

    @property
    def same(self) -> bool:
        """Whether there is something to compare, and it is equal but for rounding."""
        return 0 < self.compared == self.equal + self.rounded

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
    pairs = [(canonical(recorded[stamp], kind), canonical(other[stamp], kind)) for stamp in shared]
    apart = [pair for pair in pairs if pair[0] != pair[1]]
    rounded = _rounded(apart, (one for one, _ in pairs), kind) if apart else []
    signals = [signal for signal in table.signals.values() if signal.topic == topic]
    return TopicComparison(
        topic,
        compared=len(shared),
        equal=len(shared) - len(apart),
        rounded=len(rounded),
        alone=len(recorded) - len(shared),
        differences=_differences(signals, *bags) if apart else {},
        rounding=max(rounded, default=0.0),
    )


def _rounded(apart: Iterable[tuple[bytes, bytes]], recorded: Iterable[bytes], kind: str) -> list[float]:
    """Return how far apart those pairs of messages are that differ by rounding, of the largest |value|s."""
    try:
        largest: dict[str, float] = {}
        for data in recorded:
            for path, value in split(data, kind)[1].items():
                largest[path] = max(largest.get(path, 0.0), abs(value))
        found = (_distance(split(one, kind), split(two, kind), largest) for one, two in apart)
        return [distance for distance in found if distance <= ROUNDING]
    except Unreadable:
        return []


def _distance(
    one: tuple[bytes, Mapping[str, float]],
    two: tuple[bytes, Mapping[str, float]],
    largest: Mapping[str, float],
) -> float:
    """Return the largest |difference| of two messages' numbers, each of its largest |value|."""
    (rest, a), (other_rest, b) = one, two
    if rest != other_rest or a.keys() != b.keys():
        return np.inf
    unequal = [path for path in a if a[path] != b[path] and not (np.isnan(a[path]) and np.isnan(b[path]))]
    return max((_share(abs(a[path] - b[path]), largest[path]) for path in unequal), default=0.0)


def _share(difference: float, of: float) -> float:
    return difference / of if np.isfinite(difference) and 0.0 < of < np.inf else np.inf


def _differences(signals: Iterable[Signal], first: Path, second: Path, namespace: str) -> dict[str, float]:
    signals = list(signals)
    one, two = read_bag(first, signals, namespace=namespace), read_bag(second, signals)
    pairs = {signal: aligned(one[signal.name], two[signal.name])[1] for signal in signals}
    return {signal.name: float(np.abs(a - b).max()) for signal, (a, b) in pairs.items()}
