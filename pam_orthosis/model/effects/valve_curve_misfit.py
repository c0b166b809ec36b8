# SPDX-License-Identifier: Apache-2.0
"""Misfit of the valves' curves: a smooth, bounded correction of the opening over the spool's stroke."""

import math
from dataclasses import replace

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.muscle import polynomial

SMALL_OPENING = 0.04  # below it the knots lie evenly, above it in equal ratios
SPACING = 0.8  # of the knots on the scale asinh(opening / SMALL_OPENING)
SIDE = 5  # knots on each side of the closed position, the last beyond the wide open valve


def knot_name(index: int) -> str:
    """Return the name of a knot, -SIDE .. SIDE."""
    return "closed" if index == 0 else f"{'fill' if index > 0 else 'vent'}_{abs(index)}"


def relative_error(opening, coefficients):
    """Return the sum of bumps exp(-(place - knot)^2); `coefficients` from the widest vent on.

    exp(-(x - k)^2) = exp(-x^2) exp(2 x)^k exp(-k^2): two exponentials for all knots.
    """
    place = ca.asinh(opening / SMALL_OPENING) / SPACING
    growth = ca.exp(2 * place)
    upper = _series(coefficients[SIDE:], growth)
    lower = _series(coefficients[SIDE::-1], 1 / growth)
    return ca.exp(-(place**2)) * (upper + lower - coefficients[SIDE])


def _series(coefficients, ratio):
    """Return sum c_k exp(-k^2) ratio^k, by Horner's rule."""
    return polynomial([c * math.exp(-(k**2)) for k, c in enumerate(coefficients)], ratio)


def _expression(s, p, _states):
    added = {}
    for muscle in ("extensor", "flexor"):
        opening = getattr(s, f"{muscle}_opening")
        coefficients = [getattr(p, f"{muscle}_{knot_name(k)}") for k in range(-SIDE, SIDE + 1)]
        added[f"{muscle}_opening"] = opening * relative_error(opening, coefficients)
    return Contribution(added)


def _coefficient(muscle: str, index: int) -> Quantity:
    place = SMALL_OPENING * math.sinh(index * SPACING)
    meaning = f"{muscle}: relative error of the opening about {place:+.2f}"
    q = Quantity(f"{muscle}_{knot_name(index)}", 0.03, "-", -0.5, 0.5, meaning, 0.0, prior=0.03)
    # no valve opens as far as the last knot, of which only the flank is seen: its bound says nothing
    return replace(q, meaningful=(q.minimum, q.maximum)) if abs(index) == SIDE else q


EFFECTS = [
    Effect(
        name="valve_curve_misfit",
        stage="opening",
        parameters=tuple(
            _coefficient(m, index) for m in ("extensor", "flexor") for index in range(-SIDE, SIDE + 1)
        ),
        expression=_expression,
        physics="The opening of a valve is not proportional to the spool's stroke: edges, notches and flow "
        "forces bend the curve by some per cent, differently for filling and venting. A closed valve stays "
        "closed.",
        source="valve class data: opening about linear, smoothed at small strokes; magnitude: assumption",
        minimum_effect=0.01,
        coordinate="extensor_voltage",
        confounded_with=("valve_dead_band", "extensor_valve_gain", "flexor_valve_gain"),
        separated_by=("diagnostic-cocontraction", "diagnostic-locked"),
        shape=True,
    )
]
