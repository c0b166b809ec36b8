# SPDX-License-Identifier: Apache-2.0
"""Are signals stamped late against each other? Seen from the accelerations, before any search.

The model's acceleration is evaluated at recorded signals, with what drives the motion (pressures, inputs)
shifted in time, and compared with the recorded acceleration. What the nominal parameters leave open enters
linearly, and so do mistakes in them, and friction, hysteresis and elasticity that it may not have. The shift
that leaves least is the skew: of stamps, or of a sensor that lags by as much.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from types import SimpleNamespace
from typing import NamedTuple, TypeAlias

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.recordings.data import Recording, smoothed
from pam_orthosis.discrepancy.systems.system import Assembled, Names, System
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.identification.damping import slip_element

REACH, STEP = 0.025, 0.0025  # s: shifts that are tried
MOST_SAMPLES = 1500  # that are compared, evenly taken
SLOW = 0.05, 0.5  # of the usual velocity: where friction that may be missing has turned round
SLIPS = 0.03, 0.1, 0.3  # of the coordinate's range: hysteresis that may be missing
ORDERS = 1, 2, 3  # of the coordinate's range: elasticity that may be missing
ALIKE = 0.003  # s: within it recordings of one clock show the same skew
LEAST = (
    0.0025  # s, of a skew that is worth a remark, and half a sample: sound recordings have shown up to 1.2 ms
)
CUTOFF = 15.0  # Hz, of both accelerations
SETTLING = 0.2  # s at both ends, which smoothing and shifts spoil
ALONE = 1.01  # of its remainder: by so much less has to be left with one signal late than with all
LEAST_GAIN, SMALL = 0.05, 0.005  # of what no shift leaves, that a skew up to `SMALL`, s, takes away; and
MOST_ASKED = 0.16  # that a large one must: of real stamps 17 ms early it is 0.18, of none 0.14 at most
LEAST_BENT = 0.006  # second difference of remainders over the least one: below it the shift is not known
ORDINARY, WILD = 0.95, 2.0  # quantile of a slope, and the multiple of it up to which it counts
FEWEST = 200  # samples
RAREST = 0.01  # s between samples: farther apart, sound recordings of 20 ms have shown skews of 5 ms


class Skew(NamedTuple):
    """By how much signals lag behind a channel, s; `gain`: share of the deviation that the shift explains."""

    channel: str
    signals: tuple[str, ...]
    seconds: float
    gain: float


Found: TypeAlias = Sequence[tuple[Recording, Sequence[Skew]]]


def shared_skews(system: System, recordings: Sequence[Recording], workers: Workers | None = None) -> Found:
    """Return the skews of each recording that enough of them show.

    At least half of the recordings have to show the same skew, more than half if it is small: a missing
    effect or slack muscles may look like one in some. So may an effect that the model has and the recordings
    have not: they show it without that one too.
    """
    workers = workers or Workers()
    found = _shared(system, recordings, workers)
    if not system.simpler or not any(many for _, many in found):
        return found
    plain = _shared(_with_delays_alone(system), recordings, workers)
    return [
        (one, [skew for skew in many if any(_is_like(skew, other) for other in others)])
        for (one, many), (_, others) in zip(found, plain, strict=True)
    ]


def _shared(system: System, recordings: Sequence[Recording], workers: Workers) -> Found:
    every = workers.forked(lambda one: skews(system, one), recordings)
    return [
        (one, [skew for skew in many if _is_shared(skew, every)])
        for one, many in zip(recordings, every, strict=True)
    ]


def _with_delays_alone(system: System) -> System:
    """Return the system without the effects that its model has already, delays apart."""
    known = system.bare().catalogue
    delays = {name for name, one in known.items() if one.late is not None or one.advance is not None}
    for name in set(system.simpler) - delays:
        system = system.without_effect(name)
    return system


def _is_like(one: Skew, other: Skew) -> bool:
    return one[:2] == other[:2] and one.seconds * other.seconds > 0


def clearly_off(found: Found) -> bool:
    """Whether a skew is longer than a sample, by which an input that is held may seem late or early."""
    return any(abs(skew.seconds) > one.period for one, many in found for skew in many)


def remarks_on_stamps(
    system: System, recordings: Sequence[Recording], workers: Workers | None = None
) -> list[str]:
    """Return remarks on signals that are stamped late or early against a coordinate."""
    return remarks_on(system, shared_skews(system, recordings, workers))


def remarks_on(system: System, found: Found) -> list[str]:
    """Return remarks on skews: one on each recording, if one has any."""
    if not any(many for _, many in found):
        return []
    unclear = "does not show by itself whether its stamps are off as those of the others are"
    return [
        f"{one.name}: {' and '.join(skew.signals)} stamped {1e3 * abs(skew.seconds):.1f} ms"
        f" {'late' if skew.seconds > 0 else 'early'} against {skew.channel}, or a sensor lags as much; give"
        f" all signals one clock{_or_stated(system, skew)}"
        for one, many in found
        for skew in many
    ] + [f"{one.name} {unclear}" for one, many in found if not many]


def _or_stated(system: System, skew: Skew) -> str:
    """Return where a system can have the delay; empty if it cannot."""
    if not system.input_period:  # no machine: a user wrote it
        return ", or state the delay (`late` of a Model)"
    late = skew.signals if skew.seconds > 0 else (skew.channel,)
    delays = {
        channel: f"`{system.branch}.{name}.enabled` and `.delay`"
        for name, one in system.bare().catalogue.items()
        if one.advance is not None
        for channel in one.advance(SimpleNamespace(**{q.name: q.typical for q in one.parameters}))
    }
    if not set(late) <= set(delays):
        return ""
    return f", or state the delay ({', '.join(delays[name] for name in late)} in a model file)"


def _is_shared(skew: Skew, every: Sequence[Sequence[Skew]]) -> bool:
    """Return whether enough recordings show a skew, or nearly."""
    same = [
        [one.seconds for one in many if one[:2] == skew[:2] and abs(one.seconds - skew.seconds) <= ALIKE]
        for many in every
    ]
    shown = [seconds[0] for seconds in same if seconds]
    large = abs(float(np.median(shown))) > SMALL
    return 2 * len(shown) > len(every) - large


@np.errstate(all="ignore")  # of a model that divides by 0 or runs away: its replay says so
def skews(system: System, one: Recording) -> list[Skew]:
    """Return how far what drives each coordinate is off in time; small or unclear ones are left out."""
    if one.period > RAREST:
        return []
    wrong = tuple(name for name in system.wrong if name in system.catalogue)
    assembled, found = system.assemble(wrong), []
    for rate, state in system.derived.items():
        channel = next(c.name for c in system.channels if c.state == state)
        felt = _felt(system, assembled, rate, channel)
        drivers = tuple(name for name in felt if name not in _coordinates(system))
        if not drivers or any(name not in one.signals for name in felt) or one.samples < FEWEST:
            continue
        groups = dict.fromkeys([drivers, *((name,) for name in drivers)])
        left_by = _remainders(system, assembled, one, rate, channel, felt)
        left = {late: left_by(late) for late in groups}
        late = min(left, key=lambda names: left[names].min() * (1.0 if names == drivers else ALONE))
        skew = _least(left[late], max(LEAST, one.period / 2))
        if skew is not None:
            found.append(Skew(channel, late, *skew))
    return found


def _felt(system: System, assembled: Assembled, rate: str, channel: str) -> tuple[str, ...]:
    """Return the other channels and the inputs that a coordinate's acceleration depends on."""
    acceleration = assembled.rates[assembled.states.index(rate)]
    moved = {*system.derived_twice.values(), None}
    by_state = {c.state: c.name for c in system.channels if c.state not in moved and c.name != channel}
    rates = {parent: rate for rate, parent in system.derived.items()}

    def feels(state: str) -> bool:
        names = [one for one in (state, rates.get(state)) if one]
        return any(_depends(acceleration, assembled.x[assembled.states.index(one)]) for one in names)

    felt = [name for state, name in by_state.items() if state and feels(state)]
    inputs = [name for i, name in enumerate(system.inputs) if _depends(acceleration, assembled.u[i])]
    return (*felt, *inputs)


