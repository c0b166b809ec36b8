# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the volume polynomials, Eqs. (16)-(17), from measured cylinders, Eq. (15)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import Volumes
from pam_orthosis.model.muscle import polynomial

PRESSURE_DEGREE = 2
# degree in the contraction: Eq. (16) and Eq. (17)
CONTRACTION_DEGREE = {"dmsp_10": 1, "dmsp_20": 2}


@dataclass(frozen=True)
class VolumeFit:
    """v and w of Eqs. (16)-(17), w_0 = 1; half 95 % intervals (v, then w_1 ..); errors, m^3."""

    v: np.ndarray
    w: np.ndarray
    half_width: np.ndarray
    rms: float
    largest: float

    def volume(self, contraction: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """Return the volume, m^3 (m, gauge Pa)."""
        return polynomial(self.v, contraction) * polynomial(self.w, pressure)


def fit_volume(data: Volumes, specimen: str) -> VolumeFit:
    """Fit the product of polynomials; its scale goes to v, so that w_0 = 1.

    Raises:
        OrthosisError: too few measuring points.
    """
    degree = CONTRACTION_DEGREE[specimen]
    count = degree + 1 + PRESSURE_DEGREE
    points = len({(round(x, 3), round(p, -4)) for x, p in zip(data.contraction, data.pressure, strict=True)})
    if points <= count:
        raise OrthosisError(f"{points} measuring points are too few for {count} coefficients of the volume")
    length, level, size = np.ptp(data.contraction), data.pressure.max(), data.volume.mean()
    x, p, volume = data.contraction / length, data.pressure / level, data.volume / size

    def error(theta: np.ndarray) -> np.ndarray:
        return polynomial(theta[: degree + 1], x) * polynomial([1.0, *theta[degree + 1 :]], p) - volume

    start = np.concatenate([np.polynomial.polynomial.polyfit(x, volume, degree), np.zeros(PRESSURE_DEGREE)])
    fit = optimize.least_squares(error, start, method="lm", xtol=1e-14, ftol=1e-14)
    scale = np.concatenate([
        size / length ** np.arange(degree + 1), 1 / level ** np.arange(1, PRESSURE_DEGREE + 1)
    ])  # fmt: skip
    freedom = len(volume) - count
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * (fit.fun @ fit.fun) / freedom
    half = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(covariance)) * scale
    theta, residual = fit.x * scale, fit.fun * size
    w = np.concatenate([[1.0], theta[degree + 1 :]])
    rms = float(np.sqrt(np.mean(residual**2)))
    return VolumeFit(theta[: degree + 1], w, half, rms, float(np.abs(residual).max()))
