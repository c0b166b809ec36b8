# SPDX-License-Identifier: Apache-2.0
"""Which effects of the catalogue are worth a full fit: score tests, projected fits, what they promise."""

from collections.abc import Sequence

import numpy as np

from pam_orthosis.discrepancy.fitting.candidates import (
    Candidate,
    Trial,
    candidate,
    moved_parameter,
    secant_gain,
    widened_shape,
)
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.systems.system import System, Values
from pam_orthosis.progress import Progress

LEAST_SCREEN = 6.0  # gain of a score test below which a fit is not worth its time
LEAST_OF_THRESHOLD = 0.15  # the same, of the evidence that is asked for
LEAST_SHARE = 0.02  # the same, of the best candidate's gain
KEPT = 0.1  # of a score test's gain, that a fit must reach to take one of the places
MOST_FITTED = 3  # fits for each place
POLISHED, MOST_POLISHED = 3, 9  # full fits at a time, and in all where none keeps its promise
POLISHED_SHARE = 0.4  # of the best projected gain: worth a full fit
NEAR_THRESHOLD = 0.3  # of the evidence that is asked for: a projection may be that far off
SLACK = 20.0  # the same where little is asked for
FAR = 10.0  # power density of residuals over noise, and
SURELY = 8.0  # the same of a machine's parameter, which the form error of an effect beside may move too
FAR_STRAIN = 3.0  # deviation of a free parameter over its tolerance, that let parameters be suspected
RIVAL = 0.5  # of a gain: what reaches it may be what the best effect is
SECOND_START = 0.3  # of the best start's gain: a second start is tried

Screened = tuple[float, str, list[np.ndarray]]  # gain of a score test, effect, starts worth a fit


def fitted_candidates(
    problem: Problem, base: Fit, most: int, thresholds: Values, progress: Progress
) -> tuple[list[Candidate], dict[str, float]]:
    """Return the candidates that a score test lets through, fitted, best evidence first, and all gains.

    `thresholds` is the evidence that each effect needs; one whose score is far below is not fitted, unless a
    parameter of its name is strained: recalibration then does for it what it would show. Wrong parameters are
    candidates where the model is far off or strained, and rivals of an effect that has enough evidence.
    """
    look, system = _Look(problem, base, most, thresholds, progress), problem.system
    known = system.taken(base.effects)
    own = {n: one.name for n in system.candidates if n not in known and (one := system.moved_by(n))}
    moved = {name: of for name, of in own.items() if is_moved(system, base, name)}
    others = [name for name in system.candidates if name not in {*known, *moved}]
    suspected = is_far(problem) or bool(look.strained)
    gains, found = look.at([name for name in others if suspected or name not in system.wrong], LEAST_SCREEN)
    least = max([LEAST_SCREEN, *(LEAST_SHARE * gain for gain in gains.values())])
    best = max([one.gain for one in found if one.evidence >= thresholds[one.name]], default=0.0)
    if best and not suspected:
        rivals, fitted = look.at([name for name in others if name in system.wrong], RIVAL * best)
        gains, found = gains | rivals, found + fitted
    shapes = [name for name in system.shapes if name not in base.effects and problem.replay.touched(name)]
    found += [widened_shape(look.projection, name) for name in shapes]
    found += [moved_parameter(problem, base, name, of) for name, of in moved.items()]
    gains |= {one.name: one.gain for one in found}
    best_first = sorted((one for one in found if one.gain > least), key=lambda one: -one.evidence)
    return _different(best_first), gains


def is_moved(system: System, model: Fit, name: str) -> bool:
    """Return whether a parameter is so far off, by recalibration or by a candidate, that it may be wrong."""
    own = system.moved_by(name)
    if own is None:
        return False
    far = FAR_STRAIN if system.recalibrating(name) else SURELY
    off = model.values[own.name]
    if name in model.effects:
        off += system.moved_back(name, model.values[f"{name}.{VALUE}"])
    return abs(off) > far * own.sd


