# SPDX-License-Identifier: Apache-2.0
"""Curves that repeat: is a curve over a signal a wave, how long, and how large?"""

import numpy as np

CYCLES, FITS = 1.5, 0.94  # a curve is periodic if so many waves are in its range and explain so much of it
FEWEST_KNOWN = 6.0  # knots: fewer are matched by almost any wave
NEARBY = np.linspace(0.92, 1.08, 17)  # of a period
ROUNDING = 1e-9  # of a curve's squares: what is smaller is a line


def wave_amplitude(
    places: np.ndarray, curve: np.ndarray, covariance: np.ndarray, period: float
) -> tuple[float, float]:
    """Return the amplitude of a curve's wave, and its variance; the curve may lack the best parabola.

    The wave has the period near the given one, which a curve without its parabola shows roughly, that fits
    best.
    """
    weight = 1 / np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    along = (places - places.mean()) / np.ptp(places)
    base = [np.ones_like(along), along, along**2]
    found = []
    for angle in (2 * np.pi * places / (period * near) for near in NEARBY):
        terms = np.column_stack([np.sin(angle), np.cos(angle), *base])
        fit = np.linalg.lstsq(weight[:, None] * terms, np.diag(weight), rcond=None)[0]
        found.append((float(np.sum((weight * (curve - terms @ fit @ curve)) ** 2)), fit[:2]))
    _, best = min(found, key=lambda one: one[0])
    parts = best @ curve
    size = float(np.hypot(*parts))
    slope = parts @ best / max(size, 1e-300)
    return size, float(slope @ covariance @ slope)


def wave_period(places: np.ndarray, curve: np.ndarray, spread: np.ndarray) -> float | None:
    """Return the period of a curve that is a wave about a line; None if it is none, or too coarsely known.

    Args:
        places, curve: knots and values.
        spread: their standard deviations: places that were hardly visited count little.
    """
    width = float(places[-1] - places[0])
    line = np.column_stack([np.ones_like(places), places])
    flat = curve - line @ np.linalg.lstsq(line, curve, rcond=None)[0]
    tried = np.arange(1.0, len(places) / 3, 0.05)  # also few waves: what fits best there is no wave yet
    if width <= 0 or not len(tried) or not float(flat @ flat) > ROUNDING * float(curve @ curve):
        return None
    weight = 1 / np.maximum(spread, 1e-9 * spread.max())
    known = np.sum(weight) ** 2 / np.sum(weight**2)  # knots, if those that are known less count less
    if known < FEWEST_KNOWN:
        return None
    fits = [_explained(places, curve, weight, width / cycles) for cycles in tried]
    cycles = float(tried[np.argmax(fits)])
    return width / cycles if cycles >= CYCLES and max(fits) > FITS else None


def _explained(places: np.ndarray, curve: np.ndarray, weight: np.ndarray, period: float) -> float:
    """Return the share of a weighted curve, beside a line, that a wave of some period explains."""
    angle = 2 * np.pi * places / period
    waves = np.column_stack([np.ones_like(places), places, np.sin(angle), np.cos(angle)]) * weight[:, None]
    goal = weight * curve
    rest = [goal - part @ np.linalg.lstsq(part, goal, rcond=None)[0] for part in (waves[:, :2], waves)]
    return 1 - float(rest[1] @ rest[1]) / float(rest[0] @ rest[0])
