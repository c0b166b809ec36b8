# SPDX-License-Identifier: Apache-2.0
"""Intervals from whole clusters: rows of one run, or of one repeat, are off together.

Hysteresis, creep and a load cell's drift shift all rows of a run alike; as independent rows they would make
intervals far too small. Each cluster is left out in turn (the delete-one-group jackknife).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_orthosis.identification.groups import LEAST_REPEATS, numbered
from pam_orthosis.identification.samples import Samples

REPEATS, RUNS = "repeats", "runs"
RANK_TOLERANCE = 1.0e-9  # of a singular value, relative to the largest (columns of equal norm)


def clusters(s: Samples) -> tuple[str, np.ndarray]:
    """Return the kind and the number of each row's cluster: its repeat, or one way of a level's run."""
    if len(np.unique(s.repeat)) >= LEAST_REPEATS:
        return REPEATS, numbered(s.repeat)
    return RUNS, numbered(s.repeat, s.serial, s.level, s.direction)


def cluster_spread(parts: Sequence[np.ndarray], kind: str) -> np.ndarray | None:
    """Return the standard deviation of each coefficient between clusters; of repeats that of a further one.

    Args:
        parts: of each cluster the rows of B and what they explain, (k, coefficients + 1), or their triangle.
        kind: REPEATS or RUNS.

    None: there are too few clusters, or without one the rest cannot determine the coefficients.
    """
    count = len(parts)
    if count < LEAST_REPEATS:
        return None
    solved = [_solved(np.vstack([*parts[:i], *parts[i + 1 :]])) for i in range(count)]
    if any(one is None for one in solved):
        return None
    deviation = np.array(solved) - np.mean(solved, axis=0)
    variance = (count - 1) / count * np.sum(deviation**2, axis=0)
    # a single repeat scatters `count` times as much as the fit to all, which scatters too
    return np.sqrt(variance * (count + 1 if kind == REPEATS else 1))


def _solved(rows: np.ndarray) -> np.ndarray | None:
    r = np.linalg.qr(rows, mode="r")
    count = rows.shape[1] - 1
    scale = np.linalg.norm(r[:count, :count], axis=0)
    if not scale.all():
        return None
    u, singular, vt = np.linalg.svd(r[:count, :count] / scale)
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        return None
    return vt.T @ (u.T @ r[:count, count] / singular) / scale
