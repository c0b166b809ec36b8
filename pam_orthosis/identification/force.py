# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the force polynomial, Eqs. (14) and (19)-(23), by a well-conditioned solver.

Eq. (23) inverts B^T B, whose condition number is the square of B's. The minimum of Eq. (21), with each error
over its expected size (`balanced_weights`), is found here by a singular value decomposition of B with its
columns scaled to equal norm.

B is taken in blocks of rows, each folded into the triangle R of B = Q R: what is worked on stays in the
processor's cache however many samples there are, and R has the singular values of B.

Rows of one run, or of one repeat, are off together: hysteresis, creep and a load cell's drift shift all of
them alike. Intervals are those of whole clusters, each left out in turn (the delete-one-group jackknife).
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate

import numpy as np
from scipy import fft, stats

from pam_orthosis.bag.tracking import rms
from pam_orthosis.errors import OrthosisError
from pam_orthosis.identification.groups import LEAST_REPEATS, numbered
from pam_orthosis.identification.samples import Samples
from pam_orthosis.model.components.muscle import polynomial
from pam_orthosis.progress import Progress, counted, silent

RANK_TOLERANCE = 1.0e-9  # of a singular value, relative to the largest (columns of equal norm)
BLOCK = 800  # samples; beyond some 900 the linear algebra library spreads a block over all cores, in vain
REPEATS, RUNS = "repeats", "runs"


@dataclass(frozen=True)
class ForceModel:
    """Eqs. (13)-(14): a (area function), b (counterforce), damping D, N s/m."""

    a: np.ndarray
    b: np.ndarray
    damping: float

    def towing(self, contraction: np.ndarray, pressure: np.ndarray | float) -> np.ndarray:
        """Return F_tow of Eq. (14), N (m, gauge Pa); negative where the muscle hangs slack."""
        return np.asarray(polynomial(self.a, contraction) * pressure - polynomial(self.b, contraction))

    def force(self, s: Samples) -> np.ndarray:
        """Return F_M of Eq. (19), N."""
        return self.towing(s.contraction, s.pressure) - self.damping * s.rate

    def residual(self, s: Samples) -> np.ndarray:
        """Return e_M of Eq. (20), measured - modelled force, N."""
        return np.asarray(s.force - self.force(s))


@dataclass(frozen=True)
class ForceFit:
    """A fitted model and how well the data determine it.

    `half_width` holds half the 95 % interval of each coefficient, a then b: between `clusters` clusters of
    the kind `clustered`, or of independent samples (empty: clusters are too few). With repeats it is the
    interval in which another repeat's coefficient lies. `condition` is that of the scaled matrix,
    `condition_raw` that of B as Eq. (23) would square it. `effective` is the number of independent samples,
    after the autocorrelation of the residuals.
    """

    model: ForceModel
    half_width: np.ndarray
    rank: int
    condition: float
    condition_raw: float
    effective: float
    clusters: int = 0
    clustered: str = ""


def design(s: Samples, degrees: tuple[int, int]) -> np.ndarray:
    """Return the measurement matrix B of Eq. (19), (n, degree_a + degree_b + 2)."""
    powers = np.vander(s.contraction, max(degrees) + 1, increasing=True)
    return np.hstack([powers[:, : degrees[0] + 1] * s.pressure[:, None], -powers[:, : degrees[1] + 1]])


def blocks(length: int) -> Iterator[slice]:
    """Return what divides so many samples into blocks."""
    return (slice(start, start + BLOCK) for start in range(0, length, BLOCK))


def triangle(rows: Iterable[np.ndarray]) -> np.ndarray:
    """Return R of the QR decomposition of the matrix that these blocks of rows make up."""
    found = None
    for block in rows:  # numpy's types know no mode "r": hence `asarray`
        found = np.asarray(np.linalg.qr(block if found is None else np.vstack([found, block]), mode="r"))
    assert found is not None  # no matrix is without rows
    return found


def nominal_rank(s: Samples, degrees: tuple[int, int]) -> int:
    """Return the rank of B at the nominal pressures.

    The noise of a pressure that was held constant makes B look as if the pressure had varied.
    """
    nominal = replace(s, pressure=s.level)
    r = triangle(design(nominal.where(block), degrees) for block in blocks(len(s)))
    singular = np.linalg.svd(r / np.linalg.norm(r, axis=0), compute_uv=False)
    return int((singular > RANK_TOLERANCE * singular[0]).sum())


