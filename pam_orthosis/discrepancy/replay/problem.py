# SPDX-License-Identifier: Apache-2.0
"""Recordings to be explained by one system: whitened residuals of all runs, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import Whitener
from pam_orthosis.discrepancy.systems.system import Equation, Names, Values

Piece = TypeVar("Piece")


@dataclass(frozen=True)
class Scored:
    """A run with its whitener and the samples at its start that are not scored."""

    run: Run
    whiten: Whitener
    warm_up: int

    @property
    def samples(self) -> int:
        """The number of samples that are scored."""
        return self.run.recording.samples - self.warm_up

    def white(self, channel: str, columns: np.ndarray) -> np.ndarray:
        """Return whitened columns (n, ...) without the warm-up.

        They are faded in over it: a whitener's memory may be longer, and the start's error is large.
        """
        faded = columns.copy()
        with np.errstate(invalid="ignore"):  # a replay that went astray; `sum_of_squares` says so
            faded[: self.warm_up] *= self._fade.reshape(-1, *[1] * (columns.ndim - 1))
        return self.whiten(channel, faded)[self.warm_up :]

    @cached_property
    def _fade(self) -> np.ndarray:
        """Factors of the warm-up: nought in its first half, rising to one in its second."""
        place = np.arange(self.warm_up) / max(self.warm_up, 1)
        return np.where(place < 0.5, 0.0, 0.5 + 0.5 * np.cos(2 * np.pi * place))


@dataclass(frozen=True)
class Block:
    """Whitened residuals of one equation over all runs, derivatives by some parameters, weight of both."""

    residual: np.ndarray
    slopes: np.ndarray
    names: Names
    weight: float = 1.0


class Problem:
    """Recordings to be explained by one system."""

    def __init__(
        self,
        replay: Replay,
        scored: Sequence[Scored],
        weights: Values | None = None,
        shown: Mapping[str, np.ndarray] | None = None,
    ):
        self.replay, self.system, self.scored = replay, replay.system, list(scored)
        self.weights = dict(weights or {equation.name: 1.0 for equation in self.system.equations})
        self._shown = dict(shown or {})

    def weighted(self, weights: Values) -> Problem:
        """Return the same problem with other weights of the equations' residuals."""
        return Problem(self.replay, self.scored, weights, self._shown)

    def on(self, scored: Sequence[Scored]) -> Problem:
        """Return the same problem of other runs."""
        return Problem(self.replay, scored, self.weights, self._shown)

    def shown(self, samples: Mapping[str, np.ndarray]) -> Problem:
        """Return the same problem with some samples only: equation -> choice (n,) of its row of residuals."""
        return Problem(self.replay, self.scored, self.weights, samples)

    def residual(self, equation: Equation, effects: Names, values: Values) -> np.ndarray:
        """Return the whitened residuals of one equation, all runs and channels in one row."""
        return self._joined(equation, [self._whitened(equation, one, effects, values) for one in self.scored])

    def residuals(
        self, effects: Names, values: Values, of: Sequence[Equation] | None = None
    ) -> dict[str, np.ndarray]:
        """Return the whitened residuals of some equations (all)."""
        chosen = self.system.equations if of is None else of
        pieces = self._of_each(chosen, lambda equation, one: self._whitened(equation, one, effects, values))
        return {e.name: self._joined(e, own) for e, own in zip(chosen, pieces, strict=True)}

    def by_run(self, equation: Equation, row: np.ndarray) -> Iterator[tuple[Scored, np.ndarray]]:
        """Yield each run with its part, (channels, samples, ...), of a row of an equation's residuals."""
        start, count = 0, len(equation.channels)
        for one in self.scored:
            end = start + count * one.samples
            yield one, row[start:end].reshape(count, one.samples, *row.shape[1:])
            start = end

    def blocks(
        self, effects: Names, values: Values, names: Names, of: Sequence[Equation] | None = None
    ) -> dict[str, Block]:
        """Return residuals and derivatives by those of `names` that matter, of some equations (all)."""
        chosen = self.system.equations if of is None else of
        pieces = self._of_each(
            chosen, lambda equation, one: self._linearised(equation, one, effects, values, names)
        )
        blocks = {}
        for equation, own in zip(chosen, pieces, strict=True):
            weight = self.weights[equation.name]
            blocks[equation.name] = Block(
                weight * self._chosen(equation, [row for piece in own for row in piece[0]]),
                weight * self._chosen(equation, [matrix for piece in own for matrix in piece[1]]),
                own[0][2],
                weight,
            )
        return blocks

    def _of_each(
        self, equations: Sequence[Equation], work: Callable[[Equation, Scored], Piece]
    ) -> list[list[Piece]]:
        """Return what `work` gives for each run of some equations; the longest ones are begun first."""
        tasks = [(equation, one) for equation in equations for one in self.scored]
        sizes = [len(equation.channels) * one.samples for equation, one in tasks]
        order = sorted(range(len(tasks)), key=lambda i: -sizes[i])
        found = dict(zip(order, self.replay.workers.map(lambda i: work(*tasks[i]), order), strict=True))
        runs = len(self.scored)
        return [[found[i] for i in range(at, at + runs)] for at in range(0, len(tasks), runs)]

    def _chosen(self, equation: Equation, pieces: Sequence[np.ndarray]) -> np.ndarray:
        """Return the samples that are shown of an equation's pieces, joined."""
        whole = np.concatenate(pieces)
        return whole[self._shown[equation.name]] if equation.name in self._shown else whole

    def _whitened(self, equation: Equation, one: Scored, effects: Names, values: Values) -> list[np.ndarray]:
        """Return whitened residuals, one entry a channel, of one run."""
        raw = self.replay.residuals(one.run, equation, effects, values)
        return [one.white(c, raw[:, i]) for i, c in enumerate(equation.channels)]

    def _joined(self, equation: Equation, pieces: Sequence[list[np.ndarray]]) -> np.ndarray:
        """Return the weighted residuals of an equation from those of its runs and channels."""
        return self.weights[equation.name] * self._chosen(
            equation, [row for piece in pieces for row in piece]
        )

    def _linearised(
        self, equation: Equation, one: Scored, effects: Names, values: Values, names: Names
    ) -> tuple[list[np.ndarray], list[np.ndarray], tuple[str, ...]]:
        """Return whitened residuals and derivatives, one entry a channel, of one run."""
        lagging = self._lagging(equation, effects) & set(names)
        smooth = tuple(name for name in names if name not in lagging)
        raw, by, relevant = self.replay.sensitivities(one.run, equation, effects, values, smooth)
        columns = [by]
        for name in sorted(lagging):
            step = 0.02 * max(abs(values[name]), 1e-12)
            moved = {**values, name: values[name] + step}
            change = self.replay.residuals(one.run, equation, effects, moved) - raw
            columns.append(change[:, :, None] / step)
        slopes = np.concatenate(columns, axis=2)
        white = [
            one.white(c, np.column_stack([raw[:, i], slopes[:, i]])) for i, c in enumerate(equation.channels)
        ]
        return [w[:, 0] for w in white], [w[:, 1:] for w in white], (*relevant, *sorted(lagging))

    def total(self, effects: Names, values: Values) -> float:
        """Return the squared whitened residuals of all equations."""
        return sum_of_squares(self.residuals(effects, values))

    def _lagging(self, equation: Equation, effects: Names) -> set[str]:
        """Return parameters that shift what an equation sees in time: differentiated by differences."""
        return {
            f"{name}.{q.name}"
            for name in effects
            if self.replay.shifts(name, equation, effects)
            for q in self.system.catalogue[name].fitted
        }


def sum_of_squares(residuals: Mapping[str, np.ndarray]) -> float:
    """Return the sum over all residuals; infinite if one is not finite."""
    total = sum(float(row @ row) for row in residuals.values())
    return total if np.isfinite(total) else np.inf
