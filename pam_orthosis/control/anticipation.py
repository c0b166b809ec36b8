# SPDX-License-Identifier: Apache-2.0
"""Planning for the instant at which a command acts, where the lag of the valves is known."""

from __future__ import annotations

from pam_orthosis.control import effects
from pam_orthosis.control.trajectory import Reference


class Anticipation:
    """Takes references and estimates ahead to the middle of the period in which a command acts.

    A model without a lag between voltage and spool gives no horizon: nothing is taken ahead.
    """

    def __init__(self, belief):
        self._period = belief.scenario.control_period
        lag = effects.command_lag(belief)
        self.horizon = lag + 0.5 * self._period if lag else 0.0
        self._last: float | None = None
        self._jerk = 0.0

    def reference(self, now: Reference) -> Reference:
        """Return the reference at the horizon by its Taylor series; call it once a step."""
        if self._last is not None:
            self._jerk = (now.acceleration - self._last) / self._period
        self._last = now.acceleration
        q, v, a, j, t = now.angle, now.velocity, now.acceleration, self._jerk, self.horizon
        return Reference(
            q + t * (v + t * (a / 2 + t * j / 6)), v + t * (a + t * j / 2), a + t * j, now.mean_pressure
        )

    def estimate(self, now, reference: Reference, ahead: Reference) -> tuple[float, float, float]:
        """Return the estimate at the horizon: the error goes on at the rate that it has."""
        rate = reference.velocity - now.velocity
        error = reference.angle - now.angle + self.horizon * rate
        return ahead.angle - error, ahead.velocity - rate, now.disturbance
