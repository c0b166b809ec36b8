# SPDX-License-Identifier: Apache-2.0
"""Do recordings agree? A model may leave noise of those that it was fitted to, and much of another."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import TypeAlias

import numpy as np

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.measure import OVERALL
from pam_orthosis.discrepancy.fitting.refit import recalibrated
from pam_orthosis.discrepancy.preparation.beginning import Beginning
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.errors import OrthosisError
from pam_orthosis.progress import silent

Left: TypeAlias = Mapping[str, float]  # recording -> times the noise

LITTLE, MUCH = 1.5, 5.0  # times the noise in the channel where it is most
WORSE = 1.5  # times what the nominal model leaves
MOST_TRIED = 6  # recordings: each one costs a recalibration


def remarks_on_agreement(fitted: Problem, held_out: Problem, model: Fit) -> list[str]:
    """Return a remark on recordings that a model does not hold for, though it fits all that it should."""
    most = max(_left(fitted, model).values())
    others = {name: left for name, left in _left(held_out, model).items() if left > MUCH}
    if most > LITTLE or not others:
        return []
    much = " and ".join(f"{left:.0f} times in {name}" for name, left in others.items())
    return [
        f"the model leaves {most:.1f} times the noise in what it was fitted to, and {much}: is that of"
        " another apparatus, or of another state of it?"
    ]


def remarks_on_contradiction(start: Beginning) -> list[str]:
    """Return remarks if recordings to fit contradict each other, or those that judge."""
    nominal, after = start.configured().white[OVERALL], start.recalibrated().white[OVERALL]
    remarks = _apart(start)
    if after > WORSE * max(nominal, 1.0):
        remarks.append(
            f"recalibration makes held-out recordings worse: {after:.1f} times the noise for {nominal:.1f} of"
            " the nominal model; what was fitted does not hold for them"
        )
    return remarks


def _apart(start: Beginning) -> list[str]:
    """Return a remark on the recording without which all others, those that judge too, fit far better.

    Else on the only one that a recalibrated model fits by itself.
    """
    names, whole = [one.run.recording.name for one in start.problem.scored], _all_left(start, start.null)
    if not 1 < len(names) <= MOST_TRIED or max(whole.values()) < MUCH:
        return []

    @cache  # of two recordings one alone is what is without the other
    def left(*places: int) -> Left:
        return _all_left(start, _recalibrated_to(start, places))

    places = range(len(names))
    without = (_without(name, whole, left(*(j for j in places if j != i))) for i, name in enumerate(names))
    if words := next(filter(None, without), ""):
        return [words]
    alone = [words for i, name in enumerate(names) if (words := _alone(name, left(i)))]
    return alone if len(alone) == 1 else []


def _without(name: str, whole: Left, now: Left) -> str:
    """Return what is said of a recording without which the others fit far better; empty if they do not.

    `whole`: what is left by the model that was recalibrated to all of them; `now`: without it.
    """
    before, rest = (max(value for of, value in found.items() if of != name) for found in (whole, now))
    if MUCH * rest > min(before, now[name]):
        return ""
    return (
        f"{name} stands apart: recalibrated without it, the model leaves at most {rest:.1f} times the noise"
        f" in the others ({before:.1f} with it), and {now[name]:.0f} times in it; try without it"
    )


def _alone(name: str, now: Left) -> str:
    """Return what is said of a recording that the model fits by itself, and no other one; empty if not."""
    least = min(value for of, value in now.items() if of != name)
    if now[name] > LITTLE or least < MUCH:
        return ""
    return (
        f"{name} stands apart: recalibrated to it alone, the model leaves {now[name]:.1f} times the noise in"
        f" it, and {least:.0f} times or more in the others: what is missing does not show in it; try without"
        " it"
    )


def _recalibrated_to(start: Beginning, places: Sequence[int]) -> Fit:
    """Return the model recalibrated to some of the recordings; the one of all if these have no minimum."""
    try:
        return recalibrated(start.problem.on([start.problem.scored[i] for i in places]), silent)[1]
    except OrthosisError:
        return start.null


def _all_left(start: Beginning, model: Fit) -> Left:
    """Return what `_left` does of recordings to fit and those that judge."""
    return {**_left(start.problem, model), **_left(start.held_out, model)}


def _left(problem: Problem, model: Fit) -> dict[str, float]:
    """Return recording -> root-mean-square residual over the noise, in the channel where it is largest."""
    found: dict[str, float] = {}
    for equation in problem.system.equations:
        row = problem.residual(equation, model.effects, model.values) / problem.weights[equation.name]
        for one, part in problem.by_run(equation, row):
            left = float(np.sqrt(np.mean(part**2, axis=1)).max())
            found[one.run.recording.name] = max(left, found.get(one.run.recording.name, 0.0))
    return found
