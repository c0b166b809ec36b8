# SPDX-License-Identifier: Apache-2.0
"""Recordings to be explained by one system: whitened residuals of all runs, and their derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import Whitener
from pam_orthosis.discrepancy.systems.cut import Part
from pam_orthosis.discrepancy.systems.system import Equation, Names, Values


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
        faded = columns.copy("K")
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


class _Task(NamedTuple):
    """A part of an equation, to be replayed for one run, whose residuals begin at `start` in a row of all."""

    equation: Equation
    part: Part
    scored: Scored
    start: int

    def place(self, channel: str) -> slice:
        """Return the place of a channel's residuals in that row."""
        start = self.start + self.equation.channels.index(channel) * self.scored.samples
        return slice(start, start + self.scored.samples)


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
        return self.residuals(effects, values, [equation])[equation.name]

    def residuals(
        self, effects: Names, values: Values, of: Sequence[Equation] | None = None
    ) -> dict[str, np.ndarray]:
        """Return the whitened residuals of some equations (all)."""
        return {name: block.residual for name, block in self.blocks(effects, values, (), of).items()}

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
        known = {one.name: self._relevant(one, effects, names) for one in chosen}
        size = sum(one.samples for one in self.scored)
        rows = {e.name: np.zeros((1 + len(known[e.name]), size * len(e.channels))) for e in chosen}

        def fill(task: _Task) -> None:
            name = task.equation.name
            whole, own = self._linearised(task, effects, values, known[name])
            lines = [0, *(1 + known[name].index(one) for one in own)]
            for channel, columns in zip(task.part.channels, whole.swapaxes(0, 1), strict=True):
                white = self.weights[name] * task.scored.white(channel, columns).T
                rows[name][lines, task.place(channel)] = white

        self.replay.workers.map(fill, self._tasks(chosen, effects))
        return {name: self._block(name, rows[name], known[name]) for name in rows}

    def _block(self, equation: str, rows: np.ndarray, names: Names) -> Block:
        """Return the samples that are shown of an equation's residuals and, below them, derivatives."""
        shown = rows[:, self._shown[equation]] if equation in self._shown else rows
        return Block(shown[0], shown[1:].T, names, self.weights[equation])

    def _tasks(self, equations: Sequence[Equation], effects: Names) -> list[_Task]:
        """Return the parts of some equations that do not feel each other, of each run; the longest first."""
        tasks = []
        for equation in equations:
            start, count = 0, len(equation.channels)
            for one in self.scored:
                tasks += [_Task(equation, part, one, start) for part in self.replay.parts(equation, effects)]
                start += count * one.samples
        return sorted(tasks, key=lambda task: -len(task.part.channels) * task.scored.samples)

    def _relevant(self, equation: Equation, effects: Names, names: Names) -> Names:
        """Return those parameters by which an equation has derivatives."""
        lagging = self._lagging(equation, effects) & {*names}
        known = {name for part in self.replay.parts(equation, effects) for name in part.parameters}
        return (*(name for name in names if name in known - lagging), *sorted(lagging))

    def _linearised(
        self, task: _Task, effects: Names, values: Values, names: Names
    ) -> tuple[np.ndarray, tuple[str, ...]]:
        """Return residuals with k derivatives behind, (n, channels, 1 + k), and the k parameters."""
        given = task.scored.run, task.equation, effects
        lagging = sorted(self._lagging(task.equation, effects) & {*names})
        smooth = tuple(name for name in names if name not in lagging)
        raw, by, relevant = self.replay.sensitivities(*given, values, smooth, [task.part])
        columns = [raw[:, :, None], by]
        for name in lagging:
            step = 0.02 * max(abs(values[name]), 1e-12)
            moved = {**values, name: values[name] + step}
            change = self.replay.residuals(*given, moved, [task.part]) - raw
            columns.append(change[:, :, None] / step)
        return np.concatenate(columns, axis=2), (*relevant, *lagging)

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
