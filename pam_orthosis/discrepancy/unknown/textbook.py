# SPDX-License-Identifier: Apache-2.0
"""Textbook effects whose curve a description may have: dry friction, quadratic drag, an end stop and so on.

What nuisance parameters may have taken from a curve is taken from each form too, and what is left is fitted
by least squares, weighted by the covariance. A form is said where it leaves next to nothing and all others
leave clearly more. It is a resemblance, no cause.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np

from pam_orthosis.discrepancy.fitting.signals import hats
from pam_orthosis.discrepancy.systems.system import Entry, System

LEAVES = 0.02  # of a curve's weighted squares, that a form does not explain, at most
CLEARER = 0.5  # times what the next form leaves: what the best one leaves, at most
KNOWN = 6.0  # standard deviations, root mean square, that a curve has
EXACT = 0.01  # of a curve: how well a spline is a form at all
FINE = 40  # places between two knots, at which a spline follows a form
EDGE = 0.15  # of the range at its ends: no kink is looked for there
KINKS = 29  # places of one
FEWEST_WAVES, KNOTS_A_WAVE = 2.0, 3  # in the range: fewer are any curve
TURN = 4.0  # rad, least range of an angle over which a sine is no cubic

Columns: TypeAlias = Callable[..., tuple[np.ndarray, ...]]


class Form(NamedTuple):
    """A textbook effect.

    Attributes:
        words: what it is, with places for what was scanned, its unit among them; empty: a rival alone.
        columns: (places, *what is scanned) -> curves, each with a free factor.
        scanned: places -> values to try.
        resists: it pushes back: its factor is positive.
        leaves: share of a curve that it leaves, at most: the more, the less other curves resemble it. At rest
            dry friction is no sign, so that its curve is a rough one.
    """

    words: str
    columns: Columns
    scanned: Callable[[np.ndarray], Iterable[tuple[float, ...]]] = lambda x: ((),)
    resists: bool = False
    leaves: float = LEAVES


def _kinks(x: np.ndarray) -> list[float]:
    margin = EDGE * float(np.ptp(x))
    return [float(one) for one in np.linspace(x[0] + margin, x[-1] - margin, KINKS)]


def _kink(x: np.ndarray) -> list[tuple[float]]:
    return [(one,) for one in _kinks(x)]


def _gaps(x: np.ndarray) -> list[tuple[float, ...]]:
    return [pair for pair in combinations(_kinks(x), 2) if pair[1] - pair[0] > EDGE * np.ptp(x)]


def _shares(*shares: float) -> Callable[[np.ndarray], list[tuple[float]]]:
    return lambda x: [(share * float(np.abs(x).max()),) for share in shares]


def _periods(x: np.ndarray) -> list[tuple[float]]:
    waves = np.arange(FEWEST_WAVES, len(x) / KNOTS_A_WAVE, 0.05)
    return [(float(np.ptp(x)) / float(one),) for one in waves]


def _turn(x: np.ndarray) -> tuple[tuple[float, ...], ...]:
    return ((),) if np.ptp(x) > TURN else ()


def _constants(t: np.ndarray) -> list[tuple[float]]:
    return [(part * float(np.ptp(t)),) for part in (0.03, 0.1, 0.3, 1.0)]


def _widths(x: np.ndarray) -> list[tuple[float]]:
    return [(sign * part * float(np.ptp(x)),) for part in (0.1, 0.14, 0.2) for sign in (-1, 1)]


def _wave(x: np.ndarray, period: float) -> tuple[np.ndarray, ...]:
    angle = 2 * np.pi * x / period
    return np.sin(angle), np.cos(angle)


DRAG = Form("quadratic drag (v |v|)", lambda v: (-v * np.abs(v),), resists=True, leaves=0.05)
CUBIC = Form("", lambda x: (x**3,))
DRY = Form(
    "dry friction (the sign of the velocity)",
    lambda v, width: (-np.tanh(v / width),),
    _shares(1e-6, 0.05, 0.1, 0.15),
    resists=True,
    leaves=0.12,
)
HARDENING = Form("a spring that hardens (cubic)", lambda x: (-(x**3),), resists=True, leaves=0.01)
SOFTENING = Form("a spring that softens (cubic)", lambda x: (x**3,), resists=True, leaves=0.01)
ABOVE = Form(
    "an end stop or one-sided spring (a line above {0:.3g} {unit})",
    lambda x, at: (-np.maximum(x - at, 0.0),),
    _kink,
    resists=True,
    leaves=0.04,
)
BELOW = Form(
    "an end stop or one-sided spring (a line below {0:.3g} {unit})",
    lambda x, at: (np.maximum(at - x, 0.0),),
    _kink,
    resists=True,
    leaves=0.04,
)
FREE = Form(
    "a spring with a dead zone (free from {0:.3g} to {1:.3g} {unit})",
    lambda x, low, high: (np.maximum(low - x, 0.0) - np.maximum(x - high, 0.0),),
    _gaps,
    resists=True,
    leaves=0.03,
)
TEETH = Form("what repeats over the position, as of teeth or magnets (cogging)", _wave, _periods, leaves=0.04)
WEIGHT = Form("a weight on an arm (sine of the angle)", lambda x: (np.sin(x), np.cos(x)), _turn)
STEEP = Form("", lambda x, width: (np.exp((x - x.mean()) / width),), _widths)
DRIFT = Form("a drift (a line over time)", lambda t: (t,), leaves=0.03)
SWING = Form("a wave over time", _wave, _periods, leaves=0.04)
SETTLING = Form("", lambda t, constant: (np.exp((t[0] - t) / constant),), _constants)
KINKED = Form(
    "a dead zone or a saturation of the input (kinks at -{0:.3g} and {0:.3g} {unit})",
    lambda u, at: (np.clip(u, -at, at),),
    _shares(*np.linspace(0.05, 0.8, 31)),
)
SQUARE = Form("the square of the input", lambda u: (u**2,), leaves=0.01)
GROWING = Form("", lambda u: (u * np.abs(u),))

SPEEDS = ("m/s", "rad/s")
VELOCITY, POSITION, ANGLE, TIME, INPUT = "velocity", "position", "angle", "time", "input"
SPRINGS = (HARDENING, SOFTENING, ABOVE, BELOW, FREE, TEETH, STEEP)
FORMS = {
    VELOCITY: (DRY, DRAG, CUBIC),
    POSITION: SPRINGS,
    ANGLE: (*SPRINGS, WEIGHT),
    TIME: (DRIFT, SWING, SETTLING),
    INPUT: (KINKED, SQUARE, GROWING, CUBIC),
}
TAKEN = {VELOCITY: 2, POSITION: 2, ANGLE: 2, TIME: 0, INPUT: 1}  # degree of what nuisance parameters may take


def kind_of(system: System, channel: str, entry: Entry, signal: str) -> str | None:
    """Return what a curve that enters a channel's equation is over: a key of `FORMS`; None if of no kind."""
    if signal == "time":
        return TIME
    if signal in system.inputs:
        return None if entry.unit == "-" else INPUT  # a factor of an input is none of its effects
    own = system.channel(channel)
    has_rate = own.state in system.derived.values()
    if signal == channel and has_rate:
        return ANGLE if own.unit == "rad" else POSITION
    is_rate = signal == channel and (own.state in system.derived or own.unit.endswith(SPEEDS))
    return VELOCITY if is_rate or (has_rate and system.derived.get(signal) == own.state) else None


