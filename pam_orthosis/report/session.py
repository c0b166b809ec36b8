# SPDX-License-Identifier: Apache-2.0
"""What a session shows: the person's share, the path and the range of each stride and leg."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.bag.session import Recorded, read_session
from pam_orthosis.control.activity import shares

Array = NDArray[np.float64]


class Strides(NamedTuple):
    """Of one leg, a value each stride: the person's share and its standard error, degrees off and moved."""

    share: Array
    error: Array
    off: Array
    range: Array

    def of(self, chosen: Sequence[int]) -> Strides:
        """Return some of them."""
        return Strides(*(one[list(chosen)] for one in self))


class Shown(NamedTuple):
    """A session and the strides of each leg."""

    session: Recorded
    legs: dict[str, Strides]

    @property
    def minutes(self) -> float:
        """How long it took."""
        return float(next(iter(self.session.signals.values()))["time"][-1]) / 60

    def stage(self, number: int) -> list[int]:
        """Return the strides of a stage."""
        return [index for index, one in enumerate(self.session.strides) if one.stage == number]


def shown(path: Path) -> Shown:
    """Read a session; OrthosisError if the bag is none."""
    session = read_session(path)
    return Shown(session, {leg: _strides(session, leg) for leg in session.signals})


def _strides(session: Recorded, leg: str) -> Strides:
    signals, parameters = session.signals[leg], session.parameters[leg]
    name = parameters.declared.coordinate.name
    spans = [(one.first, one.end) for one in session.strides]
    found = shares(signals, parameters, spans)
    error, place = np.degrees(signals[f"reference_{name}"] - signals[name]), np.degrees(signals[name])
    return Strides(
        np.array([one.share for one in found]),
        np.array([one.error for one in found]),
        np.array([np.abs(error[first:end]).max() for first, end in spans]),
        np.array([np.ptp(place[first:end]) for first, end in spans]),
    )
