# SPDX-License-Identifier: Apache-2.0
"""Misfit of the static force maps: a smooth, bounded correction over contraction and pressure."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

TERMS = tuple((i, j) for i in range(4) for j in range(4) if i + j <= 3)
WHOLE_PRESSURE = 6.0e5  # Pa gauge, the upper end of the map
WHOLE_STROKE = 0.25  # relative contraction, the upper end of the map


def chebyshev(order: int, x):
    """Return the Chebyshev polynomial T_n(x) by its recurrence."""
    before, now = 1.0, x
    for _ in range(order):
        before, now = now, 2 * x * now - before
    return before


def normalised(value, whole):
    """Return a value of 0 .. whole scaled to -1 .. 1, clamped."""
    return ca.fmin(ca.fmax(2 * value / whole - 1, -1), 1)


def _expression(s, p, _states):
    """Sum of products of Chebyshev polynomials up to the third order, for each muscle."""
    added = {}
    for muscle in ("extensor", "flexor"):
        x = normalised(getattr(s, f"{muscle}_contraction"), WHOLE_STROKE * getattr(s, f"{muscle}_length"))
        y = normalised(getattr(s, f"{muscle}_gauge"), WHOLE_PRESSURE)
        terms = [getattr(p, f"{muscle}_c{i}{j}") * chebyshev(i, x) * chebyshev(j, y) for i, j in TERMS]
        added[f"{muscle}_force"] = sum(terms)
    return Contribution(added)


def _coefficient(muscle: str, i: int, j: int) -> Quantity:
    size = 6.0 / (1 + (i + j) / 3)
    meaning = f"{muscle}: coefficient of T{i}(contraction) T{j}(pressure), both scaled to -1 .. 1"
    return Quantity(f"{muscle}_c{i}{j}", size, "N", -80.0, 80.0, meaning, 0.0, prior=size)


EFFECTS = [
    Effect(
        name="force_map_misfit",
        stage="force",
        parameters=tuple(_coefficient(m, i, j) for m in ("extensor", "flexor") for i, j in TERMS),
        expression=_expression,
        physics="The polynomial of Eq. (14) is not a muscle's true map: fibres, end caps and rubber leave a "
        "smooth error of some newtons over contraction and pressure. No term exceeds its coefficient, so "
        "the correction is bounded.",
        source="paper: errors up to 30 N; polynomial against the measured map: RMS 3.5 to 15 N",
        minimum_effect=2.0,
        coordinate="extensor_contraction",
        confounded_with=("parallel_elasticity", "extensor_force_scale", "flexor_force_scale"),
        separated_by=("diagnostic-cocontraction", "diagnostic-triangle"),
        shape=True,
    )
]