def _coordinates(system: System) -> set[str]:
    """Return the channels that are coordinates.

    Another one is not looked for late: where a shaft or spring joins them, a shift is a damping that a slope
    makes up for.
    """
    return {one.name for one in system.channels if one.state in system.derived.values()}


def _depends(expression: ca.SX, symbol: ca.SX) -> bool:
    return bool(ca.depends_on(expression, symbol))


def _remainders(
    system: System, assembled: Assembled, one: Recording, rate: str, channel: str, felt: tuple[str, ...]
) -> Callable[[Names], np.ndarray]:
    """Return what gives, for signals that may be late, what remains of the acceleration by their shift."""
    time = np.arange(one.samples) * one.period
    ends = round(SETTLING / one.period)
    places = np.unique(np.linspace(ends, one.samples - ends - 1, MOST_SAMPLES).astype(int))
    smooth = {name: smoothed(one.signals[name], one.period, CUTOFF) for name in (channel, *felt)}
    velocity = np.gradient(smooth[channel], one.period)
    measured = np.gradient(velocity, one.period)[places]
    missing = _missing(smooth[channel], velocity, [smooth[name] for name in felt])[places]
    law = _law(assembled, rate, len(places), _right(system, assembled))
    aged = system.aged.get(channel, 0.0)
    acts = {name: aged + _late(system, name, one.period) for name in felt}
    beside = _beside(system, one, places)
    rates = {of: np.gradient(smooth[name], one.period) for of, name in _rates(system, felt).items()}

    def remainder(late: Names, shift: float) -> float:
        lead = {n: shift * (n in late) - acts[n] for n in felt}
        at = {name: np.clip(time[places] + lead[name], 0.0, time[-1]) for name in felt}
        values = {name: np.interp(at[name], time, smooth[name]) for name in felt}
        values[channel] = smooth[channel][places]
        base: dict[str | None, np.ndarray] = {
            c.state: values.get(c.name, one.signals[c.name][places]) for c in system.channels
        }
        base[rate] = velocity[places]
        moving = _rates(system, felt).items()
        base.update({of: np.interp(at[name], time, rates[of]) for of, name in moving})
        base.update(beside)
        x = np.array([base.get(name, np.zeros(len(places))) for name in assembled.states])
        u = np.array([values.get(name, np.zeros(len(places))) for name in system.inputs])
        model, slopes = law(x, u.reshape(len(system.inputs), -1), time[None, places])
        columns = np.asarray(slopes).reshape(assembled.theta.shape[0], len(places), order="F").T
        return _remainder(measured - np.asarray(model)[0], np.column_stack([_tame(columns), missing]))

    return lambda late: _near_the_least(partial(remainder, late))


