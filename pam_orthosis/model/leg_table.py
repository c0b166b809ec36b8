# SPDX-License-Identifier: Apache-2.0
"""The leg's mechanics as polynomials of the angle, for where they are evaluated millions of times.

Inertia and gravity of Eq. (26) depend on the angle alone and are linear in the masses; k is
m'(q) q-dot^2 / 2. Polynomials, fitted at Chebyshev nodes, give them to 1e-8 N m and better at a tenth of the
operations.
"""

from collections.abc import Callable

import casadi as ca
import numpy as np
import numpy.typing as npt

from pam_orthosis.model.components.muscle import polynomial
from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.model.mechanisms.base import Mechanics
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression

MARGIN = 0.2  # rad beyond the joint's stops
TERMS = 4  # inertia, gravity, and what a kilogram at the foot adds to each


class LegTable:
    """How polynomials of an order over the range between a joint's stops, rad, are fitted at some nodes."""

    def __init__(self, minimum: float, maximum: float, order: int, nodes: int):
        self._middle, self._half = 0.5 * (minimum + maximum), 0.5 * (maximum - minimum) + MARGIN
        self._places, self._order = np.cos(np.pi * (np.arange(nodes) + 0.5) / nodes), order
        self.angles = self._middle + self._half * self._places

    def place(self, angle: Expression) -> Expression:
        """Return of what the polynomials are, -1 .. 1 in their range."""
        return (angle - self._middle) / self._half

    def fitted(self, values: npt.NDArray[np.float64]) -> list[float]:
        """Return the coefficients of the polynomial through values at the nodes."""
        fit = np.polynomial.chebyshev.chebfit(self._places, values, self._order)
        coefficients: list[float] = np.polynomial.chebyshev.cheb2poly(fit).tolist()
        return coefficients

    def weights(self) -> list[list[float]]:
        """Return what makes coefficients of values at the nodes: a row a coefficient."""
        rows: list[list[float]] = np.array([self.fitted(one) for one in np.eye(len(self.angles))]).T.tolist()
        return rows

    def coefficients(self, leg: Section, extra_foot_mass: float) -> list[list[float]]:
        """Return the coefficients of inertia and of gravity."""
        q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
        terms = leg_model.mechanics(q, velocity, leg, extra_foot_mass)
        function = ca.Function("terms", [q], [terms.inertia, terms.gravity])
        count = len(self.angles)
        sampled = np.array(function.map(count)(self.angles[None, :])).reshape(2, count)
        return [self.fitted(values) for values in sampled]


def tabulated(
    terms: Callable[[Expression, Expression], tuple[Expression, Expression]],
) -> Callable[..., Mechanics]:
    """Return a function as `leg.mechanics` from (angle, mass at the foot) -> inertia, gravity."""

    def mechanics(
        q: Expression, velocity: Expression, _leg: Section, extra_foot_mass: Expression = 0.0
    ) -> Mechanics:
        inertia, gravity = terms(q, extra_foot_mass)
        slope = ca.jtimes(inertia, q, 1) if isinstance(q, ca.SX) else 0.0
        return Mechanics(inertia, 0.5 * slope * velocity**2, gravity)

    return mechanics


def leg_terms(leg: Section, angle: Expression) -> Expression:
    """Return what is tabulated at an angle of a leg whose parameters are symbols, (TERMS, 1)."""
    velocity = ca.SX.sym("velocity")
    bare, loaded = (leg_model.mechanics(angle, velocity, leg, extra) for extra in (0.0, 1.0))
    foot = loaded.inertia - bare.inertia, loaded.gravity - bare.gravity
    return ca.cse(ca.vertcat(bare.inertia, bare.gravity, *foot))


def leg_mechanics(table: LegTable, coefficients: Expression) -> Callable[..., Mechanics]:
    """Return the leg's mechanics from the coefficients of `leg_terms`, one term after the other."""
    split = ca.vertsplit(coefficients, coefficients.numel() // TERMS)

    def terms(q: Expression, foot: Expression) -> tuple[Expression, Expression]:
        place = ca.fmin(ca.fmax(table.place(q), -1), 1)  # farther out they stay as they are there
        inertia, gravity = (split[i] + foot * split[i + 2] for i in range(2))
        return polynomial(ca.vertsplit(inertia), place), polynomial(ca.vertsplit(gravity), place)

    return tabulated(terms)
