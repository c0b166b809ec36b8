# SPDX-License-Identifier: Apache-2.0
"""What something unknown, added to an equation, would change in a replay, to first order.

An unknown torque moves the replayed angle against the damping and the stiffness that the model has there, and
against the observer. Linear in what is added: a regression can look for it without another simulation.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from pam_orthosis.discrepancy.recordings.data import smoothed
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import Equation, Values

CUTOFF = 40.0  # Hz, of what is taken back from a channel to its equation


@dataclass(frozen=True)
class Injection:
    """The linearised replay of one channel of one run.

    Attributes:
        slopes: (n, s, s), of the rates by the base states of the channel's equation.
        gains: (s,), of the observer.
        place: of the state that the channel measures.
        driven: of the state to whose rate the unknown is added.
        period: s.
    """

    slopes: np.ndarray
    gains: np.ndarray
    place: int
    driven: int
    period: float

    def response(self, added: np.ndarray) -> np.ndarray:
        """Return what columns (n, k), added to the rate, change in the prediction of the channel."""
        n, size = self.slopes.shape[:2]
        step = np.eye(size) + self.period * self.slopes @ (np.eye(size) + 0.5 * self.period * self.slopes)
        pulled = np.eye(size)
        pulled[:, self.place] -= self.period * self.gains
        step = step @ pulled
        # each state less what follows from the one before is what was added: a triangle with few diagonals
        band, right = np.zeros((2 * size, n * size)), np.zeros((n * size, added.shape[1]))
        band[0] = 1.0
        for i, j in np.ndindex(size, size):
            band[size + i - j, j::size] = -step[:, i, j]
        right[size + self.driven :: size] = self.period * added[:-1]
        states, _ = dtbtrs(band, right, uplo="L", diag="U")
        seen: np.ndarray = states[self.place :: size]
        return seen

    def added(self, change: np.ndarray, cutoff: float = CUTOFF) -> np.ndarray:
        """Return what, added to the rate, makes a change (n,) of the prediction below a cutoff, Hz.

        The inverse of `response`.
        """
        y = smoothed(change, self.period, cutoff)
        if self.driven == self.place:
            own = self.slopes[:, self.place, self.place]
            first: np.ndarray = np.gradient(y, self.period) + (self.gains[self.place] - own) * y
            return first
        rate = np.gradient(y, self.period) + self.gains[self.place] * y
        pulled = self.gains[self.driven] * y - self.slopes[:, self.driven, self.place] * y
        second: np.ndarray = (
            np.gradient(rate, self.period) - self.slopes[:, self.driven, self.driven] * rate + pulled
        )
        return second


def injection(replay: Replay, run: Run, equation: Equation, channel: str, values: Values) -> Injection | None:
    """Return the linearised replay of a channel, without effects; None if it shows no state."""
    state = replay.system.channel(channel).state
    if state is None:
        return None
    part = replay.part(equation, channel)
    rates = [rate for rate, of in replay.system.derived.items() if of == state]
    gains = equation.gains[channel]
    count, theta = run.recording.samples, np.array([values[name] for name in part.parameters])
    states = run.states(part, np.arange(count))
    side_by_side = part.slopes(
        states.T, run.data(equation.channels).T, np.tile(theta[:, None], count), run.period, 0.0
    )
    slopes = np.array(side_by_side).reshape(len(part.own), count, len(part.own)).swapaxes(0, 1)
    return Injection(
        slopes,
        np.array([gains.get(name, 0.0) for name in part.own]),
        part.own.index(state),
        part.own.index(rates[0] if rates else state),
        run.period,
    )
