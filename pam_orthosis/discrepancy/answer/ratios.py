# SPDX-License-Identifier: Apache-2.0
"""Parameters of which recordings show ratios alone: what is named of them rests on tolerances."""

from dataclasses import replace

from pam_orthosis.discrepancy.answer.judgement import OPEN, Outcome
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.preparation.identifiability import together, untempered
from pam_orthosis.discrepancy.replay.problem import Problem


def of_ratios(outcome: Outcome, problem: Problem, null: Fit) -> Outcome:
    """Return the outcome with what a wrong parameter among such ones means.

    Where another one of them is outside its tolerance, what is named is no more likely than others.
    """
    wrong = [outcome.system.wrong[one.name] for one in outcome.effects if one.name in outcome.system.wrong]
    group = together(problem.system, untempered(problem, null)[1]) if wrong else ()
    if not (named := [one for one in wrong if one in group]):
        return outcome
    ratios = f"these data show ratios alone of {', '.join(group)}"
    if (off := [one for one in outcome.strained if one in group]) and outcome.verdict not in OPEN:
        return outcome.of_mistaken(f"{ratios}, and {' and '.join(off)} would be outside of tolerance")
    others = ", ".join(one for one in group if one not in named)
    remark = f"{ratios}: the size of {' and '.join(named)} holds if {others} are as the model has them"
    return replace(outcome, remarks=(*outcome.remarks, remark))
