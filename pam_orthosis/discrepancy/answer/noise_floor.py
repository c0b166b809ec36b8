# SPDX-License-Identifier: Apache-2.0
"""What a model expects to leave of the recordings that judge, were it right: noise, and what chance decides.

Most models follow what they are driven by: they leave noise. Where a joint comes to rest inside a play is
decided by less torque than its parameters are known to, and when a slack muscle begins to pull, with its
damping at once, by less pressure than the sensor's noise: even the true equations leave a gap there.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from pam_orthosis.discrepancy.fitting import measure, structure
from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.fitting.measure import Samples
from pam_orthosis.discrepancy.preparation.beginning import Beginning, bare_replay, residual_noise
from pam_orthosis.discrepancy.replay.problem import Problem
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.systems.system import Values
from pam_orthosis.model.parameters import Section

WHOLE = 0.995  # share of the samples that are judged, above which none is said to be left out
DRAWS = 16
AROUND = 0.5  # s, over which expected squares are averaged, and kept apart from what is decided
DECIDED = 1.6  # expected squares of whitened residuals, 1 for noise, below which chance decides little
LEAST_SECONDS = 5.0  # of samples that chance does not decide
MOST_LEFT_OUT = 0.5  # of a channel's samples, that the sensors' noise alone may decide


def final_floor(start: Beginning, found: Selection, settings: Section) -> measure.Gap:
    """Return the noise floor as the final model shows it, in the recordings that judge.

    In a closed loop the inputs answer to the sensors' noise; a model without a delay takes that for
    its own doing, and its residuals have a wrong level. It is counted from the noise that the whiteners were
    made with, which is the bare model's.
    """
    replay, floor = bare_replay(found.problem.replay), start.floor
    fitted = [one.run for one in found.problem.scored]
    first = residual_noise(replay, fitted, settings, (), replay.defaults(()))
    last = _last_levels(start, found, settings)
    return _scaled(floor, {name: floor.white[name] * last[name] / first[name] for name in first})


def _last_levels(start: Beginning, found: Selection, settings: Section) -> dict[str, float]:
    """Return the noise (sd) of the recordings that judge as the final model's residuals show it."""
    judging = [one.run for one in start.held_out.scored]
    return residual_noise(found.problem.replay, judging, settings, found.final.effects, found.final.values)


def _scaled(floor: measure.Gap, white: dict[str, float]) -> measure.Gap:
    """Return a floor with other whitened levels, units in proportion."""
    units = {name: floor.units[name] * white[name] / floor.white[name] for name in white}
    overall = float(np.sqrt(np.mean([value**2 for value in white.values()])))
    return measure.Gap(units, {**white, measure.OVERALL: overall})


def decided_and_floor(
    start: Beginning, found: Selection, spread: np.ndarray, settings: Section
) -> tuple[Samples | None, measure.Gap]:
    """Return which held-out samples chance does not decide, and what the final model expects to leave there.

    None and the noise floor, if no state of the model is left to chance, and noise alone decides nothing.
    """
    final, judge = found.final, start.held_out
    system = found.problem.system
    catalogue, present = system.bare().catalogue, (*final.effects, *system.simpler)
    noise, cutoff = _last_levels(start, found, settings), settings.replay.cross_cutoff
    if not any(catalogue[name].held for name in present if name in catalogue):
        floor = final_floor(start, found, settings)
        if structure.clean(structure.locate(judge, final)):
            return None, floor
        return _by_noise(judge, expected_squares(judge, final, np.zeros_like(spread), noise, cutoff)), floor
    squares = expected_squares(judge, final, spread, noise, cutoff)
    masks = decided(judge, squares)
    if masks is None:
        return None, final_floor(start, found, settings)
    white = {
        name: float(
            np.sqrt(np.mean(np.concatenate([squares[key][masks[key]] for key in squares if key[1] == name])))
        )
        for name in start.floor.units
    }
    return masks, _scaled(start.floor, white)


