# SPDX-License-Identifier: Apache-2.0
"""One row of the table: what was measured, beside what, and whether it reaches its goal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, NamedTuple


class Goal(NamedTuple):
    """What has to be reached, in words, and the limits: of the ratio if there is one, else of our figure."""

    words: str
    at_most: float | None = None
    at_least: float | None = None

    def met(self, figure: float) -> bool:
        """Whether the figure is within the limits."""
        low = self.at_least is None or figure >= self.at_least
        return low and (self.at_most is None or figure <= self.at_most)


NO_GOAL = Goal("")


@dataclass(frozen=True)
class Row:
    """Medians over the repeats: our figure, the other's if there is one, their ratio ours / other.

    `spread` holds the least and the largest ratio of the repeats, or of our figure if there is no other.
    """

    group: str
    what: str
    ours: float
    other: float | None
    unit: str
    ratio: float | None
    goal: str
    met: bool | None
    repeats: int
    spread: tuple[float, float]


def alternating(repeats: int, *measures: Callable[[], Any]) -> list[list[Any]]:
    """Return the figures of each measure, taken by turns: what disturbs the machine disturbs all of them."""
    taken = [[measure() for measure in measures] for _ in range(repeats)]
    return [list(figures) for figures in zip(*taken, strict=True)]


def row(
    group: str,
    what: str,
    unit: str,
    ours: Sequence[float],
    other: Sequence[float] | None = None,
    goal: Goal = NO_GOAL,
) -> Row:
    """Return the row of figures taken side by side: repeat i of ours belongs to repeat i of the other."""
    ratios = [a / b for a, b in zip(ours, other, strict=True)] if other else None
    judged = list(ratios or ours)
    return Row(
        group=group,
        what=what,
        ours=median(ours),
        other=median(other) if other else None,
        unit=unit,
        ratio=median(ratios) if ratios else None,
        goal=goal.words,
        met=goal.met(median(judged)) if goal.words else None,
        repeats=len(ours),
        spread=(min(judged), max(judged)),
    )


def as_text(told: dict[str, Any]) -> list[str]:
    """Return the cells of a row for a table."""
    low, high = told["spread"]
    ratio = "" if told["ratio"] is None else digits(told["ratio"])
    met = {True: "yes", False: "**no**", None: ""}[told["met"]]
    return [
        told["what"],
        f"{digits(told['ours'])} {told['unit']}",
        "" if told["other"] is None else f"{digits(told['other'])} {told['unit']}",
        ratio,
        f"{digits(low)} - {digits(high)}",
        str(told["repeats"]),
        told["goal"],
        met,
    ]


def digits(number: float) -> str:
    """Return a number with three digits that count, without an exponent."""
    size = abs(number)
    if size >= 100:
        return f"{number:,.0f}"
    return f"{number:.3g}" if size >= 1e-4 or not size else f"{number:.1e}"
