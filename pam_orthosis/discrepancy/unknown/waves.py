# SPDX-License-Identifier: Apache-2.0
"""Curves that repeat: is a curve over a signal a wave, how long, and how large?"""

import numpy as np

CYCLES, FITS = 1.5, 0.94  # a curve is periodic if so many waves are in its range and explain so much of it
FEWEST_KNOWN = 6.0  # knots: fewer are matched by almost any wave
NEARBY, FINE = 0.08, 30  # of a period, and how many are tried a wave
LIKELY, MOST_LIKELY = 0.3, 3  # share of a curve that a likely wave explains; how many are likely, at most
CORNERED, BEYOND = 3, 0.3  # harmonics; of corners that lie beyond, standard deviation
AROUND = 720  # places of one period
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
    tried = 17 + 2 * int(FINE * NEARBY * np.ptp(places) / period)
    for near in np.linspace(1 - NEARBY, 1 + NEARBY, tried):
        angle = 2 * np.pi * places / (period * near)
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
    with np.errstate(over="ignore", invalid="ignore"):  # a curve that ran away has no period
        fits = [_explained(places, curve, weight, width / cycles) for cycles in tried]
    cycles = float(tried[np.argmax(fits)])
    return width / cycles if cycles >= CYCLES and max(fits) > FITS else None


def _explained(
    places: np.ndarray, curve: np.ndarray, weight: np.ndarray, period: float, degree: int = 1
) -> float:
    """Return the share of a weighted curve, beside a polynomial, that a wave of some period explains."""
    angle = 2 * np.pi * places / period
    beside = np.vander((places - places.mean()) / np.ptp(places), degree + 1)
    waves = np.column_stack([beside, np.sin(angle), np.cos(angle)]) * weight[:, None]
    goal = weight * curve
    rest = [
        goal - part @ np.linalg.lstsq(part, goal, rcond=None)[0] for part in (waves[:, : degree + 1], waves)
    ]
    return 1 - float(rest[1] @ rest[1]) / float(rest[0] @ rest[0])


def likely_periods(places: np.ndarray, curve: np.ndarray, spread: np.ndarray) -> list[float]:
    """Return the periods of which waves explain most of a curve beside a cubic, best first.

    The outermost places do not count: all that is beyond them is put there.
    """
    inner = slice(1, -1)
    x, y = places[inner], curve[inner]
    cycles = np.arange(CYCLES, len(places) / 3, 0.05)
    if len(x) < FEWEST_KNOWN or not len(cycles):
        return []
    flat = y - np.polyval(np.polyfit(x - x.mean(), y, 3), x - x.mean())
    if not float(flat @ flat) > ROUNDING * float(y @ y):
        return []
    weight = 1 / np.maximum(spread, max(float(np.median(spread)), 1e-300))[inner]
    periods = np.ptp(places) / cycles
    fits = np.array([_explained(x, y, weight, period, degree=3) for period in periods])
    padded = np.concatenate([[-np.inf], fits, [-np.inf]])
    tops = np.flatnonzero((fits >= padded[:-2]) & (fits >= padded[2:]) & (fits > LIKELY))
    best = sorted(tops, key=lambda k: -fits[k])[:MOST_LIKELY]
    return [float(periods[k]) for k in best]


def wave_basis(places: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    """Return one, and the sine and cosine of each harmonic, at places: (n, 1 + 2 harmonics)."""
    angle = 2 * np.pi * np.outer(places, np.arange(1, harmonics + 1)) / period
    return np.hstack([np.ones((len(places), 1)), np.sin(angle), np.cos(angle)])


def wave_slope(places: np.ndarray, period: float, factors: np.ndarray) -> np.ndarray:
    """Return how a wave of some factors changes, at places, with the logarithm of its frequency, (n, 1)."""
    harmonics = len(factors) // 2
    angle = 2 * np.pi * np.outer(places, np.arange(1, harmonics + 1)) / period
    sine, cosine = factors[1 : harmonics + 1], factors[harmonics + 1 :]
    parts: np.ndarray = angle * (np.cos(angle) * sine - np.sin(angle) * cosine)
    return parts @ np.ones((harmonics, 1))


def wave_moved(
    places: np.ndarray, period: float, factors: np.ndarray, change: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the values and the period of a wave to which a small change, of its period too, is added."""
    harmonics = len(factors) // 2
    basis = np.hstack([wave_basis(places, period, harmonics), wave_slope(places, period, factors)])
    *added, faster = np.linalg.lstsq(basis, change, rcond=None)[0]
    period = period * float(np.exp(-faster))
    return wave_basis(places, period, harmonics) @ (factors + np.array(added)), period


def wave_of(places: np.ndarray, period: float, harmonics: int) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices that make of a wave's values at places its constant, and the wave without it.

    Straight lines between the places have less of each harmonic than the values there.
    """
    basis = wave_basis(places, period, harmonics)
    factors = np.linalg.pinv(basis)
    order = np.tile(np.arange(1, harmonics + 1), 2)
    kept = np.sinc(order * (places[1] - places[0]) / period) ** 2
    return factors[0], (basis[:, 1:] * kept) @ factors[1:]


def wave_swing(
    places: np.ndarray, wave: np.ndarray, covariance: np.ndarray, period: float, harmonics: int
) -> tuple[float, float]:
    """Return half of the range of a wave of some harmonics, and its variance.

    Three or more harmonics may be those of corners, which have further ones, as 1 / order^2.
    """
    around = wave_basis(np.linspace(0.0, period, AROUND), period, harmonics)
    shown = around[:, 1:] @ np.linalg.pinv(wave_basis(places, period, harmonics))[1:]
    seen = shown @ wave
    half = 0.5 * (shown[int(np.argmax(seen))] - shown[int(np.argmin(seen))])
    if harmonics < CORNERED:
        return float(half @ wave), float(half @ covariance @ half)
    sine, cosine = (np.linalg.pinv(wave_basis(places, period, harmonics))[1:] @ wave).reshape(2, -1)
    corners = float(np.max((np.arange(1, harmonics + 1) ** 2 * np.hypot(sine, cosine))[1:]))
    beyond = BEYOND * corners / harmonics
    return float(half @ wave), float(half @ covariance @ half) + beyond**2
