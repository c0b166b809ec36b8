# SPDX-License-Identifier: Apache-2.0
"""Join inputs by stamp: a step is computed when all inputs of its instant are there, once."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any


class Join:
    """Calls back with (stamp, *values in the order of `inputs`) for each complete instant.

    Duplicates, and instants older than one already computed, are dropped and counted. Instants for
    which an input never comes are forgotten when more than `horizon` are waiting.
    """

    def __init__(self, inputs: Sequence[str], callback: Callable[..., None], horizon: int = 64):
        self._inputs = tuple(inputs)
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
        if len(there) == len(self._inputs):
            self._complete(stamp_ns, there)
        elif len(self._waiting) > self._horizon:
            self.dropped += len(self._waiting.pop(min(self._waiting)))

    def missing(self, stamp_ns: int) -> list[str]:
        """Return the inputs that have not come for an instant."""
        return [name for name in self._inputs if name not in self._waiting.get(stamp_ns, {})]

    def _complete(self, stamp_ns: int, values: dict[str, Any]) -> None:
        self._done_ns = stamp_ns
        for old in [stamp for stamp in self._waiting if stamp <= stamp_ns]:
            self._waiting.pop(old)
        self._callback(stamp_ns, *(values[name] for name in self._inputs))
