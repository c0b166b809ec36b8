# SPDX-License-Identifier: Apache-2.0
"""Least squares of Eqs. (19)-(23): recovers, weighs, refuses."""

import tracemalloc

import numpy as np
import pytest

from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.data import Samples
from pam_orthosis.identification.force import (
    BLOCK,
    RUNS,
    autocorrelation_time,
    balanced_weights,
    blocks,
    cluster_spread,
    design,
    fit_force,
    leave_one_out,
    triangle,
)

A = np.array([2.8e-3, -2.0e-2, 5.0e-2, -2.0e-1])
B = np.array([-3.0, 2.0e4, -4.3e5, 4.0e6, -1.3e7])
D = 150.0


def samples(lengths=12, levels=6, noise=0.0, seed=0, rate=0.0, hysteresis=0.0):
    x, p = np.meshgrid(np.linspace(0, 0.1, lengths), np.linspace(1e5, 6e5, levels))
    x, p = x.ravel(), p.ravel()
    random = np.random.default_rng(seed)
    v = rate * np.where(random.random(len(x)) > 0.7, 1.0, -1.0)
    force = np.polynomial.polynomial.polyval(x, A) * p - np.polynomial.polynomial.polyval(x, B) - D * v
    force += noise * random.standard_normal(len(x)) - hysteresis * np.sign(v)
    one = np.ones_like(x)
    return Samples(p, x, v, force, one, p.copy(), -one)


def test_exact_data_give_the_coefficients_back():
    """Eqs. (19) and (21) to (23): nothing is left to minimise."""
    fit = fit_force(samples(rate=0.1), D)
    assert fit.model.a == pytest.approx(A, rel=1e-6)
    assert fit.model.b == pytest.approx(B, rel=1e-5, abs=1e-3)
    assert fit.rank == 9


def test_a_wrong_damping_shows_in_the_residual():
    """Eq. (20) without and with an error."""
    s = samples(rate=0.1)
    assert np.abs(fit_force(s, D).model.residual(s)).max() < 1e-6
    assert np.abs(fit_force(s, 0.0).model.residual(s)).max() > 5.0


def test_the_normal_equations_of_eq_23_agree_where_they_can_be_solved():
    """Eq. (23) as printed, with weights."""
    s = samples(noise=3.0, rate=0.05)
    fit = fit_force(s, D, degrees=(1, 1))
    b = design(s, (1, 1))
    weights = np.ones(len(s))
    for sign in (1, -1):  # the fit lets both directions of a level count the same
        for level in np.unique(s.level):
            group = (s.direction == sign) & (s.level == level)
            weights[group] = 1 / max(group.sum(), 1)
    bw = b * weights[:, None]
    theta = np.linalg.solve(bw.T @ b, bw.T @ (s.force + D * s.rate))
    assert np.concatenate([fit.model.a, fit.model.b]) == pytest.approx(theta, rel=1e-6)


@pytest.mark.parametrize(("resting", "share"), [(3, 3 / 90), (90, 1.0), (400, 1.0), (0, 0.0)])
def test_rows_at_rest_count_by_their_number_and_at_most_as_one_direction(resting, share):
    """A turning point of three rows is no direction of its own."""
    way = np.repeat([1.0, -1.0, 0.0], [60, 120, resting])
    one = np.ones_like(way)
    s = Samples(1e5 * one, 0.01 * one, 0.0 * one, one, one, one, -one, way)
    squares = balanced_weights(s) ** 2
    assert [squares[way == sign].sum() for sign in (1, -1, 0)] == pytest.approx([1.0, 1.0, share])


def test_without_any_direction_each_level_counts_the_same():
    one, level = np.ones(40), np.repeat([1e5, 2e5], [10, 30])
    squares = balanced_weights(Samples(level, 0.01 * one, 0.0 * one, one, one, level, -one)) ** 2
    assert [squares[level == at].sum() for at in (1e5, 2e5)] == pytest.approx([1.0, 1.0])


def test_blocks_of_samples_give_what_all_at_once_give():
    s = samples(lengths=500, noise=3.0, rate=0.05)
    assert len(s) > 3 * BLOCK
    assert len(s) % BLOCK
    weights = balanced_weights(s)
    whole = design(s, (3, 4)) * weights[:, None]
    scale = np.linalg.norm(whole, axis=0)
    fit = fit_force(s, D)
    theta = np.linalg.lstsq(whole / scale, weights * (s.force + D * s.rate), rcond=None)[0] / scale
    assert np.concatenate([fit.model.a, fit.model.b]) == pytest.approx(theta, rel=1e-9)
    parts = triangle(whole[block] for block in blocks(len(s)))
    assert np.linalg.svd(parts / scale, compute_uv=False) == pytest.approx(
        np.linalg.svd(whole / scale, compute_uv=False), rel=1e-9
    )