def _late(system: System, name: str, period: float) -> float:
    """Return how late a recorded signal acts by the model, s."""
    if name not in system.inputs:
        return -system.aged.get(name, 0.0)
    held = period / 2 * (name not in system.gradual)
    return system.late * (name not in system.sensed) + system.later.get(name, 0.0) + held


def _rates(system: System, drivers: Sequence[str]) -> dict[str, str]:
    """Return the states that are rates of other coordinates, and their channels."""
    by_state = {one.state: one.name for one in system.channels if one.name in drivers}
    return {rate: by_state[state] for rate, state in system.derived.items() if state in by_state}


def _tame(slopes: np.ndarray) -> np.ndarray:
    """Return slopes (n, k) without the few that are far beyond all others: there a muscle becomes slack."""
    usual = np.quantile(np.abs(slopes), ORDINARY, axis=0)
    most = np.where(usual > 0, WILD * usual, np.inf)
    tame: np.ndarray = np.clip(slopes, -most, most)
    return tame


def _near_the_least(remainder: Callable[[float], float]) -> np.ndarray:
    """Return a function at every other shift and on both sides of the best of these; infinity elsewhere."""
    shifts = _shifts()
    found = np.full(len(shifts), np.inf)
    found[::2] = [remainder(shift) for shift in shifts[::2]]
    best = int(np.argmin(found))
    for i in {max(best - 1, 0), min(best + 1, len(shifts) - 1)} - {best}:
        found[i] = remainder(shifts[i])
    return found


