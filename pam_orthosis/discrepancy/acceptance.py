# SPDX-License-Identifier: Apache-2.0
"""Which of the models that recordings ask for is accepted: the first that held-out ones confirm."""

from collections.abc import Sequence

from pam_orthosis.discrepancy.confirmation import (
    EMPTY,
    LEAST_T,
    LEAST_TRANSFER,
    SURE,
    WORST_T,
    at_values,
    confirmed,
    emptied,
    is_too_small,
    is_visible,
    leaves_noise_alone,
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

    Held-out recordings can confirm no effect that broken tolerances alone show, nor one without which a
    model leaves noise alone: they must not speak against it then.
    What is refused is the first one: its evidence, its t value and the reason belong together.
    """
    refused = []
    for evidence, weighted, model in able:
        name = model.effects[-1]
        t, transfer = confirmed(
            problem.weighted(weighted.weights), held_out.weighted(weighted.weights), base, model
        )
        shown = t > LEAST_T or transfer > LEAST_TRANSFER
        sure = evidence > SURE * len(model.effects) and all(
            leaves_noise_alone(one, base, name) for one in (problem, held_out)
        )
        known = t > WORST_T and (sure or not is_visible(problem, base, model))
        if is_too_small(problem.system, name, model):
            reason = f"{name} is smaller than what is worth a name"
        elif empty := emptied(problem.system, name, model):
            reason = f"{name} {EMPTY}: {at_values(model, empty)}"
        elif shown or known:
            return Step(name, model, weighted, evidence, t, ranked, "accepted", gains)
        else:
            reason = f"held-out recordings do not confirm {name}"
        refused.append(Step(None, None, None, evidence, t, ranked, reason, gains, blocked))
    return refused[0]
