# SPDX-License-Identifier: Apache-2.0
"""A reference that waits: it goes on by its phase, and no further than a slow person lets it."""

from pam_orthosis.control.diagnostic import Experiment
from pam_orthosis.control.reference import Reference
from pam_orthosis.control.trajectory import Trajectory
from pam_orthosis.model.parameters import Parameters


class Waiting:
    """A trajectory whose time goes slower while the joint lags behind it, and stands still where it must.

    At the edge of the tunnel it begins to slow down, at `patience` times its width it stands. A joint that
    runs ahead is not followed. The pace changes smoothly, within `pace_time`.
    """

    def __init__(self, trajectory: Trajectory | Experiment, parameters: Parameters):
        self._trajectory, settings = trajectory, parameters.control.cooperation
        self._tunnel, self._patience = settings.tunnel, settings.patience
        self._pace_time = settings.pace_time
        self._own_ns, self._last_ns, self._lag = 0.0, 0, 0.0
        self.pace = 1.0

    def heed(self, position: float) -> None:
        """Take where the joint is, rad or m, at the instant of the last sample."""
        reference = self._trajectory.sample(round(self._own_ns))
        error = reference.position - position
        self._lag = error if reference.velocity >= 0 else -error

    def sample(self, time_ns: int) -> Reference:
        """Return the reference at an instant, ns; instants never go back."""
        passed, self._last_ns = time_ns - self._last_ns, time_ns
        before = self.pace
        wanted = 1 - (self._lag - self._tunnel) / (self._tunnel * (self._patience - 1))
        share = min(1.0, passed * 1e-9 / self._pace_time)
        self.pace += share * (min(max(wanted, 0.0), 1.0) - self.pace)
        self._own_ns += passed * 0.5 * (before + self.pace)
        change = (self.pace - before) / (passed * 1e-9) if passed else 0.0
        now = self._trajectory.sample(round(self._own_ns))
        return now._replace(
            velocity=now.velocity * self.pace,
            acceleration=now.acceleration * self.pace**2 + now.velocity * change,
        )
