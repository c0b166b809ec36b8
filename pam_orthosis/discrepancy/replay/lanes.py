# SPDX-License-Identifier: Apache-2.0
"""Recordings cut into stretches that are replayed side by side, as a processor's vectors compute.

Each stretch begins some seconds before the rows that it is for: the observer forgets where it began. What it
has not forgotten there is replayed again, without these, from where the stretch before ended.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LANES = 8  # vectors of the widest kind hold so many numbers
WARM_SECONDS = 3.0
AGREEING = 1e-6  # of a state's largest value where stretches meet: they are one
AGREEING_SLOPES = 1e-4  # the same of its derivatives by parameters

# (rows, first states, results to fill) -> states at the end of the warm-up, and at the end
Pass = Callable[["Lanes", np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Lanes:
    """The rows of a recording, one stretch beside the other.

    Attributes:
        rows: of the recording.
        warm: rows before those that a stretch is for; the first one is for these too.
        length: rows that each is for.
        z: (warm + length, columns, stretches).
    """

    rows: int
    warm: int
    length: int
    z: np.ndarray

    @classmethod
    def cut(cls, z: np.ndarray, warm: int) -> Lanes:
        """Return the rows `z`, (n, columns), side by side; the last one fills what is free at the end."""
        rows, columns = z.shape
        warm = min(warm, rows)
        length = -(-(rows - warm) // LANES)
        whole = np.concatenate([z, np.repeat(z[-1:], warm + LANES * length - rows, axis=0)])
        side_by_side = np.empty((warm + length, columns, LANES))
        for lane in range(LANES):
            side_by_side[:, :, lane] = whole[lane * length : lane * length + warm + length]
        return cls(rows, warm, length, side_by_side)

    @property
    def starts(self) -> np.ndarray:
        """The row at which each stretch begins."""
        return np.minimum(np.arange(LANES) * self.length, self.rows - 1)

    @property
    def nbytes(self) -> int:
        """Of the memory that it takes."""
        return self.z.nbytes

    def at(self, places: np.ndarray) -> np.ndarray:
        """Return some of the rows, (k, columns)."""
        lane = np.maximum(places - self.warm, 0) // max(self.length, 1)
        found: np.ndarray = self.z[places - lane * self.length, :, lane]
        return found

    def joined(self, results: np.ndarray) -> np.ndarray:
        """Return results, (warm + length, count, stretches), as those of the recording, (n, count).

        Each column is in one piece of memory, as filters and products over time want it.
        """
        count = results.shape[1]
        whole = np.empty((count, self.warm + LANES * self.length))
        whole[:, : self.warm] = results[: self.warm, :, 0].T
        rest = whole[:, self.warm :].reshape(count, LANES, self.length)
        rest[:] = results[self.warm :].transpose(1, 2, 0)
        joined: np.ndarray = whole[:, : self.rows].T
        return joined

    def replayed(self, one_pass: Pass, first: np.ndarray, size: int, slopes: int) -> np.ndarray:
        """Return what passes over all stretches at once leave where these agree, (n, size).

        Args:
            one_pass: replays all stretches.
            first: states, (states, stretches), with which they begin.
            size: results of a row.
            slopes: how many of the states, the last ones, are derivatives.
        """
        results = np.empty((self.warm + self.length, size, LANES))
        agreeing = np.full(len(first), AGREEING)
        agreeing[len(first) - slopes :] = AGREEING_SLOPES
        begun, ended = one_pass(self, first, results)
        rest = Lanes(self.rows - self.warm, 0, self.length, self.z[self.warm :])
        for exact in range(1, LANES + 1):  # with each pass one more stretch is
            with np.errstate(invalid="ignore"):
                apart = np.abs(ended[:, :-1] - begun[:, 1:]).max(axis=1)
            agreed = (apart <= agreeing * np.abs(ended).max(axis=1)).all()
            if agreed or not np.isfinite(ended[:, :exact]).all():
                break
            start = np.column_stack([begun[:, :1], ended[:, :-1]])
            begun, ended = one_pass(rest, start, results[self.warm :])
        return self.joined(results)
