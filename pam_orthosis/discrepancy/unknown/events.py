# SPDX-License-Identifier: Apache-2.0
"""Events in what a model lacks: short pushes at instants of their own, which no measured signal announces."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import label

from pam_orthosis.discrepancy.fitting.fit import Fit
from pam_orthosis.discrepancy.replay.injection import injection
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.systems.system import Equation
from pam_orthosis.discrepancy.unknown.curve_fit import SLOW, lever

ABOVE = 5.0  # robust standard deviations of what is missing, from which on it is an event
NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal distribution
SHORTEST = 0.05  # s
MOST_OF_TIME, LEAST_OF_POWER = 0.3, 0.6  # events are rare, and most of what is missing
CHANCE = 1e-3  # that events at any instants all lie so near one end of a coordinate


@dataclass(frozen=True)
class Event:
    """A push: recording, channel, instant by its clock s, size at its peak, seconds above half of it."""

    recording: str
    channel: str
    time: float
    size: float
    seconds: float


@dataclass(frozen=True)
class End:
    """Where all events are: where a coordinate is above (else below) a value; where the largest is."""

    signal: str
    above: bool
    value: float
    largest: float


def events(problem: Problem, model: Fit, equation: Equation, channel: str) -> list[Event]:
    """Return the events that make up most of what a channel's equation lacks; empty if it is none."""
    found, power, within, seconds, whole = [], 0.0, 0.0, 0.0, 0.0
    for one in problem.scored:
        unknown = _unknown(problem, one, model, equation, channel)
        if unknown is None:
            return []
        own = _in_run(one, channel, unknown)
        squares = unknown**2
        power, whole = power + float(squares.sum()) * one.run.period, whole + len(unknown) * one.run.period
        for event, part in own:
            found.append(event)
            within += float(squares[part].sum()) * one.run.period
            seconds += (part.stop - part.start) * one.run.period
    rare = seconds < MOST_OF_TIME * whole and within > LEAST_OF_POWER * power
    return found if rare else []


def _unknown(
    problem: Problem, one: Scored, model: Fit, equation: Equation, channel: str
) -> np.ndarray | None:
    """Return what a run lacks, behind its warm-up; None where the channel shows no state."""
    linear = injection(problem.replay, one.run, equation, channel, model.values)
    if linear is None:
        return None
    raw = problem.replay.residuals(one.run, equation, model.effects, model.values)
    entry = problem.system.entries_of(channel)[0]
    missing: np.ndarray = linear.added(raw, SLOW) / lever(problem, one, equation, channel, entry, linear)
    return missing[one.warm_up :]


def _in_run(one: Scored, channel: str, unknown: np.ndarray) -> list[tuple[Event, slice]]:
    usual = NORMAL * float(np.median(np.abs(unknown)))
    regions, count = label(np.abs(unknown) > 0.5 * ABOVE * usual)
    found = []
    for number in range(1, count + 1):
        places = np.flatnonzero(regions == number)
        part = slice(int(places[0]), int(places[-1]) + 1)
        peak = part.start + int(np.argmax(np.abs(unknown[part])))
        size = float(unknown[peak])
        seconds = float(np.sum(np.abs(unknown[part]) > 0.5 * abs(size))) * one.run.period
        if abs(size) > ABOVE * usual and seconds > SHORTEST:
            time = one.run.recording.start + (one.warm_up + peak) * one.run.period
            found.append((Event(one.run.recording.name, channel, time, size, seconds), part))
    return found


def end_of(problem: Problem, found: Sequence[Event]) -> End | None:
    """Return the end of a coordinate at which all events are; None if they are at none."""
    system, runs = problem.system, {one.run.recording.name: one for one in problem.scored}
    largest = int(np.argmax([abs(event.size) for event in found]))
    for name in (one.name for one in system.channels if one.state in system.derived.values()):
        every = np.concatenate([one.run.smooth(name)[one.warm_up :] for one in problem.scored])
        places = [_place(runs[event.recording], name, event) for event in found]
        for above, value in ((True, min(places)), (False, max(places))):
            share = float(np.mean(every >= value if above else every <= value))
            if share ** len(places) < CHANCE:
                return End(name, above, value, places[largest])
    return None


def _place(one: Scored, name: str, event: Event) -> float:
    """Return where a coordinate is at an event."""
    at = round((event.time - one.run.recording.start) / one.run.period)
    return float(one.run.smooth(name)[at])
