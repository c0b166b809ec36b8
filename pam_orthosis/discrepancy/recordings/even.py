# SPDX-License-Identifier: Apache-2.0
"""Samples at uniform instants: a few missing rows are bridged, jitter is resampled, a longer gap cuts.

Rows in which an input leaps cannot be bridged: nothing says when it did, and pressures follow at once.
"""

import itertools
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from pam_orthosis.errors import OrthosisError

UNIFORM = 0.01  # of the period: stamps nearer to it are uniform
ON_GRID = 0.2  # of the period: rows are missing between stamps that are this near to whole periods
MOST_BRIDGED = 5  # rows in succession; a longer gap cuts
MOST_TOLD = 3  # gaps of one kind
MOST_MISSING = 0.05  # of all rows
MOST_EMPTY = 0.5  # of all rows, with an empty cell
LEAP = 0.1, 3.0  # of an input's range, of what all but a hundredth of its steps stay below
CUT = "parts the longest"  # what is said of a recording of which a part is used
UNEVEN_SHARE = 0.2  # of the steps: beyond it the stamps say nothing of a period
_REPEATED = "repeats", "leave out rows that are there twice, or write stamps with more digits"
_BACK = "goes back behind", "sort the rows, or give what follows as a recording of its own"

Signals = Mapping[str, np.ndarray]


class Even(NamedTuple):
    """Signals at uniform instants from `start`, s, and how they became so."""

    period: float
    signals: Signals
    start: float
    remarks: tuple[str, ...] = ()


def even(name: str, time: np.ndarray, signals: Signals, held: Collection[str]) -> Even:
    """Return signals at uniform instants.

    Args:
        name: of the recording.
        time: stamps, s.
        signals: name -> samples. A row in which one is NaN is missing.
        held: names of inputs, which keep their value until the next sample where stamps jitter.

    Raises:
        OrthosisError: too few samples, time that does not increase, or too many rows missing.
    """
    time, signals, left_out = _once(time, signals)
    stamps = time[~np.isnan(time)]
    if len(stamps) < 2:
        raise OrthosisError(f"{name}: a recording needs more than {len(stamps)} samples")
    steps = np.diff(stamps)
    period = float(np.median(steps))
    if period <= 0 or (steps <= 0).any():
        at = int(np.argmax(steps <= 0))
        told, remedy = _REPEATED if steps[at] == 0 else _BACK
        raise OrthosisError(f"{name}: time {told} {stamps[at]:.6g} s, in row {at + 2} of numbers; {remedy}")
    time, signals, empty = _complete(name, time, signals)
    lost = (*left_out, *empty)
    steps = np.diff(time)
    if (np.abs(steps - period) <= UNIFORM * period).all():
        return Even(float((time[-1] - time[0]) / len(steps)), signals, 0.0, lost)
    holes = _long_holes(steps / period, {key: signals[key] for key in held if key in signals})
    first, last, words = _longest(time, holes)
    part = {key: values[first:last] for key, values in signals.items()}
    whole, more = _filled(name, time[first:last], part, held, period)
    return Even(whole.period, whole.signals, float(time[first] - time[0]), (*lost, *words, *more))


def _once(time: np.ndarray, signals: Signals) -> tuple[np.ndarray, Signals, tuple[str, ...]]:
    """Return the rows without the few that have the stamp of the row before, and how many have."""
    again = np.diff(time, prepend=np.nan) == 0
    if not 0 < again.mean() <= MOST_MISSING:
        return time, signals, ()
    words = (
        f"{again.sum()} of {len(time)} rows have the stamp of the row before, the first in row"
        f" {int(np.argmax(again)) + 1} of numbers: left out"
    )
    return time[~again], {key: values[~again] for key, values in signals.items()}, (words,)


def _complete(name: str, time: np.ndarray, signals: Signals) -> tuple[np.ndarray, Signals, tuple[str, ...]]:
    """Return the rows without NaN, and how many have one."""
    empty = {key: np.isnan(values) for key, values in {"time": time, **signals}.items()}
    rows = np.any(list(empty.values()), axis=0)
    if not rows.any():
        return time, signals, ()
    most = max(empty, key=lambda key: int(empty[key].sum()))
    words = (
        f"{rows.sum()} of {len(rows)} rows have an empty cell or NaN, most in {most}, the first in row"
        f" {int(np.argmax(rows)) + 1} of numbers"
    )
    if rows.mean() > MOST_EMPTY:
        raise OrthosisError(f"{name}: {words}; at most half may have: fill them, or leave that column out")
    return time[~rows], {key: values[~rows] for key, values in signals.items()}, (f"{words}: missing rows",)