def test_a_fit_needs_little_memory_beside_its_samples():
    """What outgrows the cache makes a sample of a long recording cost more than one of a short one."""
    peaks = []
    for lengths in (5_000, 20_000):
        s = samples(lengths, noise=3.0)
        tracemalloc.start()
        fit_force(s, D)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    numbers_a_sample = (peaks[1] - peaks[0]) / (15_000 * 6) / 8
    assert numbers_a_sample < 9, "the matrix alone has nine"


def test_scaling_improves_the_condition_by_orders():
    fit = fit_force(samples())
    assert fit.condition < 1e4
    assert fit.condition_raw > 1e6 * fit.condition


def test_intervals_cover_the_truth_nine_times_out_of_ten():
    inside = []
    for seed in range(60):
        fit = fit_force(samples(noise=4.0, seed=seed))
        inside.append(np.abs(np.concatenate([fit.model.a - A, fit.model.b - B])) <= fit.half_width)
    assert 0.9 <= np.mean(inside) <= 0.99


def test_unequal_noise_counts_by_its_weight():
    s = samples(noise=1.0, seed=1)
    bad = np.arange(len(s)) % 2 == 0
    force = s.force + np.where(bad, 80.0, 0.0)
    weighted = Samples(s.pressure, s.contraction, s.rate, force, np.where(bad, 1e3, 1.0), s.level, s.serial)
    equal = Samples(s.pressure, s.contraction, s.rate, force, s.sigma, s.level, s.serial)
    error = [np.abs(fit_force(x).model.residual(s)).mean() for x in (weighted, equal)]
    assert error[0] < 3.0
    assert error[1] > 20.0


def test_more_samples_of_one_direction_do_not_pull_the_model_to_its_side():
    s = samples(rate=0.05, hysteresis=10.0, lengths=60)
    residual = fit_force(s, D).model.residual(s)
    for level in np.unique(s.level):
        up = residual[(s.direction > 0) & (s.level == level)].mean()
        down = residual[(s.direction < 0) & (s.level == level)].mean()
        assert up == pytest.approx(-10, abs=3.0)
        assert down == pytest.approx(10, abs=3.0)


@pytest.mark.parametrize(
    ("lengths", "levels", "message"),
    [(4, 6, "only 8 of 9"), (12, 1, "of 9 coefficients"), (2, 3, "too few")],
)
def test_data_that_cannot_tell_the_coefficients_apart_are_refused(lengths, levels, message):
    with pytest.raises(OrthosisError, match=message):
        fit_force(samples(lengths, levels))


def test_one_contraction_only_is_refused():
    s = samples()
    still = s.where(s.contraction == 0.0)
    with pytest.raises(OrthosisError):
        fit_force(Samples(*(np.tile(v, 5) for v in vars(still).values())))


def test_leaving_a_length_out_shows_interpolation():
    s = samples(lengths=5, noise=2.0)
    errors = leave_one_out(s, s.contraction, fit_force)
    assert len(errors) == 5
    assert set(errors.values()) == {None}, "four lengths cannot carry a quartic"
    more = samples(lengths=9, noise=2.0)
    told = leave_one_out(more, more.contraction, fit_force)
    assert all(e is not None and e[0] < 60.0 for e in told.values())


def test_neighbours_that_say_the_same_count_once():
    random = np.random.default_rng(0)
    white = random.standard_normal(2000)
    slow = np.convolve(random.standard_normal(2050), np.ones(20), "valid")[:2000]
    serial = np.zeros(2000)
    assert autocorrelation_time(white, serial) < 2
    assert autocorrelation_time(slow, serial) > 8
    assert autocorrelation_time(white, serial - 1) == 1.0


def test_runs_are_told_apart_however_they_are_mixed_with_each_other_and_with_a_table():
    random = np.random.default_rng(0)
    runs = [
        np.convolve(random.standard_normal(900 + width), np.ones(width), "valid")[:900] for width in (5, 30)
    ]
    alone = [autocorrelation_time(run, np.zeros(900)) for run in runs]
    mixed = np.column_stack([*runs, random.standard_normal(900)]).ravel()
    assert autocorrelation_time(mixed, np.tile([0.0, 1.0, -1.0], 900)) == pytest.approx(np.mean(alone))


def test_the_spread_between_clusters_is_that_of_fits_without_each():
    random = np.random.default_rng(0)
    parts = [random.standard_normal((7, 4)) for _ in range(5)]
    without = [np.vstack(parts[:i] + parts[i + 1 :]) for i in range(5)]
    solved = [np.linalg.lstsq(one[:, :3], one[:, 3])[0] for one in without]
    assert cluster_spread(parts, RUNS) == pytest.approx(np.std(solved, axis=0) * 2)
