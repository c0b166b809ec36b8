# SPDX-License-Identifier: Apache-2.0
"""One zero of time for all recordings, where a periodic push shows that their clocks have none in common.

Recordings that were cut, or begun by hand, have the push in different phases. Each is counted from where it
has the phase of the first one; nothing but effects over time reads the clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, fit_tempered
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import Equation, System

LOWEST, HIGHEST = 0.1, 20.0  # Hz, of a push
STANDS_OUT = 30.0  # power of a line over the usual power around it, in each recording
AROUND = 4.0  # times a frequency, up to which, and down to its inverse, is around it
# of the motion of that frequency, that is left: a model's error follows the motion, and is less, most of all
# where all motion has that frequency
OWN, ALL = 0.05, 0.3
HARMONICS = 9  # of the motion, in which a model's error shows too
SAME = 0.3  # rad: phases of one clock
FINE = 8  # zero padding of a spectrum
ROUNDS = 3  # refinements of the phases, each with a fit


class Line(NamedTuple):
    """A line in the spectrum of whitened residuals: frequency, Hz, and phase of each run at time 0, rad."""

    frequency: float
    phases: list[float]


def aligned(problem: Problem, base: Fit, held_out: Problem, cutoff: float) -> tuple[Problem, Problem, str]:
    """Return both problems on one clock, and a remark on what was moved; empty if nothing was."""
    system = problem.system
    names = [name for name in system.candidates if system.catalogue[name].periodic is not None]
    touched = {equation for name in names for equation in problem.replay.touched(name)}
    for equation in (one for one in system.equations if one.name in touched):
        line = _line([problem, held_out], base, equation)
        if line is None:
            continue
        off = [_wrapped(phase - line.phases[0]) for phase in line.phases]
        if max(map(abs, off)) < SAME:
            continue
        seconds = [one / (2 * np.pi * line.frequency) for one in off]
        count = len(problem.scored)
        moved = _moved(problem, seconds[:count], cutoff), _moved(held_out, seconds[count:], cutoff)
        return *moved, (
            f"the recordings' clocks have no common zero: each is counted so that a push of"
            f" {line.frequency:.3g} Hz has one phase"
        )
    return problem, held_out, ""


def is_periodic(system: System, model: Fit) -> bool:
    """Whether an effect of a model is periodic in time."""
    return any(system.catalogue[name].periodic is not None for name in model.effects)


def on_one_clock(
    problem: Problem, model: Fit, held_out: Problem, cutoff: float
) -> tuple[Problem, Fit, Problem]:
    """Return a model and recordings whose clocks are moved to where a periodic effect, if any, fits best."""
    if not is_periodic(problem.system, model):
        return problem, model, held_out
    catalogue = problem.system.catalogue
    name = next(one for one in model.effects if catalogue[one].periodic is not None)
    frequency, phase = (f"{name}.{key}" for key in catalogue[name].periodic or ())
    for _ in range(ROUNDS):
        turns = 2 * np.pi * model.values[frequency]
        problem, held_out = (
            _moved(group, [one / turns for one in _steps(group, model, phase)], cutoff)
            for group in (problem, held_out)
        )
        problem, model = fit_tempered(problem, model.effects, model.values, model.free)
    return problem, model, held_out


def _steps(problem: Problem, model: Fit, phase: str) -> list[float]:
    """Return by how much the phase of each run differs from the model's, rad."""
    square, product = np.zeros(len(problem.scored)), np.zeros(len(problem.scored))
    for equation in problem.system.equations:
        block = problem.blocks(model.effects, model.values, (phase,))[equation.name]
        if not block.names:
            continue
        both = zip(
            problem.by_run(equation, block.residual),
            problem.by_run(equation, block.slopes[:, 0]),
            strict=True,
        )
        for i, ((_, left), (_, slope)) in enumerate(both):
            square[i] += float((slope * slope).sum())
            product[i] += float((slope * left).sum())
    return [float(-p / s) if s > 0 else 0.0 for p, s in zip(product, square, strict=True)]


