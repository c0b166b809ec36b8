# SPDX-License-Identifier: Apache-2.0
"""A small effect beside large ones, judged while the form of these is free.

What the exact form of a large effect leaves over looks like a small effect. It is what the large one does, a
little more or less of it where a signal has some value, or a little of it later. Whatever shows with all that
free is something else.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from pam_orthosis.discrepancy.fitting.candidates import Trial, penalty, secant_gain
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.free import Free
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.fitting.signals import hats, whole_signals
from pam_orthosis.discrepancy.replay.injection import injection
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.systems.system import Equation

KNOTS = 5  # of a large effect's share over each signal
ENDS = (0.02, 0.98)  # quantiles of a signal between which it changes
LAGS = (0.003, 0.01, 0.03, 0.1, 0.3)  # s
SHARE = 0.5  # standard deviation of what is more or less, or later, of the effect


def evidence(problem: Problem, base: Fit, names: Sequence[str], large: Collection[str]) -> dict[str, float]:
    """Return the evidence of effects beside a model, with its large effects free to have another form.

    Empty where a large one changes a channel that shows no state: what it adds is not known there.

    Args:
        names: effects that are missing in the model.
        large: those of its effects whose form is free.
    """
    changed = {name for effect in large for name in problem.replay.touched(effect)}
    shown = [
        problem.system.channel(c).state
        for e in problem.system.equations
        if e.name in changed
        for c in e.channels
    ]
    if None in shown:
        return {}
    projection, found = Projection(problem, _freed(problem, base, large)), {}
    for name in names:
        trial = Trial(projection, name)
        gain = max(secant_gain(projection, trial, start) for start in trial.starts())
        found[name] = gain - penalty(base, len(trial.free))
    return found


def _freed(problem: Problem, base: Fit, large: Collection[str]) -> Fit:
    """Return a fit with further parameters: of each large effect what may be more, less or later of it."""
    signals = {one.run.serial: whole_signals(problem.system, one) for one in problem.scored}
    common = set.intersection(*(set(known) for known in signals.values()))
    ends = {
        name: np.quantile(np.concatenate([known[name] for known in signals.values()]), ENDS)
        for name in sorted(common)
    }
    blocks, free, values = dict(base.blocks), list(base.free), dict(base.values)
    for effect in large:
        for equation in problem.system.equations:
            if equation.name not in problem.replay.touched(effect):
                continue
            rows = [
                _changes(problem, base, one, equation, effect, _ways(signals[one.run.serial], ends))
                for one in problem.scored
            ]
            columns, block = np.vstack(rows), blocks[equation.name]
            names = tuple(f"form.{effect}.{equation.name}.{k}" for k in range(columns.shape[1]))
            slopes = np.hstack([block.slopes, columns])
            blocks[equation.name] = replace(block, slopes=slopes, names=(*block.names, *names))
            free += [Free(name, 1.0, -np.inf, np.inf, SHARE) for name in names]
            values |= dict.fromkeys(names, 0.0)
    return replace(base, blocks=blocks, free=free, values=values)


def _ways(signals: dict[str, np.ndarray], ends: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Return factors of what an effect does, each (n,): splines over signals."""
    return [
        hat
        for name, (low, high) in ends.items()
        if high > low
        for hat in hats(signals[name], float(low), float(high), KNOTS)
    ]


def _changes(
    problem: Problem, base: Fit, one: Scored, equation: Equation, effect: str, ways: list[np.ndarray]
) -> np.ndarray:
    """Return what other forms of an effect change in an equation's whitened residuals of a run, (n, k)."""
    rest = tuple(name for name in base.effects if name != effect)
    has, lacks = (
        problem.replay.residuals(one.run, equation, effects, base.values) for effects in (base.effects, rest)
    )
    columns = []
    for channel in equation.channels:
        linear = injection(problem.replay, one.run, equation, channel, base.values)
        assert linear is not None
        does = linear.added(lacks - has)
        response = linear.response(np.column_stack([*(way * does for way in ways), *_later(does, one)]))
        still = np.zeros_like(next(iter(response.values())))
        felt = [one.white(other, -response.get(other, still)) for other in equation.channels]
        columns.append(problem.weights[equation.name] * np.vstack(felt))
    return np.hstack(columns)


def _later(does: np.ndarray, one: Scored) -> list[np.ndarray]:
    """Return by how much an effect that lags differs, for each of some time constants."""
    shares = [one.run.period / (lag + one.run.period) for lag in LAGS]
    return [lfilter([share], [1, share - 1], does, zi=[(1 - share) * does[0]])[0] - does for share in shares]
