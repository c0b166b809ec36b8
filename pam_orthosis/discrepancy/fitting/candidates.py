# SPDX-License-Identifier: Apache-2.0
"""Candidates: each effect of the catalogue tried as part of the model, nuisance parameters beside it.

The nuisance parameters enter linearly at the present fit (variable projection): a candidate simulates
its own few parameters only. Large effects leave the range in which that is true; `fit.fit` polishes
the best ones.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from pam_orthosis.discrepancy.fitting.fit import Fit, bounded_step, fit
from pam_orthosis.discrepancy.fitting.free import WIDTHS, of_effect, scales_of
from pam_orthosis.discrepancy.fitting.projection import Level, Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.systems.system import Names, Values

QUARTERS = (0.0, 1.57, 3.14, -1.57)  # rad: phases at which a periodic effect starts
LOWEST_PEAK, HIGHEST_PEAK, MOST_PEAKS = 0.1, 20.0, 3  # Hz: where its frequency is looked for
NEAR = 0.01  # of the way from the off value to the typical one


class Trial:
    """One effect beside the present model: residuals by its parameters, everything else projected."""

    def __init__(self, projection: Projection, name: str):
        problem, known = projection.problem, projection.base.effects
        self.projection, self.name = projection, name
        self.beside = problem.system.beside(name, known)
        self.added = (*self.beside, name)
        self.effects = (*known, *self.added)
        lags = problem.system.catalogue[name].advance is not None
        touched = problem.replay.touched(name)
        self.equations = [e for e in problem.system.equations if lags or e.name in touched]
        self.free = [one for added in self.added for one in of_effect(problem.system, added)]
        self.scale = np.array([one.scale for one in self.free])
        typical = problem.replay.defaults(self.added)
        own = tuple(f"{added}." for added in self.added)  # a nuisance parameter may be called as an effect
        self._rest = {key: value for key, value in typical.items() if key.startswith(own)}

    def values(self, position: np.ndarray, nuisance: np.ndarray | None = None) -> dict[str, float]:
        """Return all parameters at scaled positions of its own and of the nuisance ones (of the base)."""
        own = {one.name: float(x * s) for one, x, s in zip(self.free, position, self.scale, strict=True)}
        rest = {} if nuisance is None else self.projection.values(nuisance)
        return {**self.projection.base.values, **rest, **self._rest, **own}

    def residuals(self, position: np.ndarray, nuisance: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Return whitened residuals: of the equations that it changes."""
        values, problem = self.values(position, nuisance), self.projection.problem
        with np.errstate(all="ignore"):
            return {e.name: problem.residual(e, self.effects, values) for e in self.equations}

    def starts(self) -> list[np.ndarray]:
        """Return the scaled start positions: typical values and the effect's other starts."""
        effect = self.projection.problem.system.catalogue[self.name]
        first = {q.name: q.typical for q in effect.fitted}
        positions = [first, *({**first, **other} for other in effect.starts)]
        if effect.periodic is not None:
            waves = product(self._peaks(), QUARTERS)
            positions += [{**first, **dict(zip(effect.periodic, wave, strict=True))} for wave in waves]
        size = effect.fitted[0]
        if size.neutral is not None and not effect.states:
            # a signature near the off value too: far from it what resembles a nuisance parameter bends
            near = size.neutral + NEAR * (size.typical - size.neutral)
            positions.append({**first, size.name: near})
        return [
            np.array([*self._start_beside(p), *(p[q.name] for q in effect.fitted)]) / self.scale
            for p in positions
        ]

    def _start_beside(self, position: Values) -> list[float]:
        """Return where what moves with it starts: a dead time as much shorter, a sensor as late."""
        effect = self.projection.problem.system.catalogue[self.name]
        own = {key.partition(".")[2]: value for key, value in self._rest.items()}
        if effect.lag is None:
            return [position[effect.fitted[0].name] for _ in self.beside]
        return [-effect.lag(SimpleNamespace(**{**own, **position})) for _ in self.beside]

    def _peaks(self) -> list[float]:
        """Return the frequencies, Hz, at which the residuals of its equations are largest."""
        problem, found = self.projection.problem, []
        for equation in self.equations:
            one = max(problem.scored, key=lambda scored: scored.run.recording.samples)
            values = self.projection.base.values
            raw = problem.replay.residuals(one.run, equation, self.projection.base.effects, values)[:, 0]
            white = one.white(equation.channels[0], raw)
            power = np.abs(np.fft.rfft(white * np.hanning(len(white)), 4 * len(white))) ** 2
            frequency = np.fft.rfftfreq(4 * len(white), one.run.period)
            inside = (frequency > LOWEST_PEAK) & (frequency < HIGHEST_PEAK)
            peaks = find_peaks(np.where(inside, power, 0.0))[0]
            found += frequency[peaks[np.argsort(power[peaks])[::-1][:MOST_PEAKS]]].tolist()
        return found

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the scaled bounds."""
        return (
            np.array([one.lower for one in self.free]) / self.scale,
            np.array([one.upper for one in self.free]) / self.scale,
        )


DIFFERENCE = 0.01  # of a parameter's scale
COARSE = 0.1  # the same where a finer one gave no way down: an event of the model may jump within it
PROMISED = 0.5  # of the score test's gain: a fit that finds less is tried with coarse differences
MOST_STEPS = 8
TRIES = 4  # of a step, ever shorter
ENOUGH = 0.5
TWIN_STARTS = 2
SMALL_SHARE = 1e-3  # of the gain: what a further step must bring


@dataclass(frozen=True)
class Candidate:
    """An effect fitted beside the present model.

    Attributes:
        name: of the effect.
        gain: by how much the cost falls.
        values: all parameters, nuisance ones as the projection says.
        evidence: gain less what its parameters cost.
        scales: of the shape corrections' priors that go with it.
        added: it, after what moves with it.
    """

    name: str
    gain: float
    values: Values
    evidence: float
    scales: Values
    added: Names


def secant_gain(projection: Projection, trial: Trial, position: np.ndarray) -> float:
    """Return how far the cost would fall if the effect's signature at a position could be scaled at will.

    A score test with a finite step: it works for effects that have no slope at their off value. Where
    the signature cannot be negative, neither can the scale.
    """
    residuals = trial.residuals(position)
    base = projection.base.blocks
    if not all(np.isfinite(r).all() for r in residuals.values()):
        return 0.0
    signature = {name: row - base[name].residual for name, row in residuals.items()}
    right, squares = projection.state({})
    shared: Any = sum(projection.correlated(name, d) for name, d in signature.items())
    slope = sum(float(d @ base[name].residual) for name, d in signature.items())
    curvature = sum(float(d @ d) for d in signature.values())
    size = projection.problem.system.catalogue[trial.name].fitted[0]
    two_sided = size.neutral is not None and size.minimum < size.neutral < size.maximum
    costs = []
    for level in projection.levels:
        along = slope - float(shared @ level.solve(right + level.gradient(projection.position)))
        bent = curvature - float(shared @ level.solve(shared))
        gain = along * (along / bent) if bent > 0 and (along < 0 or two_sided) else 0.0
        costs.append(projection.cost_at(level, right, squares) - gain)
    return projection.floor - min(costs)


@dataclass(frozen=True)
class Point:
    """A trial at scaled positions of its own and of the nuisance parameters."""

    own: np.ndarray
    nuisance: np.ndarray
    residuals: Mapping[str, np.ndarray]
    right: np.ndarray
    level: Level
    cost: float


def _point(projection: Projection, trial: Trial, own: np.ndarray, nuisance: np.ndarray) -> Point:
    residuals = trial.residuals(own, nuisance)
    if not all(np.isfinite(row).all() for row in residuals.values()):
        return Point(own, nuisance, residuals, nuisance, projection.levels[0], math.inf)
    right, squares = projection.state(residuals, nuisance)
    cost, level = projection.best(right, squares, nuisance)
    return Point(own, nuisance, residuals, right, level, cost)


def refine(projection: Projection, trial: Trial, start: np.ndarray, difference: float = DIFFERENCE) -> Point:
    """Return the trial with the least cost over its own and the nuisance parameters.

    The nuisance parameters move with the effect and the equations that it changes are evaluated there; the
    others follow linearly. Derivatives by nuisance parameters are those of the base. `difference`: of the
    effect's own derivatives, in scales.
    """
    lower, upper = trial.bounds()
    now = _point(projection, trial, np.clip(start, lower, upper), projection.position)
    damping = 1e-3
    for _ in range(MOST_STEPS):
        if not math.isfinite(now.cost):
            break
        shared, hessian, gradient = _projected(projection, trial, now, difference)
        best, stuck = now, projection.stuck(now.level)
        follows = float(stuck @ now.level.solve(stuck)) < ENOUGH  # all the way: without it nothing is other
        for attempt in range(TRIES if follows else 2 * TRIES):
            step = bounded_step(hessian, gradient, now.own, lower, upper, damping)
            step = np.clip(step, -2.0 - np.abs(now.own), 2.0 + np.abs(now.own))
            own = np.clip(now.own + step, lower, upper)
            pull = now.right + now.level.gradient(now.nuisance) + shared @ (own - now.own)
            if attempt >= TRIES:
                pull -= stuck
            nuisance = projection.inside(now.nuisance - now.level.solve(pull))
            best = _point(projection, trial, own, nuisance)
            if best.cost < now.cost:
                break
            damping = damping * 20 if attempt != TRIES - 1 else 1e-3
        if not best.cost < now.cost:
            break
        gained, now = now.cost - best.cost, best
        damping *= 0.1
        if gained < max(ENOUGH, SMALL_SHARE * (projection.floor - now.cost)):
            break
    return now


def _projected(
    projection: Projection, trial: Trial, now: Point, difference: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coupling to the nuisance parameters, Hessian and gradient with these projected out."""
    columns: dict[str, list[np.ndarray]] = {equation.name: [] for equation in trial.equations}
    _, upper = trial.bounds()
    for i in range(len(now.own)):
        step = difference if now.own[i] + difference <= upper[i] else -difference
        moved = now.own.copy()
        moved[i] += step
        values = trial.values(moved, now.nuisance)
        for equation in trial.equations:
            row = projection.problem.residual(equation, trial.effects, values)
            columns[equation.name].append((row - now.residuals[equation.name]) / step)
    slopes = {name: np.nan_to_num(np.column_stack(many)) for name, many in columns.items()}
    shared: Any = sum(projection.correlated(name, d) for name, d in slopes.items())
    hessian = sum(d.T @ d for d in slopes.values()) - shared.T @ now.level.solve(shared)
    gradient = sum(d.T @ now.residuals[name] for name, d in slopes.items())
    pull = now.right + now.level.gradient(now.nuisance)
    return shared, hessian, gradient - shared.T @ now.level.solve(pull)


