# SPDX-License-Identifier: Apache-2.0
"""Join inputs by stamp: a step is computed when all inputs of its instant are there, once."""

from collections.abc import Callable, Collection, Sequence
from typing import Any


class Join:
    """Calls back with (stamp, *values in the order of `inputs`) for each complete instant.

    Duplicates, and instants older than one already computed, are dropped and counted. Instants for
    which an input never comes are forgotten when more than `horizon` are waiting.
    """

    def __init__(self, inputs: Collection[str], callback: Callable[..., None], horizon: int = 64):
        self._inputs, self._count = tuple(inputs), len(inputs)
        self._callback = callback
        self._horizon = horizon
        self._waiting: dict[int, dict[str, Any]] = {}
        self._done_ns = -1
        self.dropped = 0

    def add(self, name: str, stamp_ns: int, value: Any) -> None:
        """Take an input, and compute if it was the last one of its instant."""
        there = self._waiting.get(stamp_ns, {})
        if stamp_ns <= self._done_ns or name in there:
            self.dropped += 1
            return
        there[name] = value
        self._waiting[stamp_ns] = there
        if len(there) == self._count:
            self._complete(stamp_ns, there)
        elif len(self._waiting) > self._horizon:
            self.dropped += len(self._waiting.pop(min(self._waiting)))

    def missing(self, stamp_ns: int) -> list[str]:
        """Return the inputs that have not come for an instant."""
        return [name for name in self._inputs if name not in self._waiting.get(stamp_ns, {})]

    def _complete(self, stamp_ns: int, values: dict[str, Any]) -> None:
        self._done_ns = stamp_ns
        if len(self._waiting) == 1:
            self._waiting.clear()
        else:
            for old in [stamp for stamp in self._waiting if stamp <= stamp_ns]:
                del self._waiting[old]
        self._callback(stamp_ns, *[values[name] for name in self._inputs])


class HoldingJoin:
    """As `Join`, but some inputs are slow: between their instants they are held.

    The sample of `stamp` goes with the slow inputs of the one slow instant in (stamp - span, stamp], and
    waits for them: which one that is depends on stamps alone, not on what has come. Samples whose slow
    instant never comes are forgotten and, once a step has been done, counted. The callback takes
    (stamp, *values in the order of `inputs`, age of the slow ones in s).
    """

    def __init__(
        self,
        inputs: Collection[str],
        slow: Collection[str],
        callback: Callable[..., None],
        span_ns: int,
        horizon: int = 64,
    ):
        self._inputs, self._slow = tuple(inputs), tuple(slow)
        self._quick = tuple(name for name in inputs if name not in slow)
        gathered = (*self._quick, *self._slow)
        self._places = [gathered.index(name) for name in inputs]
        self._callback, self._span_ns, self._horizon = callback, span_ns, horizon
        self._sampling = Join(self._quick, self._sampled, horizon)
        self._holding = Join(self._slow, self._commanded, horizon)
        self._samples: dict[int, tuple[Any, ...]] = {}
        self._commands: dict[int, tuple[Any, ...]] = {}
        self._begun, self._forgotten = False, 0

    @property
    def dropped(self) -> int:
        """How many inputs came twice or too late, or were of a sample without its slow instant."""
        return self._sampling.dropped + self._holding.dropped + self._forgotten

    def add(self, name: str, stamp_ns: int, value: Any) -> None:
        """Take an input, and compute what it was the last one for."""
        (self._holding if name in self._slow else self._sampling).add(name, stamp_ns, value)

    def _sampled(self, stamp_ns: int, *values: Any) -> None:
        self._samples[stamp_ns] = values
        if len(self._samples) > self._horizon:
            self._forget([min(self._samples)])
        self._compute(stamp_ns)

    def _commanded(self, stamp_ns: int, *values: Any) -> None:
        self._commands[stamp_ns] = values
        if len(self._commands) > self._horizon:
            del self._commands[min(self._commands)]
        for waiting in sorted(self._samples):
            self._compute(waiting)

    def _compute(self, stamp_ns: int) -> None:
        """Compute the step of a sample if what is held for it is there."""
        held_ns = max([each for each in self._commands if each <= stamp_ns], default=None)
        if held_ns is None or stamp_ns - held_ns >= self._span_ns:
            return
        gathered = *self._samples.pop(stamp_ns), *self._commands[held_ns]
        self._forget([each for each in self._samples if each < stamp_ns])
        for old in [each for each in self._commands if each < held_ns]:
            del self._commands[old]
        self._begun = True
        self._callback(stamp_ns, *[gathered[i] for i in self._places], (stamp_ns - held_ns) * 1e-9)

    def _forget(self, stamps: Sequence[int]) -> None:
        for stamp_ns in stamps:
            del self._samples[stamp_ns]
            self._forgotten += self._begun
