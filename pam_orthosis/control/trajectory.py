# SPDX-License-Identifier: Apache-2.0
"""Reference trajectories: twice differentiable, starting smoothly from rest."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

VALVES_CLOSED = 0.0  # Pa absolute, as a reference pressure: none is wanted, the valve stays closed


class Reference(NamedTuple):
    """Desired knee angle rad, velocity rad/s, acceleration rad/s^2, mean pressure absolute Pa.

    Without a mean pressure the controller takes its own; `VALVES_CLOSED` asks for closed valves.
    """

    angle: float
    velocity: float
    acceleration: float
    mean_pressure: float | None = None


class Trajectory:
    """A periodic shape run through at a cadence that rises smoothly from zero.

    Args:
        shape: cycle phase -> angle and its first two derivatives by the phase, rad.
        cycle_time, hold, ramp: duration of a cycle, of the rest before the motion and of the rise
            of the cadence, s.
        phase: phase of the cycle at rest.
    """

    def __init__(self, shape: Callable, cycle_time: float, hold: float, ramp: float, phase: float):
        self._shape = shape
        self._cycle_time, self._hold, self._ramp, self._start = cycle_time, hold, ramp, phase

    def sample(self, time_ns: int) -> Reference:
        """Return the reference at an instant, nanoseconds since the start."""
        phase, rate, curvature = self._phase(time_ns * 1e-9 - self._hold)
        angle, slope, bend = self._shape(self._start + phase)
        return Reference(angle, slope * rate, bend * rate**2 + slope * curvature)

    def _phase(self, time: float) -> tuple[float, float, float]:
        """Return phase and its two time derivatives; the cadence follows a quintic smooth step."""
        if time <= 0:
            return 0.0, 0.0, 0.0
        if time >= self._ramp:
            return (time - 0.5 * self._ramp) / self._cycle_time, 1 / self._cycle_time, 0.0
        s = time / self._ramp
        covered = self._ramp * (2.5 * s**4 - 3 * s**5 + s**6)
        cadence = 10 * s**3 - 15 * s**4 + 6 * s**5
        growth = (30 * s**2 - 60 * s**3 + 30 * s**4) / self._ramp
        return covered / self._cycle_time, cadence / self._cycle_time, growth / self._cycle_time


def fourier_shape(cosine, sine) -> Callable:
    """Return the shape of a Fourier series; coefficients by harmonic, the mean first, rad."""
    a, b = np.asarray(cosine), np.asarray(sine)
    order = 2 * math.pi * np.arange(len(a))

    def shape(phase: float) -> tuple[float, float, float]:
        c, s = np.cos(order * phase), np.sin(order * phase)
        angle = float(a @ c + b @ s)
        slope = float((order * b) @ c - (order * a) @ s)
        return angle, slope, float(-(order**2 * a) @ c - (order**2 * b) @ s)

    return shape


def make_trajectory(parameters):
    """Return what `scenario` asks for: a `Trajectory` or the programme of a diagnostic experiment."""
    from pam_orthosis.control import diagnostic  # its programmes are made of this module's references

    s = parameters.scenario
    if s.trajectory in diagnostic.EXPERIMENTS:
        return diagnostic.make_programme(s.trajectory, parameters)
    return Trajectory(_shape(s), s.cycle_time, s.start_hold, s.start_ramp, s.start_phase)


def _shape(scenario) -> Callable:
    if scenario.trajectory == "gait":
        return fourier_shape(scenario.gait.cosine, scenario.gait.sine)
    if scenario.trajectory == "sine":
        return fourier_shape([scenario.sine.centre, 0.0], [0.0, scenario.sine.amplitude])
    return fourier_shape([scenario.start_angle], [0.0])
