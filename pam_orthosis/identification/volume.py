# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the volume polynomials, Eqs. (16)-(17), from measured cylinders, Eq. (15)."""

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.force import rms_and_max
from pam_orthosis.identification.samples import Volumes
from pam_orthosis.model.components.muscle import polynomial

PRESSURE_DEGREE = 2


@dataclass(frozen=True)
class VolumeFit:
    """v and w of Eqs. (16)-(17), w_0 = 1; half 95 % intervals (v, then w_1 ..); errors, m^3."""

    v: np.ndarray
    w: np.ndarray
    half_width: np.ndarray
    rms: float
    largest: float

    def volume(self, contraction: np.ndarray, pressure: np.ndarray | float) -> np.ndarray:
        """Return the volume, m^3 (m, gauge Pa)."""
        return np.asarray(polynomial(self.v, contraction) * polynomial(self.w, pressure))


def fit_volume(data: Volumes, degree: int) -> VolumeFit:
    """Fit the product of polynomials; its scale goes to v, so that w_0 = 1.

    `degree` is that in the contraction: 1 in Eq. (16), 2 in Eq. (17). Of Eq. (16), w is found beside a v of
    degree 2.

    Raises:
        OrthosisError: too few measuring points, pressures or contractions, or points that do not
            identify the coefficients.
    """
    bending = 2  # degree in the contraction at which w is found: a braid's volume is bent
    bends = max(degree, bending)
    near_contraction, near_pressure = 1e-3, 2e4  # m, Pa: measuring points that are nearer are one
    _check_spread("contractions", _apart(data.contraction, near_contraction), bends)
    _check_spread("pressures", _apart(data.pressure, near_pressure), PRESSURE_DEGREE)
    found = _product(data, bends)
    return found if bends == degree else _flattened(data, found, degree)


def _product(data: Volumes, degree: int) -> VolumeFit:
    """Fit v and w together."""
    count = degree + 1 + PRESSURE_DEGREE
    points = len({(round(x, 3), round(p, -4)) for x, p in zip(data.contraction, data.pressure, strict=True)})
    if points <= count:
        raise OrthosisError(f"{points} measuring points are too few for {count} coefficients of the volume")
    length, level, size = np.ptp(data.contraction), data.pressure.max(), data.volume.mean()
    x, p, volume = data.contraction / length, data.pressure / level, data.volume / size

    def error(theta: np.ndarray) -> np.ndarray:
        v, w = polynomial(theta[: degree + 1], x), polynomial([1.0, *theta[degree + 1 :]], p)
        return np.asarray(v * w - volume)

    def slopes(theta: np.ndarray) -> np.ndarray:  # exact: differences would blur the rank
        v, w = polynomial(theta[: degree + 1], x), polynomial([1.0, *theta[degree + 1 :]], p)
        return np.column_stack([
            np.vander(x, degree + 1, increasing=True) * w[:, None],
            np.vander(p, PRESSURE_DEGREE + 1, increasing=True)[:, 1:] * v[:, None],
        ])  # fmt: skip

    start = np.concatenate([np.polynomial.polynomial.polyfit(x, volume, degree), np.zeros(PRESSURE_DEGREE)])
    fit = optimize.least_squares(error, start, slopes, method="lm", xtol=1e-14, ftol=1e-14)
    _check_rank(fit.jac)
    scale = np.concatenate([
        size / length ** np.arange(degree + 1), 1 / level ** np.arange(1, PRESSURE_DEGREE + 1)
    ])  # fmt: skip
    half = _half_width(fit.jac, fit.fun) * scale
    theta, residual = fit.x * scale, fit.fun * size
    w = np.concatenate([[1.0], theta[degree + 1 :]])
    return VolumeFit(theta[: degree + 1], w, half, *rms_and_max(residual))


def _flattened(data: Volumes, bent: VolumeFit, degree: int) -> VolumeFit:
    """Fit v of a lower degree, w being known.

    A muscle contracts farther at a higher pressure. Fitted together, w would make up for what v of too low a
    degree misses over the contraction, and would say nothing of the pressure.
    """
    columns = np.vander(data.contraction, degree + 1, increasing=True)
    columns *= polynomial(bent.w, data.pressure)[:, None]
    scale = np.linalg.norm(columns, axis=0)
    v = np.linalg.lstsq(columns / scale, data.volume, rcond=None)[0] / scale
    residual = columns @ v - data.volume
    half = _half_width(columns / scale, residual) / scale
    return VolumeFit(
        v, bent.w, np.concatenate([half, bent.half_width[len(bent.v) :]]), *rms_and_max(residual)
    )


def _half_width(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return half the 95 % interval of each coefficient."""
    freedom = len(residual) - jacobian.shape[1]
    covariance = np.linalg.inv(jacobian.T @ jacobian) * (residual @ residual) / freedom
    return np.asarray(stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(covariance)))


def _apart(values: np.ndarray, near: float) -> int:
    """Return how many of some values lie apart from each other."""
    count, last = 0, -np.inf
    for value in np.sort(values):
        if value - last >= near:
            count, last = count + 1, value
    return count


def _check_spread(kind: str, there: int, degree: int) -> None:
    if there <= degree:
        raise OrthosisError(
            f"the volume was measured at too few {kind} ({there}): a polynomial of degree {degree} needs"
            f" {degree + 1}; measure more, or leave the volume out"
        )


def _check_rank(jacobian: np.ndarray) -> None:
    norm = np.linalg.norm(jacobian, axis=0)
    singular = np.linalg.svd(jacobian / np.where(norm > 0, norm, 1.0), compute_uv=False)
    rank_tolerance = 1e-8  # of the largest singular value, columns of equal norm
    rank, count = int((singular > rank_tolerance * singular[0]).sum()), jacobian.shape[1]
    if rank < count:
        raise OrthosisError(
            f"the measuring points determine only {rank} of {count} coefficients of the volume: measure each"
            " contraction at several pressures, or leave the volume out"
        )
