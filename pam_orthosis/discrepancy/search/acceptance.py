# SPDX-License-Identifier: Apache-2.0
"""Which of the models that recordings ask for is accepted: the first that held-out ones confirm."""

from collections.abc import Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.search.confirmation import (
    EMPTY,
    SLOW,
    SURE,
    Seen,
    at_values,
    confirmed,
    emptied,
    is_slow,
    is_too_small,
    is_visible,
    least_size,
    leaves_noise_alone,
)
from pam_orthosis.discrepancy.search.filtered import is_rounding
from pam_orthosis.discrepancy.search.selection import Ranking, Step
from pam_orthosis.discrepancy.systems.system import System, Values


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
        name, closes = model.effects[-1], 0.0
        fitted = problem.weighted(weighted.weights)
        seen = confirmed(fitted, held_out.weighted(weighted.weights), base, model)
        if is_too_small(problem.system, name, model):
            reason = f"{name} is smaller than what is worth a name ({least_size(problem.system, name)})"
        elif is_visible(problem, base, model) and is_rounding(fitted, base, model):
            reason = f"{name} is smaller than what the steps of the inputs' readings may look like"
        elif empty := emptied(problem.system, name, model):
            reason = f"{name} {EMPTY}: {at_values(problem.system, model, empty)}"
            closes = _closed(fitted, base, model)
        elif is_slow(problem, name, model):
            reason = f"{name} {SLOW}: {at_values(problem.system, model, [_size(problem.system, name)])}"
        elif seen.shows or _is_known(problem, base, (evidence, weighted, model), seen):
            return Step(name, model, weighted, evidence, seen.t, ranked, "accepted", gains)
        else:
            reason = f"held-out recordings do not confirm {name}"
        step = Step(None, None, None, evidence, seen.t, ranked, reason, gains, blocked)
        refused.append(replace(step, closes=closes))
    return refused[0]


def _size(system: System, name: str) -> str:
    return f"{name}.{system.catalogue[name].fitted[0].name}"


def _closed(problem: Problem, base: Fit, model: Fit) -> float:
    """Return by which share what a model leaves above the noise is less than what its base leaves."""
    noise = sum(problem.weights[name] ** 2 * len(block.residual) for name, block in base.blocks.items())
    before, after = (problem.total(one.effects, one.values) - noise for one in (base, model))
    return 1.0 - after / before if before > 0 else 0.0


def _is_known(problem: Problem, base: Fit, judged: tuple[float, Problem, Fit], seen: Seen) -> bool:
    """Whether an effect needs no confirmation: broken tolerances alone show it, or held-out data cannot.

    Then the training recordings have to give much evidence, and to be without any other gap.
    """
    evidence, _, model = judged
    sure = seen.cannot_show and evidence > SURE * len(model.effects)
    bent = not (seen.speaks_against or is_visible(problem, base, model))
    return bent or (sure and leaves_noise_alone(problem, base))
