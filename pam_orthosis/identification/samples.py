# SPDX-License-Identifier: Apache-2.0
"""What a muscle's identification works on: samples of force, free decays, points of volume."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy import signal

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError

UNEVEN = 0.1  # of the period, by which stamps of a decay may be off
DERIVATIVE_SAMPLES = 9  # of the straight-line filter that differentiates the position


Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Samples:
    """Force samples of one muscle; arrays of equal length (n,).

    Attributes:
        pressure: gauge, Pa.
        contraction: m.
        rate: of the contraction, m/s.
        force: measured, N.
        sigma: standard deviation of the measured force, N (relative weights if unknown).
        level: nominal gauge pressure of the run or table row, Pa.
        serial: number of the run; samples of a run follow each other in time, -1 if they do not.
        sense: 1 where the table says that the muscle shortens or fills, -1 where it is stretched or vents; 0:
            by the rate.
        repeat: number of the repeat of the whole measurement.
    """

    pressure: np.ndarray
    contraction: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    sigma: np.ndarray
    level: np.ndarray
    serial: np.ndarray
    sense: np.ndarray = field(default_factory=lambda: np.zeros(0))  # not given: zero in every row
    repeat: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        for name in ("sense", "repeat"):
            if not len(getattr(self, name)):
                object.__setattr__(self, name, np.zeros(len(self.force)))

    def __len__(self) -> int:
        return len(self.force)

    def where(self, mask: np.ndarray | slice) -> Samples:
        """Return the samples of a mask, or of a slice."""
        return replace(self, **{name: values[mask] for name, values in vars(self).items()})

    @property
    def direction(self) -> np.ndarray:
        """1 where the muscle shortens, -1 where it is stretched, 0 at rest."""
        moving = 2.0e-3  # m/s above which a sample belongs to a direction
        by_rate = np.sign(self.rate) * (np.abs(self.rate) > moving)
        return np.where(self.sense != 0, self.sense, by_rate)


@dataclass(frozen=True)
class Decay:
    """A free oscillation after release: time s, position m, gauge pressure Pa, force N, moved mass kg.

    The force is None where no load cell showed it; `source` is the file that refusals name.
    """

    time: np.ndarray
    position: np.ndarray
    pressure: np.ndarray
    force: np.ndarray | None
    mass: float
    source: str = ""


@dataclass(frozen=True)
class Volumes:
    """Measuring points of the volume: gauge pressure Pa, contraction m, volume m^3; each (n,)."""

    pressure: np.ndarray
    contraction: np.ndarray
    volume: np.ndarray


def check_even(path: Path, stamps: np.ndarray) -> None:
    """Check that a decay has no gaps: its period and its velocity come from the number of samples."""
    steps = np.diff(stamps)
    uneven = np.abs(steps - np.median(steps)) > UNEVEN * np.median(steps)
    if uneven.any():
        at = (stamps[int(np.argmax(uneven))] - stamps[0]) / SECOND_NS
        raise OrthosisError(
            f"{path}: the samples of the decay are not uniform in time, first at {at:.4f} s; record it"
            " without gaps, or leave it out"
        )


def differentiated(position: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return the velocity of evenly stamped positions by local least squares, per second."""
    period = float(np.median(np.diff(stamps))) / SECOND_NS
    return np.asarray(signal.savgol_filter(position, DERIVATIVE_SAMPLES, 2, deriv=1, delta=period))


def joined(kind: type[Kind], parts: Sequence[Kind]) -> Kind:
    """Return the rows of several parts of a kind as one."""
    return kind(
        *(np.concatenate(columns) for columns in zip(*(vars(p).values() for p in parts), strict=True))
    )
