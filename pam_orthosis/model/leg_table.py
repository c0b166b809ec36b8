# SPDX-License-Identifier: Apache-2.0
"""The leg's mechanics as polynomials of the knee angle, for where they are evaluated millions of times.

Inertia and gravity of Eq. (26) depend on the angle alone and are linear in an extra mass at the foot; k is
m'(q) q-dot^2 / 2. Polynomials of order `ORDER`, fitted at Chebyshev nodes, give them to 1e-8 N m and better
at a tenth of the operations.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from pam_orthosis.model import leg as leg_model

ORDER, NODES = 20, 30
MARGIN = 0.2  # rad beyond the joint's stops; farther out the terms stay as they are there
TERMS = 4  # inertia, gravity, and what a kilogram at the foot adds to each


class LegTable:
    """How polynomials over a range of angles are fitted and evaluated.

    Args:
        minimum, maximum: the joint's stops, rad.
    """

    def __init__(self, minimum: float, maximum: float):
        self._middle, self._half = 0.5 * (minimum + maximum), 0.5 * (maximum - minimum) + MARGIN
        places = np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        self.angles = self._middle + self._half * places
        fits = np.polynomial.chebyshev.chebfit(places, np.eye(NODES), ORDER)
        # (ORDER + 1, NODES): values at the nodes -> coefficients
        self.weights = np.array([np.polynomial.chebyshev.cheb2poly(fit) for fit in fits.T]).T

    def terms(self, leg, angle) -> ca.SX:
        """Return what is tabulated at an angle, (TERMS, 1)."""
        velocity = ca.SX.sym("velocity")
        bare, loaded = (leg_model.mechanics(angle, velocity, leg, extra) for extra in (0.0, 1.0))
        foot = loaded.inertia - bare.inertia, loaded.gravity - bare.gravity
        return ca.cse(ca.vertcat(bare.inertia, bare.gravity, *foot))

    def mechanics(self, coefficients: ca.SX):
        """Return a function as `leg.mechanics` from (TERMS * (ORDER + 1)) coefficients, term by term."""
        inertia, gravity, foot_inertia, foot_gravity = ca.vertsplit(coefficients, ORDER + 1)

        def mechanics(q, velocity, _leg, extra_foot_mass=0.0):
            place = ca.fmin(ca.fmax((q - self._middle) / self._half, -1), 1)
            mass, slope = _horner(inertia + extra_foot_mass * foot_inertia, place)
            weight, _ = _horner(gravity + extra_foot_mass * foot_gravity, place)
            return leg_model.Mechanics(mass, 0.5 * slope / self._half * velocity**2, weight)

        return mechanics


def _horner(coefficients: ca.SX, x):
    """Return a polynomial and its derivative."""
    value, slope = coefficients[ORDER], 0.0
    for k in reversed(range(ORDER)):
        slope = slope * x + value
        value = value * x + coefficients[k]
    return value, slope
