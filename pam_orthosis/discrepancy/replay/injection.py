# SPDX-License-Identifier: Apache-2.0
"""What something unknown, added to an equation, would change in a replay, to first order.

An unknown torque moves the replayed angle against the damping and the stiffness that the model has there, and
against the observer. Linear in what is added: a regression can look for it without another simulation.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dtbtrs

from pam_orthosis.discrepancy.recordings.data import smoothed
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import Equation, Names, System, Values

CUTOFF = 40.0  # Hz, of what is taken back from a channel to its equation


@dataclass(frozen=True)
class Injection:
    """The linearised replay of the channels of one run that feel what is added to the rate of a state.

    Attributes:
        slopes: (n, s, s), of the rates by the base states of these channels.
        gains: (s, c), of the observer.
        channels: the c channels; each shows a state.
        columns: (c,), their columns in residuals of the equation.
        places: (c,), of the states that they show.
        rates: place of a state -> that of its rate, where that is a state too.
        driven: of the state to whose rate the unknown is added.
        period: s.
    """

    slopes: np.ndarray
    gains: np.ndarray
    channels: Names
    columns: list[int]
    places: list[int]
    rates: Mapping[int, int]
    driven: int
    period: float

    def response(self, added: np.ndarray) -> dict[str, np.ndarray]:
        """Return what columns (n, k), added to the rate, change in the prediction of each channel, (n, k)."""
        n, size = self.slopes.shape[:2]
        step = np.eye(size) + self.period * self.slopes @ (np.eye(size) + 0.5 * self.period * self.slopes)
        pulled = np.eye(size)
        pulled[:, self.places] -= self.period * self.gains
        step = step @ pulled
        # each state less what follows from the one before is what was added: a triangle with few diagonals
        band, right = np.zeros((2 * size, n * size)), np.zeros((n * size, added.shape[1]))
        band[0] = 1.0
        for i, j in np.ndindex(size, size):
            band[size + i - j, j::size] = -step[:, i, j]
        right[size + self.driven :: size] = self.period * added[:-1]
        states, _ = dtbtrs(band, right, uplo="L", diag="U")
        return {name: states[k::size] for name, k in zip(self.channels, self.places, strict=True)}

    def added(self, changes: np.ndarray, cutoff: float = CUTOFF) -> np.ndarray:
        """Return what, added to the rate, makes changes (n, channels of the equation) of predictions.

        The inverse of `response`, below a cutoff, Hz.
        """
        seen = np.column_stack([smoothed(changes[:, i], self.period, cutoff) for i in self.columns])
        pulled = seen @ self.gains.T
        states = np.zeros_like(pulled)
        states[:, self.places] = seen
        for state, rate in self.rates.items():
            states[:, rate] = np.gradient(states[:, state], self.period) + pulled[:, state]
        own = np.einsum("ns,ns->n", self.slopes[:, self.driven], states)
        found: np.ndarray = np.gradient(states[:, self.driven], self.period) - own + pulled[:, self.driven]
        return found


def injection(replay: Replay, run: Run, equation: Equation, channel: str, values: Values) -> Injection | None:
    """Return the linearised replay for an unknown in a channel, no effects on; None if it shows no state."""
    system = replay.system
    if system.channel(channel).state is None:
        return None
    part = replay.part(equation, channel)
    count, theta = run.recording.samples, np.array([values[name] for name in part.parameters])
    states = run.states(part, np.arange(count))
    side_by_side = part.slopes(
        states.T, run.data(equation.channels).T, np.tile(theta[:, None], count), run.period, 0.0
    )
    slopes = np.array(side_by_side).reshape(len(part.own), count, len(part.own)).swapaxes(0, 1)
    place = {name: k for k, name in enumerate(part.own)}
    rates = {place[of]: place[rate] for rate, of in system.derived.items() if of in place}
    shown = {name: place[str(system.channel(name).state)] for name in part.channels if _shows(system, name)}
    gains = [[equation.gains[name].get(state, 0.0) for name in shown] for state in part.own]
    return Injection(
        slopes,
        np.array(gains),
        tuple(shown),
        [equation.channels.index(name) for name in shown],
        list(shown.values()),
        rates,
        rates.get(shown[channel], shown[channel]),
        run.period,
    )


def _shows(system: System, channel: str) -> bool:
    return system.channel(channel).state is not None