def candidate(
    projection: Projection, trial: Trial, positions: list[np.ndarray], promised: float = 0.0
) -> Candidate:
    """Return the best fit of an effect from some start positions; `promised` is the score test's gain."""
    found = [refine(projection, trial, p) for p in positions]
    if projection.floor - min(one.cost for one in found) < PROMISED * promised:
        found += [refine(projection, trial, p, COARSE) for p in positions]
    best = min(found, key=lambda one: one.cost)
    gain = projection.floor - best.cost
    evidence = gain - penalty(projection.base, len(trial.free))
    values = trial.values(best.own, best.nuisance)
    return Candidate(trial.name, gain, values, evidence, best.level.scales, trial.added)


def twins(projection: Projection, model: Fit) -> list[Candidate]:
    """Return what a model's last effect is at the other actuators, from nuisance parameters at rest.

    An effect of one muscle's sensor, and all else off by as much, is what that of the other one is by itself.
    """
    system, base = projection.problem.system, projection.base
    rest = {one.name: one.centre for one in base.free if one.name.partition(".")[0] not in base.effects}
    scales, found = scales_of(system, model.free), []
    for name in (one for one in system.twins(model.effects[-1]) if one not in base.effects):
        trial = Trial(projection, name)
        if set(trial.effects) == set(model.effects):  # several sensors moved together
            continue
        for start in trial.starts()[:TWIN_STARTS]:
            values = {**trial.values(start), **rest}
            found.append(Candidate(name, 0.0, values, 0.0, scales, trial.added))
    return found