def _by_noise(problem: Problem, squares: Samples) -> Samples | None:
    """Return which samples the sensors' noise does not decide; None if it decides none, or too many."""
    masks = decided(problem, squares)
    if masks is None:
        return None
    least = min(_kept(masks).values())
    return masks if 1 - MOST_LEFT_OUT < least < 1 else None


def remark_on_left_out(masks: Samples | None) -> tuple[str, ...]:
    """Return the remark on samples that do not count."""
    if masks is None:
        return ()
    shares = ", ".join(f"{1 - kept:.0%} of {name}" for name, kept in _kept(masks).items() if kept < WHOLE)
    why = "where differences too small to measure decide"  # as where play rests, or a slack rope gets tight
    return (f"left out of the judgement, {why}: {shares}",) if shares else ()


def _kept(masks: Samples) -> dict[str, float]:
    """Return the share of each channel's samples that count."""
    return {
        channel: float(np.mean(np.concatenate([m for (_, c), m in masks.items() if c == channel])))
        for _, channel in masks
    }


def expected_squares(
    problem: Problem, model: Fit, spread: np.ndarray, noise: Values, cutoff: float
) -> Samples:
    """Return the mean squares of the whitened residuals that a model expects, 1 for fresh noise alone.

    Recordings are replayed with noise added and parameters drawn from what the fit leaves open; what
    changes is what two recordings of the same apparatus would differ by.

    Args:
        problem: recordings to replay, with their whiteners.
        spread: covariance of the scaled free parameters.
        noise: channel -> sd, SI.
        cutoff: Hz, of the neighbours' smoothing.
    """
    rng = np.random.default_rng(0)
    squares: dict[tuple[int, str], np.ndarray] = {}
    for _ in range(DRAWS):
        values = _drawn(rng, model, spread)
        for one in problem.scored:
            added = {key: sd * rng.standard_normal(one.run.recording.samples) for key, sd in noise.items()}
            noisy = Run(problem.system, one.run.recording, cutoff, added)
            for equation in problem.system.equations:
                change = problem.replay.residuals(noisy, equation, model.effects, values)
                change = change - problem.replay.residuals(one.run, equation, model.effects, model.values)
                for i, channel in enumerate(equation.channels):
                    key = one.run.serial, channel
                    squares[key] = squares.get(key, 0.0) + one.white(channel, change[:, i]) ** 2 / DRAWS
            problem.replay.forget(noisy)
    return squares


def decided(problem: Problem, squares: Samples) -> Samples | None:
    """Return which samples chance does not decide; None if there are too few to judge by."""
    masks, seconds = {}, dict.fromkeys((channel for _, channel in squares), 0.0)
    for one in problem.scored:
        size = round(AROUND / one.run.period)
        for channel in seconds:
            local = uniform_filter1d(squares[one.run.serial, channel], size)
            mask = maximum_filter1d(local, size) < DECIDED
            masks[one.run.serial, channel] = mask
            seconds[channel] += one.run.period * float(mask.sum())
    return masks if min(seconds.values()) >= LEAST_SECONDS else None


def _drawn(rng: np.random.Generator, model: Fit, spread: np.ndarray) -> dict[str, float]:
    """Return a model's values with the free parameters drawn from their covariance, inside their bounds.

    A draw that leaves them is shortened as a whole: parameters that make up for each other still do.
    """
    root = np.linalg.svd(0.5 * (spread + spread.T), hermitian=True)
    scale = np.array([one.scale for one in model.free])
    step = scale * ((root.U * np.sqrt(root.S)) @ rng.standard_normal(len(root.S)))
    room, back = _room(model, step), _room(model, -step)
    step = room * step if room >= back else -back * step
    moved = {one.name: model.values[one.name] + float(x) for one, x in zip(model.free, step, strict=True)}
    return {**model.values, **moved}


def _room(model: Fit, step: np.ndarray) -> float:
    """Return the share of a step that stays inside all bounds."""
    ends = [
        (one.upper if x > 0 else one.lower) - model.values[one.name]
        for one, x in zip(model.free, step, strict=True)
    ]
    return float(min([1.0, *(end / x for end, x in zip(ends, step, strict=True) if x)]))
