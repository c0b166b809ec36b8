# SPDX-License-Identifier: Apache-2.0
"""What may be wrong with the recordings themselves: the model as configured fits them far better without it.

Gauge pressures that stay above the ambient one, another sign, kN for N, exchanged columns, rows in reverse
order: all look like any recording. What rubs hides a sign: only the work of the forces shows it then.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.recordings.data import smoothed
from pam_orthosis.discrepancy.recordings.ranges import LEAST_SHARE
from pam_orthosis.discrepancy.replay.injection import injection
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.systems.system import Equation, System

Signals = Mapping[str, np.ndarray]
CHECK = "CHECK THE RECORDINGS"
SUSPECT, BETTER = 20.0, 4.0  # times the noise that most mistakes leave; the factor by which mending helps
ALIKE = 1.1  # times what the best mending leaves: as good, as of an input and of what alone it drives
KNOWN, CLEAR = 10.0, 2.5  # the same of a zero or unit of signals that is off by a known amount, not any one
MOST_TURNED = 2 * np.pi  # rad, by joints
SLOW = 8.0  # Hz, below which what drives a motion is looked at
CREEP = 0.1  # of the usual velocity, below which the direction of a motion is uncertain
DRIVEN = 0.5  # correlation of what is missing with the direction of motion: rubbing gives a negative one


def mistake_words(held_out: Problem, cutoff: float) -> str:
    """Return what is said of the mistake that held-out recordings seem to have; empty if none.

    `cutoff`: with which neighbouring signals are smoothed, Hz.
    """
    own = _gap(held_out)
    recorded = [one.run.recording.signals for one in held_out.scored]
    mistakes = [*_of_load_cells(held_out.system, recorded)]
    known = [*_of_known_size(held_out.system, recorded)] if own >= KNOWN else []
    mistakes += known
    if own >= SUSPECT:
        mistakes += _mistakes(held_out.system, recorded)
    elif own < BETTER:
        return ""
    fits = {words: _fit(held_out, changed, cutoff) for words, changed in mistakes}
    words = min(fits, key=lambda one: fits[one], default="")
    asked = CLEAR if words in dict(known) else BETTER
    if not words or not fits[words] * asked <= own:
        return ""
    others = [one for one in fits if one != words and fits[one] < ALIKE * fits[words]]
    told = "; or as well ".join([words, *others])
    return f"{CHECK}: the model as configured fits them {own / fits[words]:.1f} times better {told}"


def _gap(held_out: Problem) -> float:
    """Return how many times the noise the model as configured leaves."""
    return _gap_of(held_out).white[measure.OVERALL]


def _gap_of(problem: Problem) -> measure.Gap:
    """Return the gap of the model as configured."""
    return measure.gap_at(problem, (), problem.replay.defaults(()))


def _fit(held_out: Problem, changed: list[Signals], cutoff: float) -> float:
    """Return the gap of the model as configured to held-out recordings with other signals."""
    scored = [
        Scored(_run(held_out.system, one, signals, cutoff), one.whiten, one.warm_up)
        for one, signals in zip(held_out.scored, changed, strict=True)
    ]
    problem = Problem(held_out.replay, scored)
    with np.errstate(all="ignore"):
        left = _gap_of(problem)
    for one in scored:
        held_out.replay.forget(one.run)
    overall = left.white[measure.OVERALL]
    return overall if np.isfinite(overall) and _follows(problem, left) else np.inf


def _follows(problem: Problem, left: measure.Gap) -> bool:
    """Return whether a model that leaves so much predicts each channel better than its mean does.

    Of replays that go astray one is always far better than another.
    """
    recorded = [one.run.recording.signals for one in problem.scored]
    usual = {name: np.mean([np.var(signals[name]) for signals in recorded]) for name in left.units}
    return all(left.units[name] ** 2 < usual[name] for name in usual)


def _run(system: System, one: Scored, signals: Signals, cutoff: float) -> Run:
    recording = one.run.recording
    return Run(system, replace(recording, signals={**recording.signals, **signals}), cutoff)


def _of_load_cells(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield what may be wrong with inputs that a sensor measures, and the signals without it."""
    for name in system.sensed:
        yield _turned(name, recorded)
        unit = system.unit(name)
        asked = f"with {name} times 1000: is it in k{unit}? --columns '{name}=COLUMN:k{unit}'"
        yield asked, [{name: 1e3 * signals[name]} for signals in recorded]


def _turned(name: str, recorded: list[Signals]) -> tuple[str, list[Signals]]:
    asked = f"with {name} of the other sign: turn it round by --columns {name}=-COLUMN"
    return asked, [{name: -signals[name]} for signals in recorded]


