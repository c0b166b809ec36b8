# SPDX-License-Identifier: Apache-2.0
"""The hidden plant's load and how its actuators move it, compiled by numba: part of `physics`."""

from numba import njit

# inlining matters: the sets of parameters are passed by value
compiled = njit(cache=True, error_model="numpy", forceinline=True)


@compiled
def clip(x, low, high):
    """Return x within limits."""
    return min(max(x, low), high)


@compiled
def dragged(follower, leader, play):
    """Return where a leader takes what follows it with a play (half width)."""
    return clip(follower, leader - play, leader + play)


@compiled
def between(table, row, q, a):
    """Return the value of a row of a table over the coordinate, by linear interpolation."""
    place = clip((q - a.table_start) / a.table_step, 0.0, table.shape[1] - 1.001)
    k = int(place)
    return table[row, k] + (place - k) * (table[row, k + 1] - table[row, k])


@compiled
def load_terms(q, a, h, load):
    """Return inertia, its slope and what pulls back (gravity, springs) at a coordinate."""
    m, s, g = between(load, 0, q, a), between(load, 1, q, a), between(load, 2, q, a)
    if h.foot_mass != 0.0:
        m += h.foot_mass * between(load, 3, q, a)
        s += h.foot_mass * between(load, 4, q, a)
        g += h.foot_mass * between(load, 5, q, a)
    return m, s, g


@compiled
def strokes(q, w, a, maps):
    """Return the contractions of both actuators and their rates at a coordinate that moves at w."""
    if maps.strokes.shape[1] == 0:
        wound = a.radius * (q - a.symmetric_angle)
        first, second = a.symmetric_contraction - wound, a.symmetric_contraction + wound
        return first, second, -a.radius * w, a.radius * w
    first, second = between(maps.strokes, 0, q, a), between(maps.strokes, 2, q, a)
    return first, second, between(maps.strokes, 1, q, a) * w, between(maps.strokes, 3, q, a) * w


@compiled
def pulled(first, second, q, a, maps):
    """Return the torque or force of both tensions, N, by virtual work."""
    if maps.strokes.shape[1] == 0:
        return a.radius * (second - first)
    return first * between(maps.strokes, 1, q, a) + second * between(maps.strokes, 3, q, a)


@compiled
def stops(q, w, a):
    """Return the torque or force of the soft ends of the range."""
    if q < a.stop_low:
        return max((a.stop_low - q) * (a.stop_stiffness - a.stop_damping * w), 0.0)
    if q > a.stop_high:
        return -max((q - a.stop_high) * (a.stop_stiffness + a.stop_damping * w), 0.0)
    return 0.0


@compiled
def sprocket(q, w, wheel, h):
    """Return angle and rate of the sprocket behind the play."""
    if h.play == 0.0:
        return q, w
    lost = q - wheel
    edge = h.play - 1e-12  # the wheel was put on the edge with a rounding error
    drags = (lost >= edge and w > 0) or (lost <= -edge and w < 0)
    return dragged(wheel, q, h.play), w if drags else 0.0
