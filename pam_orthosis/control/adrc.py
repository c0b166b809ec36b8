# SPDX-License-Identifier: Apache-2.0
"""Active disturbance rejection: what differs from a double integrator is estimated as one and cancelled.

Han, "From PID to active disturbance rejection control", IEEE Transactions on Industrial Electronics 56(3),
2009, 900-906; linear, with one bandwidth each for law and extended state observer (Gao, "Scaling and
bandwidth-parameterization based controller tuning", American Control Conference 2003); the observer corrects
by the present sample, its three poles in discrete time (Miklosovic, Radke and Gao, "Discrete implementation
and generalization of the extended state observer", the same conference, 2006).
"""

import math

from pam_orthosis.control.reference import Reference
from pam_orthosis.model.parameters import Parameters


class Adrc:
    """A law of `control.position.controller`, see `peers.Law`."""

    def __init__(self, nominal: Parameters):
        settings, self._period = nominal.control.adrc, nominal.scenario.control_period
        self._bandwidth = settings.bandwidth
        pole = math.exp(-settings.observer_bandwidth * self._period)
        self._gains = (
            1 - pole**3,
            1.5 * (1 - pole) ** 2 * (1 + pole) / self._period,
            (1 - pole) ** 3 / self._period**2,
        )
        self._state = (0.0, 0.0, 0.0)  # position, velocity, acceleration that nobody asked for
        self._given = 0.0

    def begin(self, position: float, velocity: float, held: float) -> None:
        """Begin with the disturbance that a held joint has."""
        self._state, self._given = (position, velocity, -held), held

    def step(
        self,
        position: float,
        velocity: float,
        reference: Reference,
        room: tuple[float, float],
        periods: int,
    ) -> float:
        """Return the asked acceleration, within the room; the velocity is estimated."""
        place, rate, outside = self._observed(position, periods)
        w = self._bandwidth
        wanted = reference.acceleration - outside
        wanted += w**2 * (reference.position - place) + 2 * w * (reference.velocity - rate)
        self._given = float(min(max(wanted, room[0]), room[1]))
        return self._given

    def _observed(self, position: float, periods: int) -> tuple[float, float, float]:
        place, rate, outside = self._state
        time, acceleration = periods * self._period, outside + self._given
        place += time * (rate + 0.5 * time * acceleration)
        rate += time * acceleration
        missed = position - place
        first, second, third = (gain * missed for gain in self._gains)
        self._state = place + first, rate + second, outside + third
        return self._state
