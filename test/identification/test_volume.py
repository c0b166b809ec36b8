# SPDX-License-Identifier: Apache-2.0
"""Volume polynomials, Eqs. (15)-(17)."""

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import Volumes
from pam_orthosis.identification.volume import fit_volume
from pam_orthosis.model.components.muscle import geometric_force, geometric_volume
from pam_orthosis.model.parameters import load

V, W = [1.6e-4, 2.7e-3, -9.6e-3], [1.0, 6.0e-8, -1.0e-14]


def points(noise=0.0, stations=7):
    x, p = np.meshgrid(np.linspace(0, 0.12, stations), np.linspace(1e5, 6e5, 6))
    x, p = x.ravel(), p.ravel()
    volume = np.polynomial.polynomial.polyval(x, V) * np.polynomial.polynomial.polyval(p, W)
    volume *= 1 + noise * np.random.default_rng(1).standard_normal(len(x))
    return Volumes(p, x, volume)


def test_exact_points_give_the_coefficients_back():
    fit = fit_volume(points(), 2)
    assert fit.v == pytest.approx(V, rel=1e-6)
    assert fit.w == pytest.approx(W, rel=1e-5)
    assert fit.rms < 1e-12


def test_noise_stays_within_the_intervals():
    fit = fit_volume(points(noise=0.005), 2)
    error = np.abs(np.concatenate([fit.v - V, fit.w[1:] - W[1:]]))
    assert (error < 2 * fit.half_width).all()
    assert fit.rms < 0.01 * V[0] * 2


def test_a_dmsp_10_has_a_straight_line_in_the_contraction():
    assert len(fit_volume(points(), 1).v) == 2


def test_too_few_points_are_refused():
    with pytest.raises(OrthosisError, match="too few"):
        fit_volume(Volumes(*(v[:4] for v in vars(points()).values())), 2)


def where(keep):
    """Return the exact points that a function of contraction and pressure keeps."""
    data = points()
    mask = keep(data.contraction, data.pressure)
    return Volumes(*(values[mask] for values in vars(data).values()))


@pytest.mark.parametrize(
    ("keep", "said"),
    [
        (lambda x, p: p == 2e5, r"few pressures \(1\): a polynomial of degree 2 needs 3"),
        (lambda x, p: p < 3e5, r"few pressures \(2\)"),
        (lambda x, p: x < 0.03, r"few contractions \(2\): a polynomial of degree 2 needs 3"),
    ],
)
def test_pressures_and_contractions_must_suffice_for_the_degrees(keep, said):
    with pytest.raises(OrthosisError, match=said):
        fit_volume(where(keep), 2)


def test_the_noise_of_one_pressure_makes_no_second_one():
    data = where(lambda x, p: p < 3e5)
    noise = 3e3 * np.random.default_rng(2).standard_normal(len(data.pressure))
    with pytest.raises(OrthosisError, match=r"few pressures \(2\)"):
        fit_volume(Volumes(data.pressure + noise, data.contraction, data.volume), 2)


def test_points_that_cannot_tell_the_coefficients_apart_are_refused():
    """Three contractions at one pressure, all other pressures at a fourth one with nothing enclosed."""
    x = np.array([0.0, 0.04, 0.08, 0.12, 0.12, 0.12])
    p = np.array([2e5, 2e5, 2e5, 2e5, 4e5, 6e5])
    volume = np.where(x < 0.1, 1e-4 * (1 - x / 0.12), 0.0)
    with pytest.raises(OrthosisError, match="only 3 of 5 coefficients of the volume"):
        fit_volume(Volumes(p, x, volume), 2)


def braid_points(m):
    """Return exact volumes of the emulated muscle wherever it is taut: farther, the higher the pressure."""
    rows = []
    for pressure in np.linspace(1e5, 6e5, 6).tolist():
        taut = [x for x in np.linspace(0, 0.05, 26).tolist() if float(geometric_force(x, pressure, m)) > 0]
        rows += [(pressure, x, float(geometric_volume(x, pressure, m))) for x in taut]
    return Volumes(*np.array(rows).T)


def test_a_bent_volume_does_not_pass_for_one_that_depends_on_the_pressure():
    """Together with a straight v, w takes what a stronger contraction at a higher pressure leaves over."""
    m = load().muscle.dmsp_10
    straight, bent = (fit_volume(braid_points(m), degree) for degree in (1, 2))
    assert straight.w == pytest.approx(bent.w)
    assert len(straight.half_width) == 4
    slope = np.polynomial.polynomial.polyder(straight.w)
    for pressure in (1e5, 3e5, 5e5):
        growth = m.geometry.volume_compliance / (1 + m.geometry.volume_compliance * pressure)
        found = np.polynomial.polynomial.polyval(pressure, slope) / straight.volume(0.0, pressure)
        assert found * straight.v[0] == pytest.approx(growth, rel=0.05)
