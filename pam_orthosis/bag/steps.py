# SPDX-License-Identifier: Apache-2.0
"""Gather the messages of each instant, and hand them out in one order whatever the arrival was."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from pam_orthosis.bag.topics import BY_NAME, ORDER, RECORDED, Topic, is_health_instant


class Message(NamedTuple):
    """A message as it is recorded: topic of the table, its stamp, its serialised bytes."""

    topic: str
    stamp_ns: int
    data: bytes


def _promised(rate: str) -> int:
    return sum(len(topic.producers) for topic in RECORDED if topic.rate == rate)


_EACH_STEP, _EACH_SECOND = _promised("step"), _promised("1 Hz")


class StepCollector:
    """Messages by instant; an instant leaves when all that the table promises for it have come.

    An instant that stays incomplete leaves when `horizon` later ones are waiting.
    """

    def __init__(self, period_ns: int, horizon: int = 1000):
        self._period_ns = period_ns
        self._horizon = horizon
        self._pending: dict[int, dict[tuple[int, bytes], Message]] = {}
        self.done_ns = -1
        self.duplicates = 0

    def add(self, message: Message) -> None:
        """Keep a message; a second one of the same topic and instant is counted and dropped."""
        key = _key(message)
        if message.stamp_ns <= self.done_ns or key in self._pending.get(message.stamp_ns, ()):
            self.duplicates += 1
        else:
            self._pending.setdefault(message.stamp_ns, {})[key] = message

    def complete(self) -> Iterator[Message]:
        """Hand out, in order of instant and table, all that is complete."""
        while self._pending:
            oldest = min(self._pending)
            whole = len(self._pending[oldest]) >= self._due(oldest)
            if not whole and len(self._pending) <= self._horizon:
                return
            yield from self._leave(oldest)

    def rest(self) -> Iterator[Message]:
        """Hand out what is left, complete or not, in the same order."""
        for stamp_ns in sorted(self._pending):
            yield from self._leave(stamp_ns)

    def missing(self) -> list[Topic]:
        """Return the topics that the oldest incomplete instant lacks, causes before effects."""
        if not self._pending:
            return []
        there = {message.topic for message in self._pending[min(self._pending)].values()}
        return [topic for topic in RECORDED if topic.rate == "step" and topic.name not in there]

    def _leave(self, stamp_ns: int) -> Iterator[Message]:
        instant = self._pending.pop(stamp_ns)
        for key in sorted(instant):
            yield instant[key]
        self.done_ns = max(self.done_ns, stamp_ns)

    def _due(self, stamp_ns: int) -> int:
        return _EACH_STEP + _EACH_SECOND * is_health_instant(stamp_ns, self._period_ns)


def _key(message: Message) -> tuple[int, bytes]:
    """Return the place of a message in its instant: several nodes report their health in one."""
    many = len(BY_NAME[message.topic].producers) > 1
    return ORDER[message.topic], message.data if many else b""
