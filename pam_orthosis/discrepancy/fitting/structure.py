# SPDX-License-Identifier: Apache-2.0
"""Is anything left? Structure in the final residuals, and where it is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, misfit, normal_equations, peak
from pam_orthosis.discrepancy.fitting.measure import Samples
from pam_orthosis.discrepancy.fitting.signals import signals_of
from pam_orthosis.discrepancy.recordings.data import smoothed
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.system import Equation, System


def order(system: System, channel: str) -> int:
    """Return how often a channel's signal integrates: 2 for a position, 1 for a pressure, 0 for a force."""
    state = system.channel(channel).state
    if state is None:
        return 0
    return 2 if state in system.derived.values() else 1


def missing_rate(
    system: System, equation: Equation, channel: str, residual: np.ndarray, period: float, cutoff: float
) -> np.ndarray:
    """Return the rate (or acceleration, or value: see `order`) missing in the equation, below a cutoff, Hz.

    Args:
        residual: recorded minus predicted of the channel, (n,).
        period: s.
    """
    slow = smoothed(residual, period, cutoff)
    if order(system, channel) == 0:
        return slow
    gains = list(equation.gains[channel].values())
    slope: np.ndarray = np.gradient(slow, period)
    if order(system, channel) == 1:
        return slope + gains[0] * slow
    bend: np.ndarray = np.gradient(slope, period)
    return bend + gains[0] * slope + gains[1] * slow


# density of whitened residuals over white noise where it is largest; noise alone reaches 1 to 1.7
CLEAN = 2.5
LONG = 3000  # scored samples: from there on noise alone stays below `CLEAN` / `MARGIN`
DRAWS, QUANTILE = 400, 0.99  # of white noise, for shorter recordings
MARGIN = 1.6  # over that: what a right model leaves is not quite white
BINS = 12


@dataclass(frozen=True)
class Where:
    """Where a model disagrees with recordings.

    Attributes:
        equation: that has it.
        density: power density over white noise, where it is largest. It separates structure from noise; how
            large a gap is, `measure.over_noise` says.
        coordinates: signal -> share of the residual's slow part that it explains (correlation ratio).
        regions: signal -> range of its values in which the squared residuals are largest.
        noise: density that noise alone does not reach in recordings of this length.
    """

    equation: str
    density: float
    coordinates: dict[str, float]
    regions: dict[str, tuple[float, float]]
    noise: float = CLEAN

    @property
    def clean(self) -> bool:
        """Whether nothing but noise is left."""
        return self.density < self.noise


def locate(problem: Problem, model: Fit, judged: Samples | None = None) -> list[Where]:
    """Return every equation with its density and the signals that its residual depends on.

    What the fit knows only roughly follows the recordings as far as its uncertainty allows: a map that
    was fitted in one region is not a missing effect in the next. `judged`: the samples that count (all).
    """
    plain = problem.weighted({e.name: 1.0 for e in problem.system.equations})
    found = []
    residuals = _followed(plain, model)
    for equation in problem.system.equations:
        residual = _counted(plain, equation, residuals[equation.name], judged)
        density = misfit(plain, equation, residual)
        noise = _reach(_lengths(plain, equation))
        found.append(Where(equation.name, density, *_coordinates(plain, equation, residual), noise))
    return sorted(found, key=lambda one: -one.density)


def _followed(problem: Problem, model: Fit) -> dict[str, np.ndarray]:
    """Return residuals with the free parameters updated, linearly, from their posterior of the fit."""
    names = tuple(one.name for one in model.free)
    blocks = problem.blocks(model.effects, model.values, names)
    loose = [replace(one, sd=np.inf) for one in model.free]
    hessian, gradient = normal_equations(blocks, loose, model.values)
    total = hessian + model.hessian
    step = np.linalg.solve(total + 1e-9 * np.diag(np.diag(total)), -gradient)
    moved = {one.name: float(x * one.scale) for one, x in zip(model.free, step, strict=True)}
    return {name: b.residual + b.slopes @ np.array([moved[n] for n in b.names]) for name, b in blocks.items()}


def _counted(
    problem: Problem, equation: Equation, residual: np.ndarray, judged: Samples | None
) -> np.ndarray:
    """Return a residual that is zero where samples do not count."""
    counted: np.ndarray = residual.copy()
    if judged is None:
        return counted
    for one, part in problem.by_run(equation, counted):
        for channel, piece in zip(equation.channels, part, strict=True):
            piece[~judged[one.run.serial, channel]] = 0.0
    return counted


def clean(places: Sequence[Where]) -> bool:
    """Whether nothing but noise is left."""
    return all(one.clean for one in places)


def _lengths(problem: Problem, equation: Equation) -> tuple[int, ...]:
    """Return the scored samples of each channel of each run."""
    lengths = [one.samples for one in problem.scored]
    return tuple(sorted(lengths * len(equation.channels)))


@lru_cache(maxsize=64)
def _reach(lengths: tuple[int, ...]) -> float:
    """Return the density that white noise of some lengths does not reach: `CLEAN` unless they are short."""
    if lengths[0] >= LONG:
        return CLEAN
    rng = np.random.default_rng(0)
    short = [length for length in lengths if length < LONG]
    drawn = [max(peak(rng.standard_normal(length)) for length in short) for _ in range(DRAWS)]
    return max(CLEAN, MARGIN * float(np.quantile(drawn, QUANTILE)))


def _coordinates(
    problem: Problem, equation: Equation, residual: np.ndarray
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Return how much of the residual each signal explains by conditional means, and where it is largest."""
    shares: dict[str, list[float]] = {}
    regions: dict[str, list[tuple[float, float, float]]] = {}
    for one, part in problem.by_run(equation, residual):
        signals = signals_of(problem.system, one)
        for piece in part:
            for name, values in signals.items():
                shares.setdefault(name, []).append(_correlation_ratio(piece, values))
                regions.setdefault(name, []).append(_region(piece, values))
    ordered = sorted(((name, float(np.mean(many))) for name, many in shares.items()), key=lambda p: -p[1])
    return dict(ordered), {name: max(many)[1:] for name, many in regions.items()}


def _region(residual: np.ndarray, signal: np.ndarray) -> tuple[float, float, float]:
    """Return the largest mean square over equally filled bins of a signal, and that bin's edges."""
    edges = np.quantile(signal, np.linspace(0, 1, BINS + 1))
    place = np.searchsorted(edges[1:-1], signal)
    count = np.maximum(np.bincount(place, minlength=BINS), 1)
    power = np.bincount(place, residual**2, minlength=BINS) / count
    worst = int(np.argmax(power))
    return float(power[worst]), float(edges[worst]), float(edges[worst + 1])


def _correlation_ratio(residual: np.ndarray, signal: np.ndarray) -> float:
    """Return the share of variance that the conditional mean over equally filled bins explains."""
    edges = np.quantile(signal, np.linspace(0, 1, BINS + 1)[1:-1])
    place = np.searchsorted(edges, signal)
    count = np.bincount(place, minlength=BINS)
    mean = np.bincount(place, residual, minlength=BINS) / np.maximum(count, 1)
    explained = float(np.sum(count * mean**2)) / max(float(np.sum(residual**2)), 1e-300)
    return max(0.0, explained - BINS / len(residual))
