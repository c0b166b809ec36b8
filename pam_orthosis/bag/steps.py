# SPDX-License-Identifier: Apache-2.0
"""Gather the messages of each instant, and hand them out in one order whatever the arrival was."""

from collections.abc import Collection, Iterator, Mapping
from heapq import heappop, heappush
from typing import NamedTuple

from pam_orthosis.bag.topics import SLOW, Topic, is_health_instant


class Message(NamedTuple):
    """A message as it is recorded: topic as the collector's table calls it, stamp, serialised bytes."""

    topic: str
    stamp_ns: int
    data: bytes


class StepCollector:
    """Messages by instant; an instant leaves when all that the table promises for it have come.

    In lockstep an incomplete instant stays: its plant goes no further, and what is stamped much later is
    not of the run.

    Args:
        period_ns: control period.
        topics: table of the run.
        late_ns: in real time an instant leaves at the latest when one so much later is there, complete or
            not, so that little is held back; what comes for it afterwards leaves by itself.
        every: periods from one step of slow nodes to the next. The run begins with one; in real time, where
            that instant is not known, their messages say which instants are theirs.
    """

    def __init__(
        self,
        period_ns: int,
        topics: Mapping[str, Topic],
        late_ns: int | None = None,
        every: int = 1,
    ):
        self._period_ns, self._slow_ns = period_ns, every * period_ns
        self._topics = topics
        self._order = {name: index for index, name in enumerate(self._topics)}
        of_one = [name for name, topic in self._topics.items() if len(topic.producers) == 1]
        self._alone = {name: (self._order[name], b"") for name in of_one}
        self._late_ns = late_ns
        self._newest_ns = -1
        self._left: dict[int, list[tuple[int, bytes]]] = {}  # what came of the last instants in real time
        self._slow = {name for name, topic in self._topics.items() if topic.slow and every > 1}
        self._slow_since_ns = 0 if late_ns is None else None
        own = (False,) if self._slow else (False, True)
        self._each_step = self._promised(own, "step", "answer")
        self._each_second = self._promised(own, "1 Hz")
        self._each_slow_step, self._each_slow_second = (
            self._promised((True,), rate) if self._slow else 0 for rate in ("step", "1 Hz")
        )
        self._pending: dict[int, dict[tuple[int, bytes], Message]] = {}
        self._stamps: list[int] = []  # of what is pending, a heap
        self.done_ns = -1
        self.duplicates = 0

    def add(self, message: Message) -> bool:
        """Keep a message; return whether it may have made something complete.

        A second one of the same topic and instant is counted and dropped.
        """
        topic, stamp_ns, data = message
        # several nodes report their health in one instant
        key = self._alone.get(topic) or (self._order[topic], data)
        instant = self._pending.get(stamp_ns)
        if self._late_ns is None:
            left = stamp_ns <= self.done_ns
        else:
            left = key in self._left.get(stamp_ns, ())
            self._newest_ns = max(self._newest_ns, stamp_ns)
        if left or (instant and key in instant):
            self.duplicates += 1
            return False
        if instant is None:
            heappush(self._stamps, stamp_ns)
            instant = self._pending[stamp_ns] = {}
        instant[key] = message
        if topic in self._slow:
            self._slow_since_ns = stamp_ns
        whole = len(instant) >= self._each_step
        return whole or self._late_ns is not None

    def complete(self, most: int | None = None) -> Iterator[Message]:
        """Hand out, in order of instant and table, what is complete: all, or at most so many instants."""
        left = len(self._stamps) if most is None else min(most, len(self._stamps))
        for _ in range(left):
            oldest = self._stamps[0]
            whole = len(self._pending[oldest]) >= self._due(oldest)
            late = self._late_ns is not None and self._newest_ns - oldest > self._late_ns
            if oldest > self.done_ns and not (whole or late):
                return
            yield from self._leave()

    def overtaken(self) -> Iterator[Message]:
        """Hand out all up to the newest whole instant: who had more to say was lost in between."""
        whole = [each for each in self._stamps if len(self._pending[each]) >= self._due(each)]
        while whole and self._stamps[0] < max(whole):
            yield from self._leave()
        yield from self.complete()

    def rest(self) -> Iterator[Message]:
        """Hand out what is left, complete or not, in the same order."""
        while self._stamps:
            yield from self._leave()

    def missing(self) -> dict[str, Topic]:
        """Return the topics that are missing at the oldest incomplete instant, causes before effects."""
        if not self._stamps:
            return {}
        there = {message.topic for message in self._pending[self._stamps[0]].values()}
        there |= set() if self._is_slow(self._stamps[0]) else self._slow
        return {
            name: topic for name, topic in self._topics.items() if topic.rate == "step" and name not in there
        }

    def _leave(self) -> list[Message]:
        """Hand out the oldest instant."""
        stamp_ns = heappop(self._stamps)
        instant = self._pending.pop(stamp_ns)
        self.done_ns = max(self.done_ns, stamp_ns)
        if self._late_ns is not None:
            self._left.setdefault(stamp_ns, []).extend(instant)
            if len(self._left) > 1000:
                del self._left[next(iter(self._left))]
        return [instant[key] for key in sorted(instant)]

    def _due(self, stamp_ns: int) -> int:
        due = self._each_step + self._each_second * is_health_instant(stamp_ns, self._period_ns)
        if self._slow and self._is_slow(stamp_ns):
            due += self._each_slow_step + self._each_slow_second * is_health_instant(stamp_ns, self._slow_ns)
        return due

    def _is_slow(self, stamp_ns: int) -> bool:
        return self._slow_since_ns is None or (stamp_ns - self._slow_since_ns) % self._slow_ns == 0

    def _promised(self, slow: Collection[bool], *rates: str) -> int:
        """Return how many messages of these rates are slow, or are not; a health report is as its node."""
        some = [topic for topic in self._topics.values() if topic.rate in rates]
        return sum((topic.slow or node in SLOW) in slow for topic in some for node in topic.producers)