def shape_of(
    kind: str, places: np.ndarray, curve: np.ndarray, covariance: np.ndarray, unit: str
) -> str | None:
    """Return the textbook effect that has the shape of a curve; None if none has, or if several have.

    Args:
        kind: a key of `FORMS`.
        places, curve, covariance: knots, values there and how well these are known.
        unit: of the places.
    """
    white = _whitening(places, curve, covariance, TAKEN[kind])
    goal, follow = white @ curve, white @ _follower(places)
    if float(goal @ goal) < KNOWN**2 * len(goal):
        return None
    fits = [_fit(form, places, follow, goal) for form in FORMS[kind]]
    best, *others = sorted(fits, key=lambda one: one.left)
    if best.left > best.form.leaves or best.left > CLEARER * min(one.left for one in others):
        return None
    return best.form.words.format(*best.scanned, unit=unit or "(SI)") or None


class _Fit(NamedTuple):
    """A form, what was scanned where it fits best, the share of the curve that it leaves."""

    form: Form
    scanned: tuple[float, ...]
    left: float


def _fit(form: Form, places: np.ndarray, follow: np.ndarray, goal: np.ndarray) -> _Fit:
    """Return how well a form fits; the share that it leaves is that of each degree of freedom."""
    best = _Fit(form, (), 1.0)
    for scanned in form.scanned(places):
        columns = follow @ np.column_stack(form.columns(_fine(places), *scanned))
        factors = np.linalg.lstsq(columns, goal, rcond=None)[0]
        free = len(goal) - len(factors) - len(scanned)
        if free < len(factors) + len(scanned) or (form.resists and factors[0] <= 0):
            continue
        rest = goal - columns @ factors
        left = float(rest @ rest) / float(goal @ goal) * len(goal) / free
        best = min(best, _Fit(form, scanned, left), key=lambda one: one.left)
    return best


def _whitening(places: np.ndarray, curve: np.ndarray, covariance: np.ndarray, degree: int) -> np.ndarray:
    """Return the matrix that leaves of values at places what no polynomial has, white and of unit size."""
    along = (places - places.mean()) / np.ptp(places)
    polynomials = np.vander(along, degree + 1)
    without = np.linalg.svd(polynomials)[0][:, degree + 1 :].T
    floor = (EXACT * float(np.sqrt(np.mean((without @ curve) ** 2)))) ** 2
    spread = without @ covariance @ without.T + max(floor, 1e-300) * np.eye(len(without))
    white: np.ndarray = np.linalg.solve(np.linalg.cholesky(spread), without)
    return white


def _fine(places: np.ndarray) -> np.ndarray:
    return np.linspace(places[0], places[-1], FINE * (len(places) - 1) + 1)


def _follower(places: np.ndarray) -> np.ndarray:
    """Return the matrix that makes of a curve at fine places the spline that follows it best."""
    fine = _fine(places)
    follower: np.ndarray = np.linalg.pinv(np.column_stack(hats(fine, places[0], places[-1], len(places))))
    return follower
