# SPDX-License-Identifier: Apache-2.0
"""How long nothing has come: time in which the machine stood still is nobody's silence."""

import time

# counted of the time between two looks: they are due far more often, the machine stood still for the rest
MOST_SECONDS = 1.0


class Silence:
    """The wall time in which nothing came, as a timer that looks now and then has seen it.

    Attributes:
        broken: whether something has come since the last look; set at each message, it is no call.
    """

    def __init__(self) -> None:
        self.broken = True
        self._looked = self._seconds = 0.0

    def look(self) -> float:
        """Return the time up to this look since the one before which something came last, s."""
        now = time.monotonic()
        self._seconds = 0.0 if self.broken else self._seconds + min(now - self._looked, MOST_SECONDS)
        self.broken, self._looked = False, now
        return self._seconds
