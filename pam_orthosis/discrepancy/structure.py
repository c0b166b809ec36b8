# SPDX-License-Identifier: Apache-2.0
"""Is anything left? Structure in the final residuals, and where it is."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pam_orthosis.discrepancy.fit import Fit, Problem, misfit, normal_equations

# density of whitened residuals over white noise where it is largest; noise alone reaches 1 to 1.7
CLEAN = 2.5
BINS = 12


@dataclass(frozen=True)
class Where:
    """Where a model disagrees with recordings.

    Attributes:
        equation: that has it.
        strength: power density over white noise, where it is largest.
        coordinates: signal -> share of the residual's slow part that it explains (correlation ratio).
    """

    equation: str
    strength: float
    coordinates: dict[str, float]


def locate(problem: Problem, model: Fit) -> list[Where]:
    """Return every equation with its strength and the signals that its residual depends on.

    What the fit knows only roughly follows the recordings as far as its uncertainty allows: a map that
    was fitted in one region is not a missing effect in the next.
    """
    plain = problem.weighted({e.name: 1.0 for e in problem.system.equations})
    found = []
    residuals = _followed(plain, model)
    for equation in problem.system.equations:
        residual = residuals[equation.name]
        strength = misfit(plain, equation, residual)
        found.append(Where(equation.name, strength, _coordinates(plain, equation, residual)))
    return sorted(found, key=lambda one: -one.strength)


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


def clean(places: list[Where]) -> bool:
    """Whether nothing but noise is left."""
    return all(one.strength < CLEAN for one in places)


def _coordinates(problem: Problem, equation, residual: np.ndarray) -> dict[str, float]:
    """Return how much of the residual each recorded signal explains, by conditional means."""
    start, shares = 0, {}
    for one in problem.scored:
        length = one.run.recording.samples - one.warm_up
        signals = {c.name: one.run.smooth(c.name)[one.warm_up :] for c in problem.system.channels}
        signals.update(
            (name, one.run.recording.signals[name][one.warm_up :])
            for name in problem.system.inputs
            if name in one.run.recording.signals
        )
        for derived, parent in problem.system.derived.items():
            if parent in signals:
                signals[derived] = np.gradient(signals[parent], one.run.period)
        signals["time"] = np.arange(length) * one.run.period
        for _ in equation.channels:
            piece = residual[start : start + length]
            start += length
            for name, values in signals.items():
                shares.setdefault(name, []).append(_correlation_ratio(piece, values))
    ordered = sorted(((name, float(np.mean(many))) for name, many in shares.items()), key=lambda p: -p[1])
    return dict(ordered)


def _correlation_ratio(residual: np.ndarray, signal: np.ndarray) -> float:
    """Return the share of variance that the conditional mean over equally filled bins explains."""
    edges = np.quantile(signal, np.linspace(0, 1, BINS + 1)[1:-1])
    place = np.searchsorted(edges, signal)
    count = np.bincount(place, minlength=BINS)
    mean = np.bincount(place, residual, minlength=BINS) / np.maximum(count, 1)
    explained = float(np.sum(count * mean**2)) / max(float(np.sum(residual**2)), 1e-300)
    return max(0.0, explained - BINS / len(residual))
