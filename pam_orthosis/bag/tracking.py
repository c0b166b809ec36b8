# SPDX-License-Identifier: Apache-2.0
"""What a run is judged by: how well a motion follows its reference, how fast samples were answered, loads."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pam_orthosis.bag.bounded import open_bag
from pam_orthosis.bag.cdr import store
from pam_orthosis.bag.read import Bag, Series, aligned, read_bag
from pam_orthosis.bag.topics import ANSWERED, JOINT, SAMPLE, SECOND_NS, TIME_REFERENCE, resolve

REST_SECONDS = 0.1
CATCH_UP_SECONDS = 2.0  # for a machine whose valves were closed, to be back at its reference
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Cycle:
    """Tracking within one gait cycle, from 1, or within the rest before it, 0; `start_s` of the run."""

    start_s: float
    max_abs_error: float
    rms_error: float
    number: int


def steady_state_error(stamp_ns: np.ndarray, error: np.ndarray, velocity: np.ndarray) -> float | None:
    """Return the mean |error| (its unit) while the reference rests, None if it never does; all (n,)."""
    still = rests(stamp_ns, velocity)
    return float(np.abs(np.concatenate([error[rest] for rest in still])).mean()) if still else None


def rests(stamp_ns: np.ndarray, velocity: np.ndarray) -> list[slice]:
    """Return where a reference rests for `REST_SECONDS` and longer, by its velocity at stamps (n,)."""
    still = np.abs(velocity) <= 0.02 * np.abs(velocity).max()
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False]))))
    return [
        slice(start, end)
        for start, end in edges.reshape(-1, 2).tolist()
        if stamp_ns[end - 1] - stamp_ns[start] >= REST_SECONDS * SECOND_NS
    ]


def not_led(stamp_ns: np.ndarray, closed: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return whether nobody leads the machine: valves closed on purpose, or since then not `near`; (n,)."""
    free: np.ndarray = closed.copy()
    since_ns: int | None = None
    for index, stamp in enumerate(stamp_ns.tolist()):
        if closed[index]:
            since_ns = stamp
        elif since_ns is not None:
            back = near[index] or stamp - since_ns > CATCH_UP_SECONDS * SECOND_NS
            since_ns = None if back else since_ns
            free[index] = not back
    return free


def velocity_lag(place: Series, velocity: Series) -> float | None:
    """Return the delay (s) of a velocity estimate behind the motion of a measured coordinate.

    The integral of a velocity that lags by d is q(t - d) = q(t) - d q-dot(t) to first order, so d
    is the least-squares slope of q minus that integral over the velocity; offset and drift are
    fitted beside it. No noisy differentiation is needed. None if nothing moves.
    """
    stamps, (q, rate) = aligned(place, velocity)
    if len(stamps) < 4 or np.ptp(rate) == 0.0:
        return None
    time = (stamps - stamps[0]) / SECOND_NS
    integral = np.concatenate(([0.0], np.cumsum(np.diff(time) * (rate[1:] + rate[:-1]) / 2)))
    regressors = np.column_stack([rate, np.ones_like(time), time])
    return float(np.linalg.lstsq(regressors, q - integral, rcond=None)[0][0])


def total_variation_rate(series: Series) -> float:
    """Return the sum of |steps| of a signal per second."""
    span_s = (series.stamp_ns[-1] - series.stamp_ns[0]) / SECOND_NS
    return float(np.abs(np.diff(series.value)).sum() / span_s) if span_s else 0.0


def cycle_table(since_start: np.ndarray, error: np.ndarray, hold_s: float, cycle_s: float) -> list[Cycle]:
    """Return the tracking of the rest at the start, as a whole, and of each cycle that has samples (n,)."""
    number = np.maximum(np.floor((since_start - hold_s) / cycle_s), -1)
    return [
        Cycle(0.0 if k < 0 else hold_s + k * cycle_s, float(np.abs(part).max()), rms(part), int(k) + 1)
        for k in np.unique(number)
        for part in [error[number == k]]
    ]


def rms(values: np.ndarray) -> float:
    """Return the root of the mean of the squares."""
    return float(np.sqrt(np.mean(values**2)))


@dataclass(frozen=True)
class Timing:
    """Latency: from the instant of a sample until the voltages that answer it leave; None without answers.

    `missed_deadlines` counts, of all `periods`, those whose sample was answered later than one period
    after it, was never answered, or was skipped because the machine was too busy to take it.
    """

    periods: int
    skipped_samples: int
    deadline_ms: float
    missed_deadlines: int
    latency_median_ms: float | None
    latency_p99_ms: float | None
    latency_max_ms: float | None