def balanced_weights(s: Samples) -> np.ndarray:
    """Return the weights 1 / sigma, evened so that both directions of a level count the same.

    The hysteresis has opposite signs in both directions: more samples of one would pull the model
    to its side. A row at rest counts as one that moves, all of a level at most as one direction: a turning
    point has few.
    """
    level = np.unique(s.level, return_inverse=True)[1]
    way = np.sign(s.direction).astype(int) + 1
    count = np.bincount(3 * level + way, minlength=3 * (level.max() + 1)).reshape(-1, 3).astype(float)
    moving = count[:, [0, 2]]
    count[:, 1] = np.maximum(count[:, 1], moving.sum(axis=1) / np.maximum((moving > 0).sum(axis=1), 1))
    return np.asarray(1 / s.sigma / np.sqrt(count[level, way]))


def fit_force(s: Samples, damping: float = 0.0, degrees: tuple[int, int] = (3, 4)) -> ForceFit:
    """Fit the coefficients of Eq. (14) to samples, the damping part being known, Eq. (23).

    The weighted index of Eq. (21) is minimised, its gradient vanishing as Eq. (22) asks, by singular values.
    Eq. (23) prints the inverse of B^T B, which squares its condition number, without weights.

    Args:
        s: samples of a taut muscle.
        damping: D, N s/m.
        degrees: of area function and counterforce; (3, 4) in Eq. (14).

    Raises:
        OrthosisError: fewer samples than coefficients, or samples that do not identify them.
    """
    count = sum(degrees) + 2
    if len(s) <= count:
        raise OrthosisError(
            f"{len(s)} taut samples are too few for {count} coefficients: give more than {count}, or ask for"
            " fewer with --degrees"
        )
    weights = balanced_weights(s)
    kind, member = clusters(s)
    each = (member == one for one in range(member.max() + 1))
    parts = [_folded(s.where(rows), weights[rows], damping, degrees) for rows in each]
    r = triangle(parts)
    weighted, target = r[:count, :count], r[:count, count]
    scale = np.linalg.norm(weighted, axis=0)
    if not scale.all():
        raise OrthosisError("the contraction does not vary: the coefficients of Eq. (14) stay unknown")
    rank = nominal_rank(s, degrees)
    if rank < count:
        raise OrthosisError(_deficient(s, rank, count, degrees))
    u, singular, vt = np.linalg.svd(weighted / scale)
    theta = vt.T @ (u.T @ target / singular) / scale
    model = ForceModel(theta[: degrees[0] + 1], theta[degrees[0] + 1 :], damping)
    residual = np.concatenate([weights[block] * model.residual(s.where(block)) for block in blocks(len(s))])
    effective = len(s) / autocorrelation_time(residual, s.serial)
    freedom = max(effective - count, 1.0)
    variance = np.sum(residual**2) / freedom  # a product of long vectors would wake all cores
    spread = np.sqrt(np.sum((vt.T / singular) ** 2, axis=1) * variance) / scale
    confidence = 0.95
    half_width = float(stats.t.ppf(0.5 + confidence / 2, freedom)) * spread
    between = cluster_spread(parts, kind)
    if between is not None:
        half_width = float(stats.t.ppf(0.5 + confidence / 2, len(parts) - 1)) * between
    raw = np.linalg.cond(weighted)
    return ForceFit(
        model, half_width, rank, float(singular[0] / singular[-1]), float(raw), effective,
        len(parts), kind if between is not None else "",
    )  # fmt: skip


def _folded(s: Samples, weights: np.ndarray, damping: float, degrees: tuple[int, int]) -> np.ndarray:
    """Return the triangle of the weighted rows of B and of what they are to explain."""
    parts = ((weights[block, None], s.where(block)) for block in blocks(len(s)))
    return triangle(
        weight * np.column_stack([design(part, degrees), part.force + damping * part.rate])
        for weight, part in parts
    )