def _line(groups: Sequence[Problem], base: Fit, equation: Equation) -> Line | None:
    """Return the strongest line of the longest run, if it stands out in each of them."""
    every = [(group, one) for group in groups for one in group.scored]
    rows = [_left(group, one, base, equation) for group, one in every]
    longest = max(range(len(groups[0].scored)), key=lambda i: len(rows[i]))
    frequency = _strongest(rows[longest], every[longest][1].run.period)
    if frequency is None:
        return None
    phases: list[float] = []
    orders: list[int] = []
    shares: list[float] = []
    for row, (group, one) in zip(rows, every, strict=True):
        raw, seen = _motion(group, one, base, equation)
        left, motion = (abs(_wave(part, one, frequency)) for part in (raw, seen))
        orders.append(_harmonic(seen, one.run.period, frequency))
        shares.append(left / motion)
        if not _stands_out(row, one.run.period, frequency):
            return None
        phases.append(float(np.angle(_wave(row, one, frequency))))
    of_motion = all(orders) and (max(orders) > 1 or min(shares) < ALL)
    return None if of_motion or min(shares) < OWN else Line(frequency, phases)


def _motion(group: Problem, one: Scored, base: Fit, equation: Equation) -> tuple[np.ndarray, np.ndarray]:
    """Return what is left of an equation's first channel, and the channel, in its unit."""
    raw = group.replay.residuals(one.run, equation, base.effects, base.values)[one.warm_up :, 0]
    seen = one.run.smooth(equation.channels[0])[one.warm_up :]
    return raw, seen - seen.mean()


def _harmonic(motion: np.ndarray, period: float, frequency: float) -> int:
    """Return which harmonic of the motion a frequency is, 1 for its own; 0 if none."""
    own = _strongest(motion, period)
    if own is None:
        return 0
    order = round(frequency / own)
    apart = abs(frequency - order * own)
    return order if 1 <= order <= HARMONICS and apart < order / (len(motion) * period) else 0


def _wave(row: np.ndarray, one: Scored, frequency: float) -> complex:
    """Return amplitude and phase of a wave in a run, by its clock."""
    time = one.run.recording.start + one.run.period * (one.warm_up + np.arange(len(row)))
    return complex(np.sum(np.hanning(len(row)) * row * np.exp(-2j * np.pi * frequency * time)))


def _left(group: Problem, one: Scored, base: Fit, equation: Equation) -> np.ndarray:
    """Return whitened residuals of an equation's first channel."""
    raw = group.replay.residuals(one.run, equation, base.effects, base.values)[:, 0]
    return one.white(equation.channels[0], raw)


def _power(row: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    size = FINE * len(row)
    return np.fft.rfftfreq(size, period), np.abs(np.fft.rfft(row * np.hanning(len(row)), size)) ** 2


def _strongest(row: np.ndarray, period: float) -> float | None:
    frequency, power = _power(row, period)
    inside = (frequency > max(LOWEST, 3 / (len(row) * period))) & (frequency < HIGHEST)
    return float(frequency[np.argmax(np.where(inside, power, 0.0))]) if inside.any() else None


def _stands_out(row: np.ndarray, period: float, at: float) -> bool:
    frequency, power = _power(row, period)
    width = 3 / (len(row) * period)
    near = np.abs(frequency - at) <= width
    around = (frequency > at / AROUND) & (frequency < at * AROUND) & (np.abs(frequency - at) > 2 * width)
    return bool(around.any()) and float(power[near].max()) > STANDS_OUT * float(np.median(power[around]))


def _moved(problem: Problem, seconds: Sequence[float], cutoff: float) -> Problem:
    """Return a problem whose recordings are counted from so many seconds earlier."""
    scored = []
    for one, later in zip(problem.scored, seconds, strict=True):
        recording = replace(one.run.recording, start=one.run.recording.start + later)
        scored.append(replace(one, run=Run(problem.system, recording, cutoff)))
    return problem.on(scored)


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
