# SPDX-License-Identifier: Apache-2.0
"""Planning for the instant at which a command acts, where the lag of the valves is known."""

import math
from collections import deque
from collections.abc import Iterator

from pam_orthosis.control import effects
from pam_orthosis.control.observer import Estimate
from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import Parameters


class Pending:
    """Commands on their way: given, each for a period, but not yet acting for the time of a lag."""

    def __init__(self, lag: float, period: float):
        self._lag, self._period = lag, period
        self._values: deque[float] = deque(maxlen=math.ceil(lag / period) if lag else 0)

    def note(self, value: float) -> None:
        """Take the command of this step."""
        self._values.appendleft(value)

    def clear(self) -> None:
        """Forget all commands."""
        self._values.clear()

    def hold(self, periods: int) -> None:
        """Have the last command given for so many periods instead of one: it was, if samples were missed."""
        for value in list(self._values)[:1]:
            self._values.extendleft([value] * (periods - 1))

    def __iter__(self) -> Iterator[tuple[float, float, float]]:
        """Yield commands of earlier steps: value, how long it will act within the lag, middle of that, s."""
        for index, value in enumerate(self._values, start=1):
            begin = self._lag - index * self._period
            first, last = max(0.0, begin), begin + self._period
            yield value, last - first, 0.5 * (first + last)


class Anticipation:
    """Takes references and estimates ahead to the middle of the period in which a command acts.

    A model without a lag between voltage and spool gives no horizon: nothing is taken ahead. With one, the
    error is what it will be once the commands on their way have acted, so that the law meets the error
    that it would meet without the lag (predictor of Smith and Artstein), as far as the model is right.
    """

    def __init__(self, nominal: Parameters):
        self._period = nominal.scenario.control_period
        lag = effects.command_lag(nominal)
        self._pending = Pending(lag, self._period)
        self.horizon = lag + 0.5 * self._period if lag else 0.0
        self._last: float | None = None
        self._jerk = 0.0

    def restart(self) -> None:
        """Begin anew with the next reference."""
        self._pending.clear()
        self._last, self._jerk = None, 0.0

    def reference(self, now: Reference, periods: int = 1) -> Reference:
        """Return the reference at the horizon by its Taylor series; call it once a step.

        The step is so many periods later than the last one.
        """
        self._pending.hold(periods)
        if self._last is not None:
            self._jerk = (now.acceleration - self._last) / (periods * self._period)
        self._last = now.acceleration
        q, v, a, j, t = now.position, now.velocity, now.acceleration, self._jerk, self.horizon
        return Reference(
            q + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j, now.mean_pressure,
            beside=now.beside,
        )  # fmt: skip

    def estimate(self, now: Estimate, reference: Reference, ahead: Reference) -> tuple[float, float, float]:
        """Return the estimate at the horizon; without a command the error goes on at its rate."""
        rate = reference.velocity - now.velocity
        error = reference.position - now.position + self.horizon * rate
        for correction, duration, middle in self._pending:
            rate -= correction * duration
            error -= correction * duration * (self.horizon - middle)
        return ahead.position - error, ahead.velocity - rate, now.disturbance

    def note(self, correction: float) -> None:
        """Take by how much the acceleration that was asked for is beyond that of the reference."""
        self._pending.note(correction)
