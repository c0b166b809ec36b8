# SPDX-License-Identifier: Apache-2.0
"""Are inputs stamped late? Do they run between rows as the system says: held, or straight to the next row?

What is wrong by half a row is small beside a gap, and large beside the intervals of what explains it.
"""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.fitting.fit import fit, score
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search.confirmation import EMPTY
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.model.parameters import Section

STEPS = 3
CLOSES = 0.9  # of squared residuals: what inputs that act earlier take away, if stamps are the cause


def remarks_on_inputs(found: Selection, settings: Section) -> list[str]:
    """Return remarks on inputs that are stamped late, or run otherwise between rows than the system says."""
    return stamped_late(found.problem.system, found.steps) or _between_rows(found, settings)


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
    problem, final = found.final_problem, found.final
    if problem.system.input_period or not problem.system.inputs:
        return []
    before, remarks = score(problem, final), []
    late = {problem.system.catalogue[name].late_of for name in final.effects}
    for name in (one for one in problem.system.inputs if one not in late):  # of one it is known but roughly
        other = _otherwise(problem, name, settings.replay.cross_cutoff)
        evidence = before - score(other, fit(other, final.effects, final.values, final.free, most=STEPS))
        if evidence > settings.evidence.threshold:
            remarks.append(_words(problem.system, name, evidence))
    return remarks


def _otherwise(problem: Problem, name: str, cutoff: float) -> Problem:
    """Return a problem with an input that runs the other way between rows."""
    system = problem.system
    gradual = tuple({*system.gradual} ^ {name})
    replay = Replay(replace(system, gradual=gradual), problem.replay.workers)
    runs = [replace(one, run=Run(replay.system, one.run.recording, cutoff)) for one in problem.scored]
    return Problem(replay, runs, problem.weights)


def _words(system: System, name: str, evidence: float) -> str:
    held = name in system.gradual  # where it fits better
    way = "held until the next row" if held else "going straight from row to row"
    return (
        f"{name} fits better {way} (evidence {evidence:.0f}): held={held} of its Input; values and intervals"
        " are off until it is right"
    )
