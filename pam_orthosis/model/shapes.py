# SPDX-License-Identifier: Apache-2.0
"""Periodic shapes of a motion over the phase of its cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pam_orthosis.model.parameters import Parameters


# phase of the cycle -> value and its first two derivatives by the phase
Shape = Callable[[float], tuple[float, float, float]]


def smooth_step(time: float, ramp: float) -> tuple[float, float, float]:
    """Return integral, value and derivative of a quintic step from 0 to 1 within `ramp`, s."""
    if time <= 0:
        return 0.0, 0.0, 0.0
    if time >= ramp:
        return time - 0.5 * ramp, 1.0, 0.0
    s = time / ramp
    covered = ramp * (2.5 * s**4 - 3 * s**5 + s**6)
    cadence = 10 * s**3 - 15 * s**4 + 6 * s**5
    return covered, cadence, (30 * s**2 - 60 * s**3 + 30 * s**4) / ramp


def quintic(s: float) -> tuple[float, float, float]:
    """Return a smooth step from 0 to 1 over 0 <= s <= 1 and its first two derivatives."""
    return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)


def fourier_shape(cosine: Sequence[float], sine: Sequence[float]) -> Shape:
    """Return the shape of a Fourier series; coefficients by harmonic, the mean first.

    Summed one by one: the last bits of a library's scalar product depend on the processor.
    """
    rows = [(2 * math.pi * n, float(a), float(b)) for n, (a, b) in enumerate(zip(cosine, sine, strict=True))]
    terms = [(w, a, b, w * b, w * a, -(w**2 * a), w**2 * b) for w, a, b in rows]

    def shape(phase: float) -> tuple[float, float, float]:
        value_c = value_s = slope_c = slope_s = bend_c = bend_s = 0.0
        for order, a, b, da, db, dda, ddb in terms:
            c, s = math.cos(order * phase), math.sin(order * phase)
            value_c += a * c
            value_s += b * s
            slope_c += da * c
            slope_s += db * s
            bend_c += dda * c
            bend_s += ddb * s
        return value_c + value_s, slope_c - slope_s, bend_c - bend_s

    return shape


def scaled_shape(shape: Shape, rest: float, by: float) -> Shape:
    """Return a shape whose distance from rest is so many times as large."""

    def scaled(phase: float) -> tuple[float, float, float]:
        value, slope, bend = shape(phase)
        return rest + by * (value - rest), by * slope, by * bend

    return shape if by == 1.0 else scaled


def step_shape(low: float, high: float, rise: float) -> Shape:
    """Return the shape of steps up at phase 0 and down at phase 0.5, quintic within the phase `rise`."""

    def shape(phase: float) -> tuple[float, float, float]:
        half, since = divmod(2 * (phase % 1.0), 1.0)
        s = min(0.5 * since / rise, 1.0)
        size = (low - high) if half else (high - low)
        way = size * s**3 * (10 - 15 * s + 6 * s**2)
        slope = 30 * size * s**2 * (1 - s) ** 2 / rise
        return (high if half else low) + way, slope, 60 * size * s * (1 - s) * (1 - 2 * s) / rise**2

    return shape


def scenario_shape(parameters: Parameters) -> Shape:
    """Return the shape that `scenario` asks for; that of rest where it asks for another motion."""
    s = parameters.scenario
    if s.trajectory == "gait":
        return fourier_shape(s.gait.cosine, s.gait.sine)
    if s.trajectory == "sine":
        return fourier_shape([s.sine.centre, 0.0], [0.0, s.sine.amplitude])
    if s.trajectory == "steps":
        return step_shape(s.step.low, s.step.high, s.step.rise / s.cycle_time)
    return fourier_shape([parameters.at(parameters.declared.start)], [0.0])
