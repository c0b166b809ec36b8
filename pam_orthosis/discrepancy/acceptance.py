# SPDX-License-Identifier: Apache-2.0
"""Which of the models that recordings ask for is accepted: the first that held-out ones confirm."""

from collections.abc import Sequence

from pam_orthosis.discrepancy.confirmation import (
    EMPTY,
    LEAST_T,
    LEAST_TRANSFER,
    WORST_T,
    at_values,
    confirmed,
    emptied,
    is_too_small,
    is_visible,
)
from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.selection import Ranking, Step
from pam_orthosis.discrepancy.system import Values


def accepted(
    problem: Problem,
    base: Fit,
    held_out: Problem,
    able: Sequence[tuple[float, Problem, Fit]],
    ranked: Ranking,
    gains: Values,
    blocked: tuple[str, ...] = (),
) -> Step:
    """Return the step with the first of some models that held-out recordings confirm, or why none is.

    What is refused is the first one: its evidence, its t value and the reason belong together.
    """
    refused = []
    for evidence, weighted, model in able:
        name = model.effects[-1]
        t, transfer = confirmed(
            problem.weighted(weighted.weights), held_out.weighted(weighted.weights), base, model
        )
        strained = not is_visible(problem, base, model)
        if is_too_small(problem.system, name, model):
            reason = f"{name} is smaller than what is worth a name"
        elif empty := emptied(problem.system, name, model):
            reason = f"{name} {EMPTY}: {at_values(model, empty)}"
        elif t > LEAST_T or transfer > LEAST_TRANSFER or (strained and t > WORST_T):
            return Step(name, model, weighted, evidence, t, ranked, "accepted", gains)
        else:
            reason = f"held-out recordings do not confirm {name}"
        refused.append(Step(None, None, None, evidence, t, ranked, reason, gains, blocked))
    return refused[0]
