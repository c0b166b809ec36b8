# SPDX-License-Identifier: Apache-2.0
"""What is said of a gap that no effect explains: curves over signals, events, or neither."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.discrepancy.unknown.description import Description, described
from pam_orthosis.discrepancy.unknown.events import End, Event, end_of, events

LEAST_GAP = 1.15  # over the noise, in an equation: below it nothing can be said of what is left


@dataclass(frozen=True)
class Unknown:
    """What is left in the equation where most is left.

    Attributes:
        equation: its name.
        descriptions: as curves over signals, one a channel at most.
        events: of the held-out recordings, if these are most of it.
        beside: key of a model file -> the value that a parameter has beside the descriptions, in a model that
            has them.
        end: of a coordinate, where all events are; None: at none.
    """

    equation: str
    descriptions: Sequence[Description]
    events: Sequence[Event]
    beside: Values = field(default_factory=dict)
    end: End | None = None

    @property
    def reduced(self) -> float:
        """Share of the held-out gap of its equation that the descriptions remove."""
        return sum(one.reduced for one in self.descriptions)


def unknown(problem: Problem, judge: Problem, model: Fit, floor: measure.Gap) -> Unknown | None:
    """Return what can be said of the gap that a model leaves in held-out recordings; None if it is small."""
    kept = measure.over_noise(problem.system, measure.gap(judge, model), floor)
    worst = max(problem.system.equations, key=lambda equation: kept[equation.name])
    if kept[worst.name] < LEAST_GAP:
        return None
    found = described(problem, judge, model, worst)
    pushes = [] if found else [one for c in worst.channels for one in events(judge, model, worst, c)]
    return Unknown(worst.name, found, tuple(pushes), end=end_of(judge, pushes) if pushes else None)
