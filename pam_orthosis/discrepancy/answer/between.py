# SPDX-License-Identifier: Apache-2.0
"""Are inputs stamped late? Do they run between rows as the system says: held, or straight to the next row?

What is wrong by half a row is small beside a gap, and large beside the intervals of what explains it.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit, fit, fit_tempered, score
from pam_orthosis.discrepancy.fitting.refit import recalibrated
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import stated
from pam_orthosis.discrepancy.search.confirmation import EMPTY
from pam_orthosis.discrepancy.search.filtered import noise_squares
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.implied import LAG, SOURCE, is_zero
from pam_orthosis.discrepancy.systems.system import Names, System
from pam_orthosis.model.parameters import Section
from pam_orthosis.progress import silent

STEPS = 3
FEW = 0.4  # power density over that of noise, less 1: hardly more than noise alone
SHARE = 0.1  # of what is left, that an input which runs the other way may leave
UNSURE = "but more than noise is left, and what is missing may look like that: no reason to change it"
CLOSES = 0.9  # of squared residuals: what inputs that act earlier take away, if stamps are the cause


def remarks_on_inputs(found: Selection, settings: Section) -> list[str]:
    """Return remarks on inputs that are stamped late, lag, or run otherwise between rows than is said."""
    remarks = stamped_late(found.problem.system, found.steps) or _between_rows(found, settings)
    return [*remarks, *_lagging(found), *_zeros(found)]


def _zeros(found: Selection) -> list[str]:
    """Return a remark on each zero of a sensor: where springs are linear, a constant force does the same."""
    system = found.problem.system
    zeros = {
        name
        for name in found.final.effects
        if (one := system.catalogue[name]).source == SOURCE and is_zero(one)
    }
    return [f"{name}: a constant that the equations lack may look like this zero" for name in sorted(zeros)]


def _lagging(found: Selection) -> list[str]:
    """Return a remark if the only channel seems to lag: that may as well be what the inputs drive."""
    system = found.problem.system
    names = {f"{one.name}{LAG}" for one in system.channels}
    return [
        f"{name}: one channel does not tell whether its sensor lags or what the inputs drive"
        for name in found.final.effects
        if name in names and len(names) == 1 and system.inputs
    ]


def stamped_late(system: System, steps: Sequence[Step]) -> list[str]:
    """Return a remark on each round whose best effect would have acted before its input."""
    every = " and ".join(name for name in system.inputs if name not in system.sensed)
    return [
        f"it looks as if {system.catalogue[name].late_of or every} were stamped late:"
        f" {values} s fits best, and would act before its input"
        for step in steps
        for name, _, values in [step.reason.partition(f" {EMPTY}: ")]
        if " = -" in values and step.closes > CLOSES and system.catalogue[name].late is not None
    ]


def _between_rows(found: Selection, settings: Section) -> list[str]:
    """Return a remark on each input with which recordings and final model agree better the other way.

    The voltages of machines are known to be held: they come from a control loop.
    """
    problem, final, remarks = found.final_problem, found.final, []
    noisy = bool(stated(problem.system))
    fitted = fit(problem, final.effects, final.values, final.free, most=STEPS) if noisy else final
    before = score(problem, fitted)
    late = {problem.system.catalogue[name].late_of for name in final.effects}
    for name in (
        one for one in _declared(problem.system) if one not in late
    ):  # of one it is known but roughly
        other = _otherwise(problem, (name,), settings.replay.cross_cutoff)
        evidence = before - score(other, fit(other, final.effects, final.values, final.free, most=STEPS))
        evidence -= _filtered(problem, other, final) if noisy and evidence > 0 else 0.0
        if evidence > settings.evidence.threshold:
            left, _ = fit_tempered(other, final.effects, final.values, final.free)
            surely = _excess(left) < max(FEW, SHARE * _excess(problem))
            rest = "values and intervals are off until it is right" if surely else UNSURE
            remarks.append(f"{_words(problem.system, (name,))} (evidence {evidence:.0f}); {rest}")
    return remarks


def _filtered(problem: Problem, other: Problem, model: Fit) -> float:
    """Return what a straight line between readings lets less through of their noise than steps do."""
    before, after = (noise_squares(one, model) for one in (problem, other))
    return sum(float(np.sum(row - after[name])) for name, row in before.items())


def declared_otherwise(found: Selection, settings: Section) -> str:
    """Return which inputs leave noise alone the other way between rows, without any effect; empty if none."""
    system, names = found.problem.system, _declared(found.problem.system)
    groups = [(name,) for name in names] + [names] * (len(names) > 1)
    if found.final.effects == found.null.effects or _excess(found.problem) < FEW:
        return ""
    for one in groups:
        fitted, _ = recalibrated(_otherwise(found.problem, one, settings.replay.cross_cutoff), silent)
        if _excess(fitted) < FEW:
            return _words(system, one)
    return ""


def _declared(system: System) -> Names:
    """Return the inputs of which a user said what they do between rows."""
    return () if system.input_period else system.inputs


def _otherwise(problem: Problem, names: Names, cutoff: float) -> Problem:
    """Return a problem with inputs that run the other way between rows."""
    system = problem.system
    gradual = tuple({*system.gradual} ^ {*names})
    replay = Replay(replace(system, gradual=gradual), problem.replay.workers)
    runs = [replace(one, run=Run(replay.system, one.run.recording, cutoff)) for one in problem.scored]
    return Problem(replay, runs, problem.weights)


def _excess(weighted: Problem) -> float:
    """Return how much more than noise is left in an equation, by the weights that a fit has set."""
    return 1 / min(weighted.weights.values()) ** 2 - 1


def _words(system: System, names: Names) -> str:
    held = names[0] in system.gradual  # where it fits better
    way = "held until the next row" if held else "going straight from row to row"
    return f"{' and '.join(names)} fits better {way}: held={held} of its Input"