def _different(ranked: Sequence[Candidate]) -> list[Candidate]:
    """Return the first of those candidates that add the same effects, as sensors that move together do."""
    first: dict[frozenset[str], Candidate] = {}
    for one in ranked:
        first.setdefault(frozenset(one.added), one)
    return list(first.values())


class _Look:
    """Score tests of effects at a fit, and fits of those that promise something."""

    def __init__(self, problem: Problem, base: Fit, most: int, thresholds: Values, progress: Progress):
        self.projection, self.strained = Projection(problem, base), strained(base)
        self._problem, self._most, self._thresholds, self._progress = problem, most, thresholds, progress

    def at(self, names: Sequence[str], least: float) -> tuple[dict[str, float], list[Candidate]]:
        """Return gains of the score tests, and those fitted that promise more than `least` and enough."""
        replay, progress = self._problem.replay, self._progress
        able = replay.touching(names, progress)
        forked = replay.workers.forked
        screened = forked(self._screened, able, replay, progress, "screening effects")
        screened = sorted(screened, key=lambda one: -one[0])
        best = screened[0][0] if screened else 0.0  # a small catalogue may be used up
        worth = [
            one
            for one in screened
            if one[1] in self.strained or (one[0] > max(least, LEAST_SHARE * best) and self._is_enough(one))
        ]
        return {name: gain for gain, name, _ in screened}, self._fitted_in_order(worth)

    def _fitted_in_order(self, able: list[Screened]) -> list[Candidate]:
        """Return fits in the order of what the score tests promise, until enough of them have kept it.

        Where the model bends, promises come to nothing, and what is there may promise less: further ones are
        fitted until one keeps half of the largest promise, and what promised half as much as the best one.
        """
        replay, places = self._problem.replay, self._most
        largest = max((gain for gain, *_ in able), default=0.0)
        fitted: list[tuple[Candidate, float]] = []
        while len(fitted) < MOST_FITTED * self._most:
            best, least = max(((one.gain, gain) for one, gain in fitted), default=(0.0, np.inf))
            if best > RIVAL * largest:
                places = 0
            now = [
                one
                for i, one in enumerate(able)
                if i < places or one[0] > RIVAL * least or one[1] in self.strained
            ]
            if not now:
                break
            able = [one for one in able if one not in now]
            found = replay.workers.forked(self._fitted, now, replay, self._progress, "fitting candidates")
            tried = [(one, gain) for one, (gain, *_) in zip(found, now, strict=True)]
            places -= sum(one.gain > KEPT * gain for one, gain in tried)
            fitted += tried
        return [one for one, _ in fitted]

    def _screened(self, name: str) -> Screened:
        trial = Trial(self.projection, name)
        starts = trial.starts()
        gains = [secant_gain(self.projection, trial, start) for start in starts]
        order = np.argsort(gains)[::-1][:2]
        kept = [starts[i] for i in order if gains[i] >= SECOND_START * gains[order[0]]]
        return gains[order[0]], name, starts if name in self.strained else kept

    def _is_enough(self, one: Screened) -> bool:
        gain, name, _ = one
        return gain * _room(self._problem, name) > LEAST_OF_THRESHOLD * self._thresholds[name]

    def _fitted(self, one: Screened) -> Candidate:
        gain, name, starts = one
        return candidate(self.projection, Trial(self.projection, name), starts, gain)


def is_far(problem: Problem) -> bool:
    """Return whether the model is far off: parameters of the apparatus are suspected then."""
    return max(1 / weight**2 for weight in problem.weights.values()) > FAR


def shapes_astray(system: System, base: Fit) -> bool:
    """Return whether a shape correction that is not named is far off its tolerance."""
    unnamed = set(system.shapes) - set(base.effects)
    return any(name.partition(".")[0] in unnamed for name in strained(base))


def strained(base: Fit) -> set[str]:
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


def promising(ranked: Sequence[Candidate], tried: Sequence[Candidate], thresholds: Values) -> list[Candidate]:
    """Return the next candidates that promise what is asked of them, where none of those tried kept it."""
    if len(tried) >= MOST_POLISHED:
        return []
    rest = [one for one in ranked if one not in tried and one.evidence >= thresholds[one.name]]
    return rest[:POLISHED]
