# SPDX-License-Identifier: Apache-2.0
"""The hidden plant's load and how its actuators move it, compiled by numba: part of `physics`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from numba import njit

if TYPE_CHECKING:
    import numpy as np

    from pam_orthosis.testing.quantities import Apparatus, Hidden, Maps

# inlining matters: the sets of parameters are passed by value
compiled = njit(cache=True, error_model="numpy", forceinline=True)


@compiled
def clip(x: float, low: float, high: float) -> float:
    """Return x within limits."""
    return min(max(x, low), high)


@compiled
def dragged(follower: float, leader: float, play: float) -> float:
    """Return where a leader takes what follows it with a play (half width)."""
    return clip(follower, leader - play, leader + play)


@compiled
def between(table: np.ndarray, row: int, q: float, a: Apparatus) -> float:
    """Return the value of a row of a table over the coordinate, by linear interpolation."""
    place = clip((q - a.table_start) / a.table_step, 0.0, table.shape[1] - 1.001)
    k = int(place)
    value: float = table[row, k] + (place - k) * (table[row, k + 1] - table[row, k])
    return value


@compiled
def load_terms(q: float, a: Apparatus, h: Hidden, load: np.ndarray) -> tuple[float, float, float]:
    """Return inertia, its slope and what pulls back (gravity, springs) at a coordinate."""
    m, s, g = between(load, 0, q, a), between(load, 1, q, a), between(load, 2, q, a)
    if h.foot_mass != 0.0:
        m += h.foot_mass * between(load, 3, q, a)
        s += h.foot_mass * between(load, 4, q, a)
        g += h.foot_mass * between(load, 5, q, a)
    return m, s, g


@compiled
def strokes(q: float, w: float, a: Apparatus, maps: Maps) -> tuple[float, float, float, float]:
    """Return the contractions of both actuators and their rates at a coordinate that moves at w."""
    if maps.strokes.shape[1] == 0:
        wound = a.radius * (q - a.symmetric_angle)
        first, second = a.symmetric_contraction - wound, a.symmetric_contraction + wound
        return first, second, -a.radius * w, a.radius * w
    first, second = between(maps.strokes, 0, q, a), between(maps.strokes, 2, q, a)
    return first, second, between(maps.strokes, 1, q, a) * w, between(maps.strokes, 3, q, a) * w


@compiled
def pulled(first: float, second: float, q: float, a: Apparatus, maps: Maps) -> float:
    """Return the torque or force of both tensions, N, by virtual work."""
    if maps.strokes.shape[1] == 0:
        return a.radius * (second - first)
    return first * between(maps.strokes, 1, q, a) + second * between(maps.strokes, 3, q, a)


@compiled
def stops(q: float, w: float, a: Apparatus) -> float:
    """Return the torque or force of the soft ends of the range."""
    if q < a.stop_low:
        return max((a.stop_low - q) * (a.stop_stiffness - a.stop_damping * w), 0.0)
    if q > a.stop_high:
        return -max((q - a.stop_high) * (a.stop_stiffness + a.stop_damping * w), 0.0)
    return 0.0


@compiled
def sprocket(q: float, w: float, wheel: float, h: Hidden) -> tuple[float, float]:
    """Return angle and rate of the sprocket behind the play."""
    if h.play == 0.0:
        return q, w
    lost = q - wheel
    edge = h.play - 1e-12  # the wheel was put on the edge with a rounding error
    drags = (lost >= edge and w > 0) or (lost <= -edge and w < 0)
    return dragged(wheel, q, h.play), w if drags else 0.0
