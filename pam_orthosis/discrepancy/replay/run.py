# SPDX-License-Identifier: Apache-2.0
"""A recording prepared for replay: smoothed neighbours, inputs, and how both may be shifted in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from pam_orthosis.discrepancy.recordings.data import Recording, smoothed
from pam_orthosis.discrepancy.systems.cut import Part
from pam_orthosis.discrepancy.systems.system import Names, System, Values

Noise = Mapping[str, np.ndarray]  # channel or input -> samples that are added to it
_SERIAL = count()


@dataclass(frozen=True)
class Shift:
    """How recorded signals are shifted in time for one equation or a part of it, s.

    Attributes:
        own: by how much the own channel shows the past: everything else is shifted back as far.
        inputs: by how much the inputs act late, seen from its own channel; those that are sensed do not.
        advance: neighbour -> by how much it is advanced to be the true one.
        later: input -> by how much more it acts late than the others.
    """

    own: float = 0.0
    inputs: float = 0.0
    advance: Values = field(default_factory=dict)
    later: Values = field(default_factory=dict)

    def key(self) -> tuple[Any, ...]:
        """Return what separates shifts."""
        return self.own, self.inputs, *sorted(self.advance.items()), "later", *sorted(self.later.items())


UNSHIFTED = Shift()


class Run:
    """A recording prepared for replay.

    Args:
        noise: channel or input -> samples added to the recorded ones (to see what noise does).
    """

    def __init__(self, system: System, recording: Recording, cutoff: float, noise: Noise | None = None):
        self.recording, self.period = recording, recording.period
        self.serial = next(_SERIAL)
        noise = noise or {}
        self._system, self._cutoff = system, cutoff
        self._raw = {key: value + noise.get(key, 0.0) for key, value in recording.signals.items()}
        self._smooth = {
            channel.name: smoothed(self._raw[channel.name], self.period, cutoff)
            for channel in system.channels
        }
        self._splines: dict[str, CubicSpline] = {}
        self._inputs = {name: self._raw.get(name, np.zeros(recording.samples)) for name in system.inputs}

    def noisy(self, noise: Noise) -> Run:
        """Return the same run with noise added."""
        return Run(self._system, self.recording, self._cutoff, noise)

    def data(self, own: Names, shift: Shift = UNSHIFTED) -> np.ndarray:
        """Return the rows `z` of a kernel, by the clock of its own channels."""
        neighbours = np.column_stack(
            [
                self._advanced(c.name, 0.0 if c.name in own else shift.advance.get(c.name, 0.0) - shift.own)
                for c in self._system.channels
            ]
        )
        later = np.vstack([neighbours[1:], neighbours[-1:]])
        rows = [self._inputs[name] for name in self._system.inputs]
        recorded = np.array(rows).reshape(len(rows), self.recording.samples).T  # a system may have no input
        count, fraction = divmod(shift.inputs / self.period, 1.0)
        inputs, before = (_held_back(recorded, int(count) + more) for more in (0, 1))
        for i, name in enumerate(self._system.inputs):
            acts = shift.own if name in self._system.sensed else shift.inputs
            late = acts + shift.later.get(name, 0.0)
            if name in self._system.gradual:
                before[:, i], inputs[:, i] = self._between(recorded[:, i], late)
            elif name in shift.later:
                before[:, i] = inputs[:, i] = self._mean(recorded[:, [i]], late)[:, 0]
        time = self.recording.start + np.arange(len(recorded)) * self.period - shift.own
        measured = np.column_stack([self._raw[c.name] for c in self._system.channels])
        bends = self._bends(neighbours)
        fractions = np.full(len(recorded), fraction)
        return np.ascontiguousarray(
            np.column_stack([neighbours, later, before, inputs, time, measured, *bends, fractions])
        )

    def _between(self, values: np.ndarray, late: float) -> tuple[np.ndarray, np.ndarray]:
        """Return an input as it acts at each sample and at the next, so many s later than it was recorded."""
        time = np.arange(len(values)) * self.period
        now, following = (np.interp(time + more - late, time, values) for more in (0.0, self.period))
        return now, following

    def _mean(self, values: np.ndarray, late: float) -> np.ndarray:
        """Return the mean over each period of what is held and acts late: its own instants are not kept."""
        count, fraction = divmod(late / self.period, 1.0)
        now, before = (_held_back(values, int(count) + more) for more in (0, 1))
        return fraction * before + (1 - fraction) * now

    def _bends(self, neighbours: np.ndarray) -> list[np.ndarray]:
        """Return the second difference quotients, each between a sample and the next."""
        of_state = {c.state: i for i, c in enumerate(self._system.channels)}
        places = [of_state[parent] for parent in self._system.derived_twice.values()]
        slopes = [np.gradient(neighbours[:, i], self.period) for i in places]
        return [np.append(np.diff(one), 0.0) / self.period for one in slopes]

    def states(self, part: Part, places: np.ndarray) -> np.ndarray:
        """Return the states at some samples, (k, states): as measured, effect states at rest or as inputs."""
        followed = {state: self._inputs[name] for state, name in self._system.begins.items()}
        signals = {**self.base_states, **followed}
        rest = np.zeros(len(places))
        return np.column_stack([signals[name][places] if name in signals else rest for name in part.own])

    @cached_property
    def base_states(self) -> dict[str, np.ndarray]:
        """Return the base states as smoothed recordings and their difference quotients show them."""
        signals = {c.state: self._smooth[c.name] for c in self._system.channels if c.state is not None}
        for derived, parent in self._system.derived.items():
            slope = np.diff(signals[parent]) / self.period
            signals[derived] = np.append(slope, slope[-1:])
        for bent, parent in self._system.derived_twice.items():
            signals[bent] = np.gradient(np.gradient(signals[parent], self.period), self.period)
        return signals

    def probing(self, count: int) -> np.ndarray:
        """Return samples at which the base states are extreme, and some in between."""
        between = np.linspace(0, self.recording.samples - 1, count).astype(int)
        return np.unique([*self._extreme, *between])

    @cached_property
    def _extreme(self) -> list[int]:
        """The samples at which the base states are extreme."""
        rows = self.base_states.values()
        return [int(end) for row in rows for end in (np.argmin(row), np.argmax(row))]

    def smooth(self, channel: str) -> np.ndarray:
        """Return the smoothed recording of a channel."""
        return self._smooth[channel]

    def roughness(self, channel: str) -> float:
        """Return the sd of what smoothing takes from a channel."""
        return float(np.std(self._raw[channel] - self._smooth[channel]))

    def _advanced(self, name: str, seconds: float) -> np.ndarray:
        values = self._smooth[name]
        if seconds == 0.0:
            return values
        time = np.arange(len(values)) * self.period
        if name not in self._splines:
            self._splines[name] = CubicSpline(time, values)
        advanced: np.ndarray = self._splines[name](np.clip(time + seconds, 0.0, time[-1]))
        return advanced


def _held_back(rows: np.ndarray, count: int) -> np.ndarray:
    """Return rows shifted to later places (a trial may ask for earlier ones); end rows fill what is free."""
    return rows[np.clip(np.arange(len(rows)) - count, 0, len(rows) - 1)]