def autocorrelation_time(residual: np.ndarray, serial: np.ndarray) -> float:
    """Return how many neighbouring residuals of a run say the same; 1 for a table."""
    times = [1.0]
    for e in _runs(residual, serial):
        power = np.abs(np.fft.rfft(e, fft.next_fast_len(2 * len(e), real=True))) ** 2
        correlation = np.fft.irfft(power)[: len(e)] / max(float(e @ e), 1e-300)
        negative = np.flatnonzero(correlation <= 0)
        last = negative[0] if len(negative) else len(e)
        times.append(1 + 2 * float(correlation[1:last].sum()))
    return float(np.mean(times[1:])) if len(times) > 1 else 1.0


def _runs(residual: np.ndarray, serial: np.ndarray) -> list[np.ndarray]:
    """Return the residuals of each run, by sorting: a look for each run would be one at all samples."""
    order = np.argsort(serial, kind="stable")[np.count_nonzero(serial < 0) :]
    if not len(order):
        return []
    return np.split(residual[order], np.flatnonzero(np.diff(serial[order])) + 1)


def leave_one_out(
    s: Samples, group: np.ndarray, fit: Callable[[Samples], ForceFit], progress: Progress = silent
) -> dict[float, tuple[float, float] | None]:
    """Return for each value of `group` RMS and maximum error, N, of a fit without it.

    None where the rest cannot determine the coefficients.
    """
    errors: dict[float, tuple[float, float] | None] = {}
    for value in counted(np.unique(group).tolist(), progress, "fitting without each group"):
        try:
            model = fit(s.where(group != value)).model
        except OrthosisError:
            errors[value] = None
            continue
        errors[value] = rms_and_max(model.residual(s.where(group == value)))
    return errors


def rms_and_max(residual: np.ndarray) -> tuple[float, float]:
    """Return RMS and largest absolute value."""
    return rms(residual), float(np.abs(residual).max())


def _deficient(s: Samples, rank: int, count: int, degrees: tuple[int, int]) -> str:
    lengths = len(np.unique(np.round(s.contraction, 4)))
    levels = len(np.unique(np.round(s.level, -3)))
    return (
        f"the data determine only {rank} of {count} coefficients of Eq. (14): {lengths} contractions at"
        f" {levels} pressures; a degree of {degrees[1]} needs {degrees[1] + 1} contractions, each at two"
        " pressures: measure more, or ask for less with --degrees"
    )


def clusters(s: Samples) -> tuple[str, np.ndarray]:
    """Return the kind and the number of each row's cluster: its repeat, or one way of a level's run."""
    if len(np.unique(s.repeat)) >= LEAST_REPEATS:
        return REPEATS, numbered(s.repeat)
    return RUNS, numbered(s.repeat, s.serial, s.level, s.direction)


def cluster_spread(parts: Sequence[np.ndarray], kind: str) -> np.ndarray | None:
    """Return the standard deviation of each coefficient between clusters; of repeats that of a further one.

    Args:
        parts: of each cluster the rows of B and what they explain, (k, coefficients + 1), or their triangle.
        kind: REPEATS or RUNS.

    None: there are too few clusters, or without one the rest cannot determine the coefficients.
    """
    count = len(parts)
    if count < LEAST_REPEATS:
        return None
    before, after = _folded_up(parts), _folded_up(parts[::-1])[::-1]
    each = (_solved(np.vstack([before[i], after[i]])) for i in range(count))
    solved = [one for one in each if one is not None]
    if len(solved) < count:
        return None
    deviation = np.array(solved) - np.mean(solved, axis=0)
    variance = (count - 1) / count * np.sum(deviation**2, axis=0)
    # a single repeat scatters `count` times as much as the fit to all, which scatters too
    return np.asarray(np.sqrt(variance * (count + 1 if kind == REPEATS else 1)))


def _folded_up(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the triangle of what is before each part."""
    none = np.zeros((0, parts[0].shape[1]))
    return list(accumulate(parts[:-1], lambda r, one: triangle([np.vstack([r, one])]), initial=none))


def _solved(rows: np.ndarray) -> np.ndarray | None:
    r = triangle([rows])
    count = rows.shape[1] - 1
    scale = np.linalg.norm(r[:count, :count], axis=0)
    if not scale.all():
        return None
    u, singular, vt = np.linalg.svd(r[:count, :count] / scale)
    if singular[-1] < RANK_TOLERANCE * singular[0]:
        return None
    return np.asarray(vt.T @ (u.T @ r[:count, count] / singular) / scale)