def penalty(base: Fit, parameters: int) -> float:
    """Return what BIC charges for parameters."""
    return parameters * math.log(base.samples)


def widened_shape(projection: Projection, name: str) -> Candidate:
    """Return a shape correction beyond its priors as a candidate: their standard deviations grow.

    Both models are linear with normal priors, so that their marginal likelihoods are known; one more
    parameter, the width, is paid for.
    """
    right, squares = projection.state({})
    around = projection.best(right, squares)[1].scales
    found = []
    for width in WIDTHS:
        level = projection.level({**around, name: width})
        gain = projection.floor - projection.cost_at(level, right, squares)
        followed = projection.position - level.solve(right + level.gradient(projection.position))
        values = {**projection.base.values, **projection.values(followed)}
        price = penalty(projection.base, 1)
        found.append(Candidate(name, gain, values, gain - price, {**around, name: width}, (name,)))
    return max(found, key=lambda one: one.evidence)


def moved_parameter(problem: Problem, base: Fit, name: str, of: str) -> Candidate:
    """Return a wrong parameter as far off as its calibration `of` would be if that had no tolerance."""
    free = [replace(one, sd=math.inf) if one.name == of else one for one in base.free]
    model = fit(problem, base.effects, base.values, free)
    values = {**model.values, of: 0.0, f"{name}.{VALUE}": problem.system.moved_to(name, model.values[of])}
    gain, scales = base.cost - model.cost, scales_of(problem.system, base.free)
    return Candidate(name, gain, values, gain - penalty(base, 1), scales, (name,))