def _beside(system: System, one: Recording, places: np.ndarray) -> dict[str, np.ndarray]:
    """Return velocity and acceleration of coordinates whose acceleration is no part of the model."""
    found: dict[str, np.ndarray] = {}
    for bent, state in system.derived_twice.items():
        (channel,) = (c.name for c in system.channels if c.state == state)
        (rate,) = (rate for rate, of in system.derived.items() if of == state)
        slope = np.gradient(smoothed(one.signals[channel], one.period, CUTOFF), one.period)
        found |= {rate: slope[places], bent: np.gradient(slope, one.period)[places]}
    return found


def _right(system: System, assembled: Assembled) -> list[float]:
    """Return the model's parameters with nothing off and nothing mistaken."""
    known = {
        f"{name}.{q.name}": q.neutral
        for name in system.wrong
        if name in system.catalogue
        for q in system.catalogue[name].parameters
    }
    return [float(known.get(name) or 0.0) for name in assembled.parameters]


def _law(assembled: Assembled, rate: str, count: int, values: Sequence[float]) -> ca.Function:
    """Return (states, inputs, times) -> acceleration and its slopes over the parameters, of many samples."""
    acceleration = assembled.rates[assembled.states.index(rate)]
    slopes = ca.densify(ca.jacobian(acceleration, assembled.theta))
    results = ca.substitute([acceleration, slopes], [assembled.theta], [ca.DM(values)])
    return ca.Function("law", [assembled.x, assembled.u, assembled.time], results).map(count)


def _missing(position: np.ndarray, velocity: np.ndarray, drivers: Sequence[np.ndarray]) -> np.ndarray:
    """Return what the model may not have and what would look like a skew, (n, k)."""
    usual = float(np.sqrt(np.mean(velocity**2)))
    ways = [np.tanh(velocity / (share * usual)) for share in SLOW]
    place = (position - position.mean()) / np.ptp(position)
    elastic = [function(2 * np.pi * n * place) for n in ORDERS for function in (np.sin, np.cos)]
    slips = [slip_element(place, distance) for distance in SLIPS]
    loaded = [way * one for way in (ways[0], *slips) for one in drivers]
    return np.column_stack([velocity, *ways, *elastic, *slips, *loaded])


def _remainder(target: np.ndarray, columns: np.ndarray) -> float:
    """Return the squares of what a combination of columns leaves of a signal; infinity for no finite ones."""
    if not (np.isfinite(target).all() and np.isfinite(columns).all()):
        return np.inf
    matrix = np.column_stack([columns[:, np.ptp(columns, axis=0) > 0], np.ones(len(target))])
    matrix = matrix / np.linalg.norm(matrix, axis=0)
    rest = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    return float(rest @ rest)


def _shifts() -> np.ndarray:
    return np.arange(-REACH, REACH + STEP / 2, STEP)


def _least(left: np.ndarray, smallest: float) -> tuple[float, float] | None:
    """Return the shift of least remainder, s, and what it explains; None if it is small or unclear."""
    shifts, best = _shifts(), int(np.argmin(left))
    none = left[len(left) // 2]
    gain = float(1 - left[best] / none) if none > 0 else 0.0
    if best in (0, len(left) - 1):
        return None
    before, here, after = left[best - 1 : best + 2]
    bent = float(before - 2 * here + after)
    if bent < LEAST_BENT * here:
        return None
    place = float(shifts[best]) + STEP * float(before - after) / (2 * bent)
    # what a skew leaves grows with its square: a large one that explains little is none
    asked = min(MOST_ASKED, LEAST_GAIN * max(1.0, (place / SMALL) ** 2))
    return (place, gain) if abs(place) >= smallest and gain >= asked else None
