# SPDX-License-Identifier: Apache-2.0
"""Dead time of the emulated hardware between a voltage that comes and the flow into the muscle.

A pure delay of the voltages, to the nanosecond: a change acts within a period of the control, where the
integration has a step that begins at this instant.
"""

from collections import deque
from collections.abc import Iterable

from pam_orthosis.model.rows import Section

NANOSECONDS = 1e9


def computing_ns(parameters: Section) -> int:
    """Return the time from a sample to the voltage that answers it, where nothing measures it, ns."""
    nanoseconds: int = round(parameters.plant.delay.computing * NANOSECONDS)
    return nanoseconds


def line_ns(parameters: Section) -> int:
    """Return the time from a voltage that arrives to its flow into the muscle, ns."""
    delay = parameters.plant.delay
    travel = delay.hose_length * delay.hose_per_metre
    nanoseconds: int = round((delay.converter + delay.valve + travel) * NANOSECONDS)
    return nanoseconds


class Line:
    """Voltages of one valve on their way: each acts so long after it came, until the next one acts."""

    def __init__(self, resting: float, delay_ns: int):
        self.acting = resting
        self._delay_ns = delay_ns
        self._coming: deque[tuple[int, float]] = deque()

    def put(self, value: float, at_ns: int) -> None:
        """Take a voltage that comes at an instant; one that came at the same or a later one is replaced."""
        acts_ns = at_ns + self._delay_ns
        while self._coming and self._coming[-1][0] >= acts_ns:
            self._coming.pop()
        self._coming.append((acts_ns, value))

    def changes(self, end_ns: int) -> Iterable[int]:
        """Return the instants before the end at which the voltage changes."""
        return (instant for instant, _ in self._coming if instant < end_ns)

    def at(self, instant_ns: int) -> float:
        """Return the voltage that acts from an instant on; instants never go back."""
        while self._coming and self._coming[0][0] <= instant_ns:
            self.acting = self._coming.popleft()[1]
        return self.acting
