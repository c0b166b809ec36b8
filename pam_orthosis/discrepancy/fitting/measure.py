# SPDX-License-Identifier: Apache-2.0
"""How large a gap is: in the channels' units and in multiples of the noise, and what of it was closed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.system import Names, System, Values

# a gap that exceeds the noise floor by less than this share says nothing about closure
LEAST_EXCESS = 0.03
OVERALL = "overall"
# (serial of a run, channel) -> one value a scored sample
Samples = Mapping[tuple[int, str], np.ndarray]


@dataclass(frozen=True)
class Gap:
    """Root-mean-square residuals of some recordings.

    Attributes:
        units: channel -> in the channel's SI unit.
        white: channel (and `overall`) -> whitened, 1 for noise alone.
    """

    units: dict[str, float]
    white: dict[str, float]


def gap(problem: Problem, model: Fit, judged: Samples | None = None) -> Gap:
    """Return the gap between recordings and a model; `judged`: the samples that count (all)."""
    return gap_at(problem, model.effects, model.values, judged)


def gap_at(problem: Problem, effects: Names, values: Values, judged: Samples | None = None) -> Gap:
    """Return the gap between recordings and a model with given values; `judged` as for `gap`."""
    units, white = {}, {}
    for equation in problem.system.equations:
        for i, channel in enumerate(equation.channels):
            raw, whitened = [], []
            for one in problem.scored:
                residual = problem.replay.residuals(one.run, equation, effects, values)[:, i]
                counts = slice(None) if judged is None else judged[one.run.serial, channel]
                raw.append(residual[one.warm_up :][counts])
                whitened.append(one.white(channel, residual)[counts])
            units[channel], white[channel] = _rms(raw), _rms(whitened)
    white[OVERALL] = float(np.sqrt(np.mean([value**2 for value in white.values()])))
    return Gap(units, white)


def over_noise(system: System, gap: Gap, floor: Gap) -> dict[str, float]:
    """Return equation -> root-mean-square residual over that of noise, of the channel where it is largest."""
    return {
        equation.name: max(gap.white[channel] / floor.white[channel] for channel in equation.channels)
        for equation in system.equations
    }


def closure(before: float, after: float, floor: float) -> float | None:
    """Return the closed share of the gap above the floor, 1 at most; None where there is hardly any gap."""
    if before < (1 + LEAST_EXCESS) * floor:
        return None
    return min((before - after) / (before - floor), 1.0)


def reduced(times: float, share: float) -> float:
    """Return how many times the noise a gap is of which a share of the squares above the noise is removed.

    By chance a share may be above 1.
    """
    return float(np.sqrt(1 + (times**2 - 1) * max(1 - share, 0.0)))


def _rms(pieces: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(pieces) ** 2)))