def timing(path: Path, namespace: str = "", period_s: float | None = None) -> Timing | None:
    """Return the timing of a bag that can be read; None if it is of no run in real time.

    The period is that of most samples, if it is not given.
    """
    samples, left = (_instants(path, resolve(topic, namespace)) for topic in (SAMPLE, ANSWERED))
    if samples is None or len(samples) < 2 or left is None:
        return None
    stamps = np.array(sorted(samples))
    period_ns = int(np.median(np.diff(stamps))) if period_s is None else round(period_s * SECOND_NS)
    return judge_timing(stamps, left, period_ns)


def judge_timing(samples: np.ndarray, answered: Mapping[int, int], period_ns: int) -> Timing:
    """Return the timing of samples (n,) ns, n > 1, with stamp -> instant of the answer, ns."""
    latency = np.array([answered[stamp] - stamp for stamp in samples.tolist() if stamp in answered])
    periods = max(len(samples), round((samples[-1] - samples[0]) / period_ns) + 1)
    told = (np.percentile(latency, [50, 99, 100]) / 1e6).tolist() if len(latency) else [None] * 3
    return Timing(
        periods=periods,
        skipped_samples=periods - len(samples),
        deadline_ms=period_ns / 1e6,
        missed_deadlines=periods - int(np.count_nonzero(latency <= period_ns)),
        latency_median_ms=told[0],
        latency_p99_ms=told[1],
        latency_max_ms=told[2],
    )


def _instants(path: Path, topic: str) -> dict[int, int] | None:
    """Return stamps with the instants that the messages name, ns, or their stamps; None without the topic."""
    types = JOINT, TIME_REFERENCE
    instants = {}
    with open_bag(path) as reader:
        connections = [one for one in reader.connections if one.topic == topic and one.msgtype in types]
        # without a connection the reader would give every message there is
        for connection, _, data in reader.messages(connections) if connections else ():
            message: Any = store().deserialize_cdr(data, connection.msgtype)
            stamp = message.header.stamp
            instants[_ns(stamp)] = _ns(getattr(message, "time_ref", stamp))
    return instants if connections else None


def _ns(stamp: Any) -> int:
    return int(stamp.sec * SECOND_NS + stamp.nanosec)


@dataclass(frozen=True)
class Load:
    """Peaks of set and measured force, N, and how far apart in time both pass half of the set peak, ms.

    `late_ms` is the largest of these; None where the measured force passes it more or less often.
    """

    set_peak_N: float
    peak_N: float
    late_ms: float | None
    passed: bool


def compared(time: Array, asked: Array, force: Array) -> Load:
    """Compare forces over a cycle; time (n,) s, set and measured force (n,) N."""
    most, reached = float(asked.max()), float(force.max())
    wanted, there = (_crossings(time, one, 0.5 * most) for one in (asked, force))
    same = len(wanted) == len(there) > 0
    late = float(np.abs(there - wanted).max()) if same else None
    near = most >= 1.0 and abs(reached - most) <= 0.1 * most
    late_ms = None if late is None else 1e3 * late
    return Load(most, reached, late_ms, near and late is not None and late <= 0.03)


def loads_of(bag: Bag, namespace: str) -> dict[str, Load]:
    """Return the load of each actuator of a bag's leg; none where the machine follows a position."""
    known = bag.parameters
    if known.get("control.position.feedback", True):
        return {}
    cycle, ahead = (
        known["scenario.cycle_time"],
        known["valve.delay"] + 0.5 * known["scenario.control_period"],
    )
    names = [f"{name}_{kind}" for name in bag.machine.names for kind in ("pressure", "pressure_reference")]
    signals, found = read_bag(bag.path, names, (), namespace), {}
    for one in bag.machine.actuators:
        stamps, values = aligned(
            *(signals[f"{one.name}_{kind}"] for kind in ("pressure", "pressure_reference"))
        )
        time = (stamps - stamps[0]) / SECOND_NS
        pressure, asked = (
            known[f"{one.parameters}.area"] * (p - known["valve.ambient_pressure"]) for p in values
        )
        last = time > time[-1] - cycle
        found[one.name] = compared(time[last], np.interp(time - ahead, time, asked)[last], pressure[last])
    return found


def _crossings(time: Array, force: Array, level: float) -> Array:
    """Return the instants at which a force passes a level, s."""
    before = np.flatnonzero(np.diff(force > level))
    share = (level - force[before]) / (force[before + 1] - force[before])
    return np.asarray(time[before] + share * (time[before + 1] - time[before]))
