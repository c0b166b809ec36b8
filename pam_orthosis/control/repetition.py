# SPDX-License-Identifier: Apache-2.0
"""Repetitive learning of a periodic motion: what went wrong in one stride is corrected in the next."""

import math

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.reference import Motion, Reference
from pam_orthosis.control.trajectory import Trajectory
from pam_orthosis.model.parameters import Parameters


class Repetition:
    """A trajectory whose followed motion is shifted against the error of the last strides.

    The shift over the phase is a Fourier series. After each stride a share of the error's series is added to
    it (type P, after Arimoto 1984), advanced by the loop's lag. What lies above `bandwidth` is left out; the
    shift is bounded, and it begins anew when a stride is much worse than the best one: then somebody else
    walks, or nothing repeats.
    """

    def __init__(self, trajectory: Trajectory, parameters: Parameters):
        self._trajectory, self._settings = trajectory, parameters.control.repetition
        self._orders = np.arange(self._settings.harmonics + 1)
        self._period = parameters.scenario.control_period
        self._best = math.inf
        self._time_ns, self._stride = 0, 0
        self.shift = np.zeros(len(self._orders), complex)
        self._begin()

    def sample(self, time_ns: int) -> Reference:
        """Return the reference at an instant, with the motion that is followed."""
        self._time_ns = time_ns
        wanted, (phase, rate, curvature) = self._trajectory.sample(time_ns), self._trajectory.phase(time_ns)
        turning = 2j * math.pi * self._orders
        waves = self.shift * np.exp(turning * phase)
        shift, slope, bend = (float(np.real((turning**power) @ waves)) for power in (0, 1, 2))
        planned = Motion(
            wanted.position + shift,
            wanted.velocity + slope * rate,
            wanted.acceleration + bend * rate**2 + slope * curvature,
        )
        return wanted._replace(planned=planned)

    def heed(self, position: float) -> None:
        """Take where the joint is at the instant of the last sample; learn at the end of a stride."""
        phase, rate, _ = self._trajectory.phase(self._time_ns)
        stride = math.floor(phase)
        if stride > self._stride:
            self._learn(rate)
            self._stride = stride
            self._begin()
        error = self._trajectory.sample(self._time_ns).position - position
        self._sum += error * np.exp(-2j * math.pi * self._orders * phase) * rate * self._period
        self._power += error**2 * rate * self._period
        self._covered += rate * self._period

    def _learn(self, rate: float) -> None:
        """Add a share of the stride's error to the shift, or begin anew."""
        fewest = 0.9  # of a stride's samples that have to be there
        if self._covered < fewest or self._power > self._settings.reset**2 * self._best:
            self._best = math.inf
            self.shift[:] = 0
            return
        self._best = min(self._best, self._power)
        ahead = np.exp(2j * math.pi * self._orders * rate * self._settings.lead)
        series = self._sum * np.where(self._orders, 2.0, 1.0) / self._covered
        low = self._orders * rate <= self._settings.bandwidth
        self.shift = np.where(low, self.shift + self._settings.gain * ahead * series, 0.0)
        most = float(np.abs(self.shift).sum())
        self.shift *= min(1.0, self._settings.limit / most) if most else 1.0

    def _begin(self) -> None:
        self._sum: NDArray[np.complex128] = np.zeros(len(self._orders), complex)
        self._power = self._covered = 0.0
