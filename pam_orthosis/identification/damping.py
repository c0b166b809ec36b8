# SPDX-License-Identifier: Apache-2.0
"""Damping factor D from free decays: the logarithmic decrement, Eq. (18), and what friction adds to it.

For a linearised oscillator m y'' + D y' + c y = 0 the envelope is exp(-D t / (2 m)), hence
y_k / y_(k+1) = exp(D T_d / (2 m)) as Eq. (18) prints: the formula is right. It counts every loss as
viscous. The braid's dry friction dissipates too, and more of the energy the smaller the swing; D by
Eq. (18) then is too large and grows from swing to swing. The load cell separates the two: over the
decay the force is fitted by a smooth function of contraction and pressure, D v, and a sum of elastic
sliding elements (Maxwell-slip, rate-independent) with slip distances from 0.25 to 8 mm.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, signal, stats

from pam_orthosis.errors import OrthosisError, naming
from pam_orthosis.identification.samples import Decay, differentiated

CONTRACTION_POWERS, PRESSURE_POWERS = range(5), range(4)
FILTER_SAMPLES = 11
LEFT = 0.01  # of the first swing: beyond it the mass has left its hold
SWINGING = 0.75, 1.35  # mass by force and acceleration over the stated one; those of rigs differ by 5 %
SHOWN = 0.5  # of the force's variance, that the acceleration has to explain to say it
SLOWER = 4.0  # times the period of the fitted muscle's stiffness, or that part of it: gas adds stiffness


@dataclass(frozen=True)
class Damping:
    """D of Eq. (13), N s/m, with half its 95 % interval; `decrement` is D by Eq. (18), all losses.

    `apart`: a load cell told the braid's dry friction apart; else `value` is `decrement`.
    """

    value: float
    half_width: float
    decrement: float
    period: float
    residual: float
    apart: bool = True


def fit_damping(decays: list[Decay]) -> Damping:
    """Return the damping from free decays; OrthosisError if one has no oscillation or is too short."""
    found, parts = [], []
    for one in decays:
        with naming(one.source):
            found.append(decrement(one))
            check_mass(one)
            parts += [viscous_part(one)] if one.force is not None else []
    decrements, periods = zip(*found, strict=True)
    values, errors = zip(*parts, strict=True) if parts else (decrements, (0.0,))
    spread = float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
    # between the decays, or, for a single one, what is usual between them
    half = stats.t.ppf(0.975, len(values) - 1) * spread / len(values) ** 0.5 if spread else 0.1 * values[0]
    return Damping(
        float(np.mean(values)), float(half), float(np.mean(decrements)), float(np.mean(periods)),
        float(np.mean(errors)), bool(parts),
    )  # fmt: skip


def decrement(decay: Decay) -> tuple[float, float]:
    """Return D by Eq. (18), N s/m, and the period T_d, s.

    The amplitudes are the swings between successive turning points, which no offset of the rest
    position touches; a swing lasts half a period.

    Raises:
        OrthosisError: too few samples or swings.
    """
    turns = turning_points(decay)
    swings = np.abs(np.diff(decay.position[turns]))
    least_swing = 0.1  # of the first: smaller swings are friction rather than oscillation
    small = np.flatnonzero(swings < least_swing * swings[:1])
    count = int(small[0]) if len(small) else len(swings)
    least_swings = 4
    if count < least_swings:
        raise OrthosisError(f"a decay record holds {count} swings; at least {least_swings} are needed")
    period = 2 * float(np.mean(np.diff(decay.time[turns[: count + 1]])))
    half_swings = np.arange(count)
    slope = np.polyfit(half_swings, np.log(swings[:count]), 1)[0]
    return -2 * slope * 2 * decay.mass / period, period


def check_mass(decay: Decay) -> None:
    """Raise OrthosisError if what swings, by force and acceleration, is not the mass that is stated."""
    if decay.force is None:
        return
    force, decay = decay.force[turning_points(decay)[0] :], _released(decay)
    window = 3 * FILTER_SAMPLES
    if len(force) < 3 * window:
        return
    step = float(np.mean(np.diff(decay.time)))
    acceleration = signal.savgol_filter(decay.position, window, 3, deriv=2, delta=step)[window:-window]
    seen = stats.linregress(acceleration, force[window:-window])
    low, high = (share * decay.mass for share in SWINGING)
    if seen.rvalue**2 > SHOWN and not low < seen.slope < high:
        raise OrthosisError(
            f"by force and acceleration {seen.slope:.3g} kg swing in this decay, not {decay.mass:g} kg: check"
            " the moved mass, and the units of time, length and force"
        )


def check_period(decay: Decay, stiffness: np.ndarray) -> None:
    """Raise OrthosisError if a decay swings as no mass does on a muscle of these stiffnesses, N/m."""
    _, period = decrement(decay)
    soft, stiff = (2 * np.pi * np.sqrt(decay.mass / one) for one in (stiffness.min(), stiffness.max()))
    if not stiff / SLOWER < period < SLOWER * soft:
        raise OrthosisError(
            f"the decay has a period of {period:.3g} s; {decay.mass:g} kg on a muscle as stiff as the fitted"
            f" one swing in {stiff:.2g} to {soft:.2g} s: check the moved mass and the unit of time"
        )


def turning_points(decay: Decay) -> np.ndarray:
    """Return the release and all turning points after it; OrthosisError for too few samples."""
    least_samples = 100
    if len(decay.position) < least_samples:
        raise OrthosisError(
            f"a decay record holds {len(decay.position)} samples; at least {least_samples} are needed"
        )
    smooth = signal.savgol_filter(decay.position, FILTER_SAMPLES, 2)
    least = LEFT * np.ptp(smooth)
    peaks = [signal.find_peaks(side, prominence=least)[0] for side in (smooth, -smooth)]
    turns = np.sort(np.concatenate(peaks))
    return np.concatenate([[_release(smooth, turns[0])], turns]) if len(turns) else np.array([0])


def _release(smooth: np.ndarray, turn: int) -> int:
    """Return the sample of the release, to which the first half period leads back from its turning point.

    The half period is known from when the mass leaves its hold: a cosine has gone `LEFT` of its swing then.
    """
    start, end = np.median(smooth[: max(1, turn // 10)]), smooth[turn]
    held = np.abs(smooth[:turn] - start) < LEFT * abs(end - start)
    left = int(np.flatnonzero(held)[-1]) if held.any() else 0
    half = (turn - left) / (1 - np.arccos(1 - 2 * LEFT) / np.pi)
    no_hold = 0.1  # of the first half period: a shorter hold is none
    return round(turn - half) if turn - half > no_hold * half else 0


def _released(decay: Decay) -> Decay:
    """Return a decay from its release on."""
    start = turning_points(decay)[0]
    return replace(decay, **{name: getattr(decay, name)[start:] for name in ("time", "position", "pressure")})


def viscous_part(decay: Decay) -> tuple[float, float]:
    """Return D, N s/m, freed of dry friction by the force, and the RMS residual, N; else OrthosisError."""
    if decay.force is None:
        raise OrthosisError("a decay without a force does not tell dry friction apart")
    force, decay = decay.force[turning_points(decay)[0] :], _released(decay)
    stamps = np.round(decay.time * 1e9)
    position = signal.savgol_filter(decay.position, FILTER_SAMPLES, 3)
    rate = differentiated(decay.position, stamps)
    x = (position - position.mean()) / np.ptp(position)
    smooth = [x**k for k in CONTRACTION_POWERS] + _with_pressure(decay.pressure, x)
    slip_distances = (2.5e-4, 5.0e-4, 1.0e-3, 2.0e-3, 4.0e-3, 8.0e-3)  # m
    friction = [-slip_element(position, distance) for distance in slip_distances]
    matrix = np.column_stack([*smooth, -rate, *friction])
    scale = np.linalg.norm(matrix, axis=0)
    free = np.concatenate([np.full(len(smooth), -np.inf), np.zeros(1 + len(friction))])
    inner = slice(FILTER_SAMPLES, -FILTER_SAMPLES)
    fit = optimize.lsq_linear((matrix / scale)[inner], force[inner], (free, np.inf))
    residual = matrix[inner] @ (fit.x / scale) - force[inner]
    return float(fit.x[len(smooth)] / scale[len(smooth)]), float(np.std(residual))


def _with_pressure(pressure: np.ndarray, x: np.ndarray) -> list[np.ndarray]:
    """Return the terms of the smooth force that grow with the pressure; none if it is constant."""
    span = np.ptp(pressure)
    return [(pressure - pressure.mean()) / span * x**k for k in PRESSURE_POWERS] if span > 0 else []


def slip_element(position: np.ndarray, distance: float) -> np.ndarray:
    """Return the state, -1 .. 1, of an elastic element that slides beyond a distance (as the position)."""
    state, states = 0.0, np.zeros_like(position)
    for index, step in enumerate(np.diff(position) / distance, start=1):
        state = min(max(state + step, -1.0), 1.0)
        states[index] = state
    return states