def _long_holes(steps: np.ndarray, inputs: Signals) -> dict[int, str]:
    """Return which steps (n,), in periods, are no bridge, and why: too long, or an input leaps meanwhile."""
    whole = np.round(steps)
    missing = (whole > 1) & (np.abs(steps - whole) <= ON_GRID)
    long = np.flatnonzero(steps > MOST_BRIDGED + 1.5)
    found = dict.fromkeys(long.tolist(), f"more than {MOST_BRIDGED}")
    for name, values in inputs.items():
        moved = np.abs(np.diff(values))
        leaps = missing & (moved > max(LEAP[0] * np.ptp(values), LEAP[1] * np.quantile(moved, 0.99)))
        for at in np.flatnonzero(leaps).tolist():
            found.setdefault(at, f"while {name} leaps")
    return dict(sorted(found.items()))


def _longest(time: np.ndarray, holes: Mapping[int, str]) -> tuple[int, int, list[str]]:
    """Return the longest part between steps that are cut, and what was left out."""
    ends = [0, *(at + 1 for at in holes), len(time)]
    parts = list(itertools.pairwise(ends))
    first, last = max(parts, key=lambda part: part[1] - part[0])
    if len(parts) == 1:
        return first, last, []
    by_reason: dict[str, list[str]] = {}
    for at, why in holes.items():
        by_reason.setdefault(why, []).append(f"{time[at]:.3f}")
    gaps = ", and ".join(
        f"after {', '.join(times[:MOST_TOLD])} s{' and later' * (len(times) > MOST_TOLD)}, {why}"
        for why, times in by_reason.items()
    )
    remarks = (
        f"rows are missing {gaps}: of {len(parts)} {CUT}, {last - first} of {len(time)} rows, is"
        " used; give the others as recordings of their own"
    )
    return first, last, [remarks]


def _filled(
    name: str, time: np.ndarray, signals: Signals, held: Collection[str], period: float
) -> tuple[Even, list[str]]:
    """Return a part without long gaps on a uniform grid, and how it was done."""
    steps = np.diff(time)
    whole = np.maximum(np.round(steps / period), 1.0)
    on_grid = (np.abs(steps - whole * period) <= ON_GRID * period).all()
    missing = int(whole.sum() - len(steps)) if on_grid else _missing(steps, whole, period)
    uneven = np.abs(steps - period) > UNIFORM * period
    _check_stamps(name, missing, float(time[int(np.argmax(whole > 1))]), uneven & ~on_grid, period)
    places = np.concatenate([[0.0], np.cumsum(whole if on_grid else steps / period)])
    grid = np.arange(int(places[-1] + 1e-6) + 1.0)
    latest = np.searchsorted(places, grid + 1e-6) - 1
    filled = {
        key: values[latest] if key in held and not on_grid else np.interp(grid, places, values)
        for key, values in signals.items()
    }
    exact = float((time[-1] - time[0]) / places[-1])
    scattered = int(uneven.sum()) - (int((whole > 1).sum()) if on_grid else missing)
    remarks = []
    if missing:
        most, rows = int(whole.max()) - 1, len(time) + missing
        remarks.append(f"{missing} of {rows} rows are missing, at most {most} in a row: interpolated")
    if scattered > 0 and not on_grid:
        remarks.append(f"{scattered} of {len(steps)} steps are uneven: resampled every {1e3 * exact:.4g} ms")
    elif scattered > 0:
        remarks.append(
            f"{scattered} of {len(steps)} steps are uneven, by {ON_GRID:.0%} at most: taken as even"
        )
    return Even(exact, filled, 0.0), remarks


def _check_stamps(name: str, missing: int, after: float, uneven: np.ndarray, period: float) -> None:
    """Refuse, by OrthosisError, too many missing rows, the first after a time, s, or uneven steps (n,)."""
    told, rows = f"{name} is not uniform in time:", len(uneven) + 1 + missing
    if missing > MOST_MISSING * rows:
        raise OrthosisError(
            f"{told} {missing} of {rows} rows are missing, the first"
            f" after {after:.4f} s; at most {MOST_MISSING:.0%} may be: fill them, or cut them off"
        )
    if uneven.mean() > UNEVEN_SHARE:
        raise OrthosisError(
            f"{told} its stamps jitter, {uneven.sum()} of {len(uneven)} steps are not {1e3 * period:.4g} ms;"
            f" at most {UNEVEN_SHARE:.0%} may differ, or all by {ON_GRID:.0%}: stamp rows when they are"
            " measured, or resample them"
        )


def _missing(steps: np.ndarray, whole: np.ndarray, period: float) -> int:
    """Return how many rows are missing between stamps that jitter: each late one shortens the next step."""
    usual = steps[np.abs(steps - period) <= ON_GRID * period].mean()
    lacking = min(round(float(steps.sum() / usual)), int(whole.sum())) - len(steps)
    return max(0, lacking)