def _of_known_size(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield mistakes that are off by a known amount, and the signals of the recordings without them."""
    yield from _of_gauge(system, recorded)
    yield from _of_absolute(system, recorded)
    yield from _of_degrees(system, recorded)


def _of_gauge(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield that pressures, all or one, count from the ambient one."""
    pressures = _pressures(system)
    for gauge in dict.fromkeys([tuple(pressures), *((name,) for name in pressures)] if pressures else ()):
        added = f"with {system.ambient / 1e5:.3f} bar added to {' and '.join(gauge)}"
        asked = f"{added}: gauge, it seems, where absolute pressure is needed"
        yield asked, [{name: signals[name] + system.ambient for name in gauge} for signals in recorded]


def _pressures(system: System) -> list[str]:
    return [one.name for one in system.channels if system.is_absolute(one.name)]


def _mistakes(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield each other mistake that there may be, and the signals of the recordings without it."""
    pressures = _pressures(system)
    voltages = [name for name in system.inputs if system.unit(name) == "V"]
    signed = [name for name in _signed(system) if all(name in signals for signals in recorded)]
    yield from (_turned(name, recorded) for name in signed)
    pairs = [names for names in (pressures, voltages) if len(names) == 2]
    for chosen in (*([one] for one in pairs), pairs if len(pairs) > 1 else []):
        if chosen and all(name in signals for signals in recorded for names in chosen for name in names):
            swapped = {a: b for one, two in chosen for a, b in ((one, two), (two, one))}
            asked = " and ".join(f"{one} and {two}" for one, two in chosen)
            yield (
                f"with {asked} exchanged: are these columns mixed up?",
                [{name: signals[other] for name, other in swapped.items()} for signals in recorded],
            )
    backwards = "with the last row first: does time run backwards, or has an input the other sign?"
    yield backwards, [{name: values[::-1] for name, values in signals.items()} for signals in recorded]


def _signed(system: System) -> list[str]:
    """Return the signals that may have the other sign: coordinates, and all of a user's own system.

    Inputs that a sensor measures are looked at in any case. A user's sensors and amplifiers are unknown;
    pressures and valves of a machine have one sign.
    """
    if system.input_period:
        return [one.name for one in system.channels if one.state in system.derived.values()]
    inputs = [name for name in system.inputs if name not in system.sensed]
    return [*(one.name for one in system.channels), *inputs]


def _of_absolute(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield that pressures count from vacuum already, if they can."""
    pressures = _pressures(system)
    least = LEAST_SHARE * system.ambient
    mended: list[Signals] = [{name: one[name] - system.ambient for name in pressures} for one in recorded]
    if pressures and min(float(values.min()) for one in mended for values in one.values()) > least:
        taken = f"with {system.ambient / 1e5:.3f} bar taken from {' and '.join(pressures)}"
        yield f"{taken}: absolute, it seems, where their columns say gauge", mended


def _of_degrees(system: System, recorded: list[Signals]) -> Iterator[tuple[str, list[Signals]]]:
    """Yield that an angle was taken to be in degrees and is none, if it could turn so far."""
    for name in (one.name for one in system.channels if one.state in system.derived.values()):
        mended: list[Signals] = [{name: np.degrees(one[name])} for one in recorded]
        if system.unit(name) == "rad" and max(np.ptp(one[name]) for one in mended) < MOST_TURNED:
            yield f"with {name} {np.degrees(1):.1f} times as large: in rad, it seems, and headed deg", mended


def against_words(held_out: Problem) -> str:
    """Return what is said of a coordinate of a machine that moves against all known forces; empty if none."""
    system = held_out.system
    if system.changed is not None:  # what a system of a user's own may lack, nobody knows
        return ""
    for equation in system.equations:
        for name in equation.channels:
            if system.channel(name).state in system.derived.values() and _is_driven(held_out, equation, name):
                cells = "".join(f", or that of {one}" for one in system.sensed)
                return (
                    f"{CHECK}: {name} moves against the forces on it, as nothing does that rubs: is its sign"
                    f" reversed (--columns {name}=-COLUMN, or the arms and the range of the machine){cells},"
                    " or does something drive it that is not recorded?"
                )
    return ""


def _is_driven(held_out: Problem, equation: Equation, channel: str) -> bool:
    return all(_along(held_out, one, equation, channel) > DRIVEN for one in held_out.scored)


def _along(held_out: Problem, one: Scored, equation: Equation, channel: str) -> float:
    """Return the correlation of what is missing with the direction of a coordinate's motion.

    The model's damping at the coordinate is left out: too much of it would look like a drive.
    """
    values = held_out.replay.defaults(())
    linear = injection(held_out.replay, one.run, equation, channel, values)
    if linear is None:
        return 0.0
    raw = held_out.replay.residuals(one.run, equation, (), values)
    place = smoothed(one.run.recording.signals[channel], one.run.period, SLOW)
    velocity = np.gradient(place, one.run.period)
    missing = linear.added(raw, SLOW) + linear.slopes[:, linear.driven, linear.driven] * velocity
    missing, velocity = missing[one.warm_up :], velocity[one.warm_up :]
    usual = CREEP * float(np.std(velocity))
    way = np.clip(velocity / max(usual, 1e-300), -1.0, 1.0)
    return float(missing @ way / max(np.linalg.norm(missing) * np.linalg.norm(way), 1e-300))
