# SPDX-License-Identifier: Apache-2.0
"""Volume polynomials, Eqs. (15)-(17)."""

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import Volumes
from pam_orthosis.identification.volume import fit_volume

V, W = [1.6e-4, 2.7e-3, -9.6e-3], [1.0, 6.0e-8, -1.0e-14]


def points(noise=0.0, stations=7):
    x, p = np.meshgrid(np.linspace(0, 0.12, stations), np.linspace(1e5, 6e5, 6))
    x, p = x.ravel(), p.ravel()
    volume = np.polynomial.polynomial.polyval(x, V) * np.polynomial.polynomial.polyval(p, W)
    volume *= 1 + noise * np.random.default_rng(1).standard_normal(len(x))
    return Volumes(p, x, volume)


def test_exact_points_give_the_coefficients_back():
    fit = fit_volume(points(), "dmsp_20")
    assert fit.v == pytest.approx(V, rel=1e-6)
    assert fit.w == pytest.approx(W, rel=1e-5)
    assert fit.rms < 1e-12


def test_noise_stays_within_the_intervals():
    fit = fit_volume(points(noise=0.005), "dmsp_20")
    error = np.abs(np.concatenate([fit.v - V, fit.w[1:] - W[1:]]))
    assert (error < 2 * fit.half_width).all()
    assert fit.rms < 0.01 * V[0] * 2


def test_a_dmsp_10_has_a_straight_line_in_the_contraction():
    assert len(fit_volume(points(), "dmsp_10").v) == 2


def test_too_few_points_are_refused():
    with pytest.raises(OrthosisError, match="too few"):
        fit_volume(Volumes(*(v[:4] for v in vars(points()).values())), "dmsp_20")
