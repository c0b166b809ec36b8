# SPDX-License-Identifier: Apache-2.0
"""How long nothing has come: time in which the machine stood still is nobody's silence."""

import time

MOST_SECONDS = 1.0  # a look counts for: it is due several times in that


class Silence:
    """The wall time since something was heard, as a timer that looks now and then has seen it."""

    def __init__(self) -> None:
        self.heard()

    def heard(self) -> None:
        """Begin anew."""
        self._looked, self._seconds = time.monotonic(), 0.0

    def look(self) -> float:
        """Return the time without a word up to this look, s."""
        now = time.monotonic()
        self._seconds += min(now - self._looked, MOST_SECONDS)
        self._looked = now
        return self._seconds
