# SPDX-License-Identifier: Apache-2.0
"""What was computed last, kept for the next time: so many, and so large, at most."""

from collections import OrderedDict
from threading import Lock
from typing import Any, Generic, Protocol, TypeVar

MOST_BYTES = 256_000_000  # recordings may be long


class Sized(Protocol):
    """What knows how much memory it takes."""

    @property
    def nbytes(self) -> int:
        """Of the memory that it takes."""


Value = TypeVar("Value", bound=Sized)
Key = tuple[Any, ...]


class Store(Generic[Value]):
    """Values by key; several threads may keep some.

    Args:
        most: values; the oldest ones go first.
    """

    def __init__(self, most: int):
        self._most, self._bytes = most, 0
        self._values: OrderedDict[Key, Value] = OrderedDict()
        self._tidying = Lock()

    def __len__(self) -> int:
        return len(self._values)

    def get(self, key: Key) -> Value | None:
        """Return a value; None if it is not kept."""
        return self._values.get(key)

    def keep(self, key: Key, value: Value) -> Value:
        """Return a value that is kept from now on; of large ones, at least the last one is."""
        with self._tidying:
            self._drop(key)
            self._values[key] = value
            self._bytes += value.nbytes
            while len(self) > self._most or (len(self) > 1 and self._bytes > MOST_BYTES):
                self._drop(next(iter(self._values)))
        return value

    def forget(self, first: Any) -> None:
        """Drop all whose keys begin so."""
        with self._tidying:
            for key in [key for key in self._values if key[0] == first]:
                self._drop(key)

    def _drop(self, key: Key) -> None:
        old = self._values.pop(key, None)
        self._bytes -= 0 if old is None else old.nbytes
