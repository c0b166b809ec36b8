# SPDX-License-Identifier: Apache-2.0
"""Is a curve the same in each period? A wave is fitted to the recordings in place of a curve's points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from pam_orthosis.discrepancy.systems.system import Entry
from pam_orthosis.discrepancy.unknown.curve_fit import SIMPLER, CurveFit, Spline
from pam_orthosis.discrepancy.unknown.waves import likely_periods

FEWEST = 2.0  # periods in the range: fewer show nothing that repeats
HARMONICS = (1, 2, 3, 5, 7)  # of a wave, as few as held-out recordings allow
KNOTS_A_PERIOD = 20  # of a wave that a model file holds
MOST_KNOTS, MOST_OF_FEW = 200, 20  # of all of it, where curves may have many knots, or few alone
SIMILAR = 0.94  # of the share that a curve removes: a wave that removes as much has its period


class Wave(NamedTuple):
    """A spline that repeats, and the share that it and what is beside it remove."""

    spline: Spline
    share: float


def repeating(curves: CurveFit, fixed: tuple[Spline, ...], spline: Spline, most: int) -> Wave | None:
    """Return the wave that a curve is, or the curve with its period known; None if it does not repeat.

    Args:
        curves: fits splines.
        fixed: that are fitted beside it.
        spline: a curve of free values.
        most: knots that a wave may have.
    """
    found = curves.fit((*fixed, spline))
    places, values, covariance = curves.curve(found, len(fixed))
    spread = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    near = [_nearest(curves, fixed, _wave(curves, spline, period, 1, most), most)
            for period in likely_periods(places, values, spread)]  # fmt: skip
    if not near:
        return None
    period = min(near)[1]
    tried = [_wave(curves, spline, period, harmonics, most) for harmonics in HARMONICS]
    wave = _fewest(curves, fixed, tried)
    if wave is None:
        return None
    free = curves.reduced(found)
    if wave.share > free - SIMPLER:
        return wave
    return Wave(spline._replace(period=period), free) if wave.share > SIMILAR * free else None


def with_harmonics(curves: CurveFit, splines: tuple[Spline, ...]) -> tuple[Spline, ...]:
    """Return splines with the harmonics that their waves need, in a model that has these waves already."""
    for k, one in enumerate(splines):
        if one.harmonics:
            more = [_padded(one, harmonics) for harmonics in HARMONICS if harmonics >= one.harmonics]
            wave = _fewest(curves, (*splines[:k], *splines[k + 1 :]), more)
            splines = splines if wave is None else (*splines[:k], wave.spline, *splines[k + 1 :])
    return splines


def _padded(wave: Spline, harmonics: int) -> Spline:
    constant, *others = wave.factors
    rest = (0.0,) * (harmonics - wave.harmonics)
    factors = (constant, *others[: wave.harmonics], *rest, *others[wave.harmonics :], *rest)
    return wave._replace(harmonics=harmonics, factors=factors)


def _fewest(curves: CurveFit, fixed: tuple[Spline, ...], tried: Sequence[Spline]) -> Wave | None:
    """Return the wave of the fewest harmonics that removes about as much as any."""
    held = [one for one in tried if _holds(curves, one)]
    waves = [Wave(one, curves.reduced(curves.fit((*fixed, one)))) for one in held]
    best = max((wave.share for wave in waves), default=0.0)
    return next((wave for wave in waves if wave.share >= best - curves.simpler), None)


def best_placed(
    curves: CurveFit, fixed: tuple[Spline, ...], wave: Wave, places: Sequence[tuple[str, Entry]]
) -> Wave:
    """Return a wave where it removes most: (channel, how it enters). Free values hardly tell these apart."""
    moved = [wave.spline._replace(channel=channel, entry=entry) for channel, entry in places]
    waves = [Wave(one, curves.reduced(curves.fit((*fixed, one)))) for one in moved]
    best = max(waves, key=lambda one: one.share, default=wave)
    return best if best.share > wave.share + curves.simpler else wave


def _nearest(curves: CurveFit, fixed: tuple[Spline, ...], wave: Spline, most: int) -> tuple[float, float]:
    """Return the squares that the wave near a given one leaves in training, and its period."""
    width = _width(curves, wave)

    def left(cycles: float) -> float:
        rest = curves.fit((*fixed, _wave(curves, wave, width / cycles, 1, most))).left[0]
        return float(rest @ rest)

    cycles = width / wave.period
    found = minimize_scalar(
        left, bounds=(cycles - 0.4, cycles + 0.4), method="bounded", options={"xatol": 1e-3}
    )
    return float(found.fun), width / float(found.x)


def _wave(curves: CurveFit, spline: Spline, period: float, harmonics: int, most: int) -> Spline:
    wave = spline._replace(period=period, harmonics=harmonics)
    knots = 1 + int(np.ceil(KNOTS_A_PERIOD * _width(curves, wave) / period))
    return wave._replace(knots=min(knots, most))


def _width(curves: CurveFit, wave: Spline) -> float:
    low, high = curves.ends(wave)
    return high - low


def _holds(curves: CurveFit, wave: Spline) -> bool:
    """Whether a wave is seen more than once, and its knots can follow its harmonics."""
    cycles = _width(curves, wave) / wave.period
    return cycles >= FEWEST and (wave.knots - 1) / cycles > 2 * wave.harmonics + 1
