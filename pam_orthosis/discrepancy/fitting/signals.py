# SPDX-License-Identifier: Apache-2.0
"""What a recording shows at each instant: signals that a residual may depend on, and splines over them."""

import numpy as np

from pam_orthosis.discrepancy.replay.problem import Scored
from pam_orthosis.discrepancy.systems.system import System

SHORTEST_CYCLE = 0.4  # s
REPEATS = 0.7  # autocorrelation of a signal that repeats itself


def signals_of(system: System, one: Scored) -> dict[str, np.ndarray]:
    """Return what a residual may depend on: channels, inputs, velocities, phase of the cycle, time.

    Behind the recording's warm-up, by the recording's clock; a phase only where the motion repeats itself.
    """
    signals = {c.name: one.run.smooth(c.name)[one.warm_up :] for c in system.channels}
    recorded = one.run.recording.signals
    signals.update((name, recorded[name][one.warm_up :]) for name in system.inputs if name in recorded)
    measured_by = {c.state: c.name for c in system.channels}
    for derived, parent in system.derived.items():
        if parent in measured_by:
            signals[derived] = np.gradient(signals[measured_by[parent]], one.run.period)
    first, period = signals[system.channels[0].name], one.run.period
    passed = round(one.run.recording.start / period) + one.warm_up
    phase = _cycle_phase(first, period, passed)
    if phase is not None:
        signals["phase"] = phase
    signals["time"] = one.run.recording.start + (one.warm_up + np.arange(len(first))) * period
    return signals


def _cycle_phase(signal: np.ndarray, period: float, passed: int) -> np.ndarray | None:
    """Return the phase (0 to 1) of a signal that repeats itself, or None.

    It is 0 at the zero of the recording's clock, so many samples before the signal's first.
    """
    centred = signal - signal.mean()
    power = np.abs(np.fft.rfft(centred, 2 * len(centred))) ** 2
    correlation = np.fft.irfft(power)[: len(centred)]
    correlation = (
        correlation / max(correlation[0], 1e-300) * len(centred) / (len(centred) - np.arange(len(centred)))
    )
    low, high = round(SHORTEST_CYCLE / period), len(centred) // 3
    falls = np.flatnonzero(correlation[:high] < 0)
    if not len(falls) or max(low, falls[0]) >= high:
        return None
    low = max(low, falls[0])
    best = low + int(np.argmax(correlation[low:high]))
    if correlation[best] < REPEATS:
        return None
    phase: np.ndarray = (passed + np.arange(len(signal))) % best / best
    return phase


def whole_signals(system: System, one: Scored) -> dict[str, np.ndarray]:
    """Return the signals of a run, their warm-up filled with the first value that counts."""
    known = signals_of(system, one)
    return {name: np.concatenate([np.full(one.warm_up, x[0]), x]) for name, x in known.items()}


def hats(values: np.ndarray, low: float, high: float, knots: int) -> list[np.ndarray]:
    """Return linear splines of values at knots between two ends: each is 1 at its own."""
    place = np.clip((values - low) / max(high - low, 1e-300), 0.0, 1.0) * (knots - 1)
    return [np.maximum(1 - np.abs(place - k), 0.0) for k in range(knots)]
