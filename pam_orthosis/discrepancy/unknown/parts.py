# SPDX-License-Identifier: Apache-2.0
"""The parts of a curve: its shape, what repeats, and the constant that it is above all."""

import numpy as np

from pam_orthosis.discrepancy.unknown import waves
from pam_orthosis.discrepancy.unknown.curve_fit import Spline, without_parabola

CONSTANT = 3.0  # mean of a curve over half of its range
VISIBLE = 4.0  # standard deviations of a shape somewhere


def parts_of(
    places: np.ndarray, values: np.ndarray, covariance: np.ndarray, own: bool, spline: Spline
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float | None, float]:
    """Return values, shape, its covariance, period and level of a curve, that of an own signal or another."""
    weight = 1 / np.maximum(np.diag(covariance), 1e-300)
    if spline.harmonics:
        mean, wave = waves.wave_of(places, spline.period, spline.harmonics)
        shape, covariance = wave @ values, wave @ covariance @ wave.T
        level = _constant(values, weight, shape, covariance) if own else float(mean @ values)
        return values - level, shape, covariance, spline.period, level
    certain = without_parabola(places, weight) if own else np.eye(len(places)) - weight / weight.sum()
    shape, covariance = certain @ values, certain @ covariance @ certain.T
    period = spline.period or waves.wave_period(places, shape, np.sqrt(np.maximum(np.diag(covariance), 0.0)))
    if own:
        level = _constant(values, weight, shape, covariance)
        return values - level, shape, covariance, period, level
    return shape, shape, covariance, period, float((values - shape)[0])


def _constant(values: np.ndarray, weight: np.ndarray, shape: np.ndarray, covariance: np.ndarray) -> float:
    """Return the mean of a curve that hardly changes and has no shape; nought of any other."""
    mean = float(np.average(values, weights=weight))
    half = float(np.sqrt(3 * np.average((values - mean) ** 2, weights=weight)))
    flat = bool(np.all(shape**2 <= VISIBLE**2 * np.diag(covariance)))
    return mean if flat and abs(mean) > CONSTANT * half else 0.0
