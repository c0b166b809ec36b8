# SPDX-License-Identifier: Apache-2.0
"""What belongs together in a table: pressure levels, lengths, runs, repeats."""

import numpy as np

LEVEL_GAP, WIDEST_LEVEL, MOST_LEVELS = 3.0e3, 3.0e4, 30  # Pa, Pa
LENGTH_GAP, WIDEST_LENGTH, MOST_LENGTHS = 2.0e-3, 0.02, 12  # shares of the nominal length
LEAST_REPEATS = 3  # that show how far one differs from the next


def grouped(values: np.ndarray, gap: float, widest: float, most: int) -> np.ndarray:
    """Return the mean of each value's group: values nearer than a gap belong together.

    What was swept, so that a group would be wider than `widest` or there are more than `most`, is cut into
    equal parts.
    """
    member = _gathered(values, gap)
    bins = 8  # of what was swept
    if member.max() >= most or _widths(values, member).max() > widest:
        edges = np.linspace(values.min(), values.max(), bins + 1)[1:-1]
        member = np.unique(np.searchsorted(edges, values), return_inverse=True)[1]
    mean = np.bincount(member, values) / np.bincount(member)
    return np.asarray(mean[member])


def _gathered(values: np.ndarray, gap: float) -> np.ndarray:
    """Return the number of each value's group, in which neighbours are nearer than a gap."""
    order = np.argsort(values, kind="stable")
    member = np.empty(len(values), int)
    member[order] = np.concatenate([[0], np.cumsum(np.diff(values[order]) > gap)])
    return member


def _widths(values: np.ndarray, member: np.ndarray) -> np.ndarray:
    order = np.lexsort((values, member))
    first = np.flatnonzero(np.diff(member[order], prepend=-1))
    last = np.append(first[1:], len(values)) - 1
    return np.asarray(values[order][last] - values[order][first])


def levels(pressure: np.ndarray) -> np.ndarray:
    """Return the pressure level of each row, Pa: measured pressures scatter about it.

    A few rows beside a level are its stragglers: as a level of their own they would weigh as much.
    """
    found = grouped(pressure, LEVEL_GAP, WIDEST_LEVEL, MOST_LEVELS)
    few, near = 0.05, 1.5e4  # of the rows of the level beside, Pa
    level, member, count = np.unique(found, return_inverse=True, return_counts=True)
    beside = (np.abs(level - level[:, None]) < near) & (count[:, None] < few * count)
    level = np.where(beside.any(axis=1), level[np.argmax(beside * count, axis=1)], level)
    return np.asarray(level[member])


def lengths(contraction: np.ndarray, nominal: float) -> np.ndarray:
    """Return the contraction, m, at which each row was held; of a sweep the part that it is in."""
    return grouped(contraction, LENGTH_GAP * nominal, WIDEST_LENGTH * nominal, MOST_LENGTHS)


def points(pressure: np.ndarray, contraction: np.ndarray, nominal: float) -> np.ndarray | None:
    """Return a number for each row, the same at the same pressure and length; None if either was swept."""
    level = _gathered(pressure, LEVEL_GAP)
    length = _gathered(contraction, LENGTH_GAP * nominal)
    if _widths(pressure, level).max() > WIDEST_LEVEL:
        return None
    if _widths(contraction, length).max() > WIDEST_LENGTH * nominal:
        return None
    return numbered(level, length)


def numbered(*keys: np.ndarray) -> np.ndarray:
    """Return a number for each row, the same where all keys are."""
    number = np.zeros(len(keys[0]), np.int32)
    for key in keys:
        values = np.unique(key)
        number = number * len(values) + np.searchsorted(values, key).astype(np.int32)
    return np.searchsorted(np.unique(number), number).astype(np.int32)
