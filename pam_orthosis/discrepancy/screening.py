# SPDX-License-Identifier: Apache-2.0
"""Which effects of the catalogue are worth a full fit: score tests, projected fits, what they promise."""

import numpy as np

from pam_orthosis.discrepancy.candidates import Candidate, Trial, candidate, secant_gain, widened_shape
from pam_orthosis.discrepancy.fit import Fit
from pam_orthosis.discrepancy.problem import Problem
from pam_orthosis.discrepancy.projection import Projection
from pam_orthosis.discrepancy.system import System, Values
from pam_orthosis.progress import Progress

LEAST_SCREEN = 6.0  # gain of a score test below which a fit is not worth its time
LEAST_OF_THRESHOLD = 0.15  # the same, of the evidence that is asked for
LEAST_SHARE = 0.02  # the same, of the best candidate's gain
POLISHED = 3
POLISHED_SHARE = 0.4  # of the best projected gain: worth a full fit
NEAR_THRESHOLD = 0.3  # of the evidence that is asked for: a projection may be that far off
SLACK = 20.0  # the same where little is asked for
FAR = 10.0  # power density of residuals over noise, and
FAR_STRAIN = 3.0  # deviation of a free parameter over its tolerance, that let parameters be suspected
SECOND_START = 0.3  # of the best start's gain: a second start is tried


def fitted_candidates(
    problem: Problem, base: Fit, most: int, thresholds: Values, progress: Progress
) -> tuple[list[Candidate], dict[str, float]]:
    """Return the candidates that a score test lets through, fitted, best evidence first, and all gains.

    `thresholds` is the evidence that each effect needs; one whose score is far below is not fitted, unless a
    parameter of its name is strained: recalibration then does for it what it would show.
    """
    projection = Projection(problem, base)
    replay, system = problem.replay, problem.system
    known = {*base.effects, *(() if is_far(problem) or _strained(base) else problem.system.wrong)}
    known |= {name for name, one in system.catalogue.items() if one.within in base.effects}
    names = replay.touching((name for name in system.candidates if name not in known), progress)
    shapes = [name for name in system.shapes if name not in base.effects and replay.touched(name)]

    strained = _strained(base)

    def enough(gain: float, name: str) -> bool:
        return gain * _room(problem, name) > LEAST_OF_THRESHOLD * thresholds[name]

    def screen(name: str) -> tuple[float, str, list[np.ndarray]]:
        trial = Trial(projection, name)
        starts = trial.starts()
        gains = [secant_gain(projection, trial, start) for start in starts]
        order = np.argsort(gains)[::-1][:2]
        kept = [starts[i] for i in order if gains[i] >= SECOND_START * gains[order[0]]]
        return gains[order[0]], name, starts if name in strained else kept

    several = replay.workers.together
    screened = sorted(
        several(screen, names, replay, progress, "screening effects"), key=lambda item: -item[0]
    )
    best = screened[0][0] if screened else 0.0  # a small catalogue may be used up
    least = max(LEAST_SCREEN, LEAST_SHARE * best)
    kept = [
        (gain, name, starts)
        for place, (gain, name, starts) in enumerate(screened)
        if name in strained or (place < most and gain > least and enough(gain, name))
    ]

    def fitted(item: tuple[float, str, list[np.ndarray]]) -> Candidate:
        gain, name, starts = item
        return candidate(projection, Trial(projection, name), starts, gain)

    found = several(fitted, kept, replay, progress, "fitting candidates")
    found += [widened_shape(projection, name) for name in shapes]
    gains = {name: gain for gain, name, _ in screened} | {one.name: one.gain for one in found}
    return sorted((one for one in found if one.gain > least), key=lambda one: -one.evidence), gains


def is_far(problem: Problem) -> bool:
    """Return whether the model is far off: parameters of the apparatus are suspected then."""
    return max(1 / weight**2 for weight in problem.weights.values()) > FAR


def shapes_astray(system: System, base: Fit) -> bool:
    """Return whether a shape correction that is not named is far off its tolerance."""
    unnamed = set(system.shapes) - set(base.effects)
    return any(name.partition(".")[0] in unnamed for name in _strained(base))


def _strained(base: Fit) -> set[str]:
    """Return the free parameters that are far off their tolerance; what is called so too may be the cause."""
    return {one.name for one in base.free if abs(one.deviation(base.values)) > FAR_STRAIN}


def _room(problem: Problem, name: str) -> float:
    """Return by how much the gain of an effect may grow: a poor model weighs residuals less."""
    return max(1 / problem.weights[equation] ** 2 for equation in problem.replay.touched(name))


def worth_polishing(problem: Problem, ranked: list[Candidate], thresholds: Values) -> list[Candidate]:
    """Return the candidates that a full fit may lift over what is asked of them.

    The first one that needs no lift is among them, whatever others promise that may never get there.
    """
    near = [
        one
        for one in ranked
        if one.gain * _room(problem, one.name) - (one.gain - one.evidence)
        > min(NEAR_THRESHOLD * thresholds[one.name], thresholds[one.name] - SLACK)
    ]
    ready = [one for one in near if one.evidence >= thresholds[one.name]][:1]
    kept = [one for one in near[:POLISHED] if one.gain > POLISHED_SHARE * near[0].gain]
    return kept + [one for one in ready if one not in kept]
