# SPDX-License-Identifier: Apache-2.0
"""How well a motion follows its reference, by series of samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pam_orthosis.bag.read import Series, aligned
from pam_orthosis.bag.topics import SECOND_NS

REST_FRACTION = 0.02
REST_SECONDS = 0.1
CATCH_UP_SECONDS = 2.0  # for a machine whose valves were closed, to be back at its reference


@dataclass(frozen=True)
class Cycle:
    """Tracking within one gait cycle, from 1, or within the rest before it, 0; `start_s` of the run."""

    start_s: float
    max_abs_error: float
    rms_error: float
    number: int


def steady_state_error(stamp_ns: np.ndarray, error: np.ndarray, velocity: np.ndarray) -> float | None:
    """Return the mean |error| (its unit) while the reference rests, None if it never does.

    Args:
        stamp_ns: (n,) stamps.
        error: (n,) tracking error.
        velocity: (n,) velocity of the reference.
    """
    still = rests(stamp_ns, velocity)
    return float(np.abs(np.concatenate([error[rest] for rest in still])).mean()) if still else None


def rests(stamp_ns: np.ndarray, velocity: np.ndarray) -> list[slice]:
    """Return where a reference rests for `REST_SECONDS` and longer, by its velocity at stamps (n,)."""
    still = np.abs(velocity) <= REST_FRACTION * np.abs(velocity).max()
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False]))))
    return [
        slice(start, end)
        for start, end in edges.reshape(-1, 2).tolist()
        if stamp_ns[end - 1] - stamp_ns[start] >= REST_SECONDS * SECOND_NS
    ]


def not_led(stamp_ns: np.ndarray, closed: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return whether nobody leads the machine: valves closed on purpose, or since then not yet caught up.

    Args:
        stamp_ns: (n,) stamps.
        closed: (n,) whether the valves are to stay closed.
        near: (n,) whether it is near its reference.
    """
    free: np.ndarray = closed.copy()
    since_ns: int | None = None
    for index, stamp in enumerate(stamp_ns.tolist()):
        if closed[index]:
            since_ns = stamp
        elif since_ns is not None:
            back = near[index] or stamp - since_ns > CATCH_UP_SECONDS * SECOND_NS
            since_ns = None if back else since_ns
            free[index] = not back
    return free


def velocity_lag(place: Series, velocity: Series) -> float | None:
    """Return the delay (s) of a velocity estimate behind the motion of a measured coordinate.

    The integral of a velocity that lags by d is q(t - d) = q(t) - d q-dot(t) to first order, so d
    is the least-squares slope of q minus that integral over the velocity; offset and drift are
    fitted beside it. No noisy differentiation is needed. None if nothing moves.
    """
    stamps, (q, rate) = aligned(place, velocity)
    if len(stamps) < 4 or np.ptp(rate) == 0.0:
        return None
    time = (stamps - stamps[0]) / SECOND_NS
    integral = np.concatenate(([0.0], np.cumsum(np.diff(time) * (rate[1:] + rate[:-1]) / 2)))
    regressors = np.column_stack([rate, np.ones_like(time), time])
    return float(np.linalg.lstsq(regressors, q - integral, rcond=None)[0][0])


def total_variation_rate(series: Series) -> float:
    """Return the sum of |steps| of a signal per second."""
    span_s = (series.stamp_ns[-1] - series.stamp_ns[0]) / SECOND_NS
    return float(np.abs(np.diff(series.value)).sum() / span_s) if span_s else 0.0


def cycle_table(since_start: np.ndarray, error: np.ndarray, hold_s: float, cycle_s: float) -> list[Cycle]:
    """Return the tracking of the rest at the start, as a whole, and of each cycle, where there are samples.

    Args:
        since_start: (n,) s.
        error: (n,), in the unit that is shown.
        hold_s: duration of the rest.
        cycle_s: duration of a cycle.
    """
    number = np.maximum(np.floor((since_start - hold_s) / cycle_s), -1)
    return [
        Cycle(0.0 if k < 0 else hold_s + k * cycle_s, float(np.abs(part).max()), rms(part), int(k) + 1)
        for k in np.unique(number)
        for part in [error[number == k]]
    ]


def rms(values: np.ndarray) -> float:
    """Return the root of the mean of the squares."""
    return float(np.sqrt(np.mean(values**2)))
