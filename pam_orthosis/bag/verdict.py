# SPDX-License-Identifier: Apache-2.0
"""Judge the tracking of a run from its bag alone.

Error = reference - measured angle, joined by header stamp. Angles come out in degrees.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import Bag, Series, aligned, legs_of, read_bag, run_record
from pam_orthosis.bag.timing import Timing, timing
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError

REST_FRACTION = 0.02
REST_SECONDS = 0.1
CATCH_UP_SECONDS = 2.0  # for a knee that was let go, to be back at its reference
LONGEST_GAP_NS = SECOND_NS  # without a sample that can be judged, or missing at the end
LEAST_SECONDS = 1.0  # of a run that was cut short, for a verdict on what is there
LEAST_SHARE = 0.5  # of the samples that are there, which can be judged: in real time some get no answer
ALWAYS_LED = ("gait", "sine", "steps", "hold")  # trajectories that never let the knee go
PERIOD = "scenario.control_period"
CLOSED = 0.0  # as a reference pressure, `control.trajectory.VALVES_CLOSED`: the valve is to stay closed
_NEEDED = ("angle", "reference_angle", "reference_velocity")
_REFERENCES = ("extensor_pressure_reference", "flexor_pressure_reference")
_USEFUL = ("estimate_velocity", "extensor_voltage", "flexor_voltage", *_REFERENCES)


@dataclass(frozen=True)
class Cycle:
    """Tracking within one gait cycle, from 1, or within the rest before it, 0; `start_s` of the run."""

    start_s: float
    max_abs_error_deg: float
    rms_error_deg: float
    number: int


@dataclass(frozen=True)
class Verdict:
    """What `check` reports; None where the bag does not tell.

    `steady_state_error_deg` is the mean |error| while the reference rests (|velocity| below 2 % of
    its peak for at least 0.1 s). `observer_velocity_lag_ms` is the delay of the estimated velocity
    behind the measured motion. `voltage_variation_per_s` is the total variation of each valve
    voltage per second: chatter. `timing` is that of a run in real time. `not_led` samples are not judged:
    the scenario kept the valves closed, or the knee was on its way back from there. `incomplete` says what
    cannot be judged though it should be; then it is not passed.
    """

    max_abs_error_deg: float
    rms_error_deg: float
    steady_state_error_deg: float | None
    max_abs_error_after_first_cycle_deg: float | None
    bound_deg: float
    passed: bool
    samples: int
    duration_s: float
    observer_velocity_lag_ms: float | None
    voltage_variation_per_s: dict[str, float]
    cycles: list[Cycle]
    scenario: str | None
    timing: Timing | None = None
    not_led: int = 0
    incomplete: str = ""
    remarks: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON."""
        return asdict(self)


def judge(
    path: Path, bound_deg: float = 3.0, skip_s: float = 0.0, namespace: str = "", partial: bool = False
) -> Verdict:
    """Judge a bag.

    Args:
        path: bag folder or file.
        bound_deg: passed if the largest |error| is at most this.
        skip_s: seconds at the start that are not judged.
        namespace: of the leg.
        partial: what is there is judged as if it were all, if it lasts `LEAST_SECONDS`.

    Raises:
        OrthosisError: the bag is unusable or holds no sample after `skip_s`.
    """
    bag, remarks = _read(path, namespace)
    stamps, (angle, reference, velocity) = _kept(bag, skip_s)
    incomplete = _incomplete(bag, stamps, skip_s)
    if partial:
        _check_enough(bag, stamps, incomplete)
        incomplete = ""
    error = np.degrees(reference - angle)
    led = ~not_led(stamps, _closed(bag, stamps), np.abs(error) <= bound_deg)
    if not led.any():
        raise OrthosisError(f"{bag.path}: the valves are closed throughout; there is no tracking to judge")
    stamps, error, velocity = stamps[led], error[led], velocity[led]
    since_start = (stamps - bag["angle"].stamp_ns[0]) / SECOND_NS
    hold_s, cycle_s = (bag.parameters.get(f"scenario.{name}") for name in ("start_hold", "cycle_time"))
    largest = float(np.abs(error).max())
    return Verdict(
        max_abs_error_deg=largest,
        rms_error_deg=_rms(error),
        steady_state_error_deg=steady_state_error(stamps, error, velocity),
        max_abs_error_after_first_cycle_deg=_largest_after(since_start, error, hold_s, cycle_s),
        bound_deg=bound_deg,
        passed=largest <= bound_deg and not incomplete,
        samples=len(stamps),
        duration_s=float(stamps[-1] - stamps[0]) / SECOND_NS,
        observer_velocity_lag_ms=_observer_lag(bag),
        voltage_variation_per_s=_voltage_variation(bag),
        cycles=[] if hold_s is None or not cycle_s else cycle_table(since_start, error, hold_s, cycle_s),
        scenario=bag.run.get("scenario"),
        not_led=int(np.count_nonzero(~led)),
        incomplete=incomplete,
        remarks=remarks,
        timing=timing(bag.path, namespace, bag.parameters.get(PERIOD)),
    )


def judge_all(
    path: Path,
    bound_deg: float = 3.0,
    skip_s: float = 0.0,
    partial: bool = False,
    namespace: str | None = None,
) -> dict[str, Verdict]:
    """Judge each leg of a bag, or one; the verdicts by the leg's namespace, none if there is one leg only.

    Raises:
        OrthosisError: as `judge`, or a leg of the run is not in the bag.
    """
    if namespace is not None:
        return {namespace.strip("/"): judge(path, bound_deg, skip_s, namespace, partial)}
    names = namespaces(path)
    verdicts = {name.strip("/"): judge(path, bound_deg, skip_s, name, partial) for name in names}
    if lost := sorted(legs_of(path, run_record(path)).keys() - verdicts.keys()):
        raise OrthosisError(
            f"{path}: the run had a leg {lost[0]}, and the bag has no /{lost[0]}/joint_states"
        )
    return verdicts


def steady_state_error(stamp_ns: np.ndarray, error: np.ndarray, velocity: np.ndarray) -> float | None:
    """Return the mean |error| (its unit) while the reference rests, None if it never does.

    Args:
        stamp_ns: (n,) stamps.
        error: (n,) tracking error.
        velocity: (n,) velocity of the reference.
    """
    still = np.abs(velocity) <= REST_FRACTION * np.abs(velocity).max()
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False]))))
    rests = [
        slice(start, end)
        for start, end in edges.reshape(-1, 2)
        if stamp_ns[end - 1] - stamp_ns[start] >= REST_SECONDS * SECOND_NS
    ]
    if not rests:
        return None
    return float(np.abs(np.concatenate([error[rest] for rest in rests])).mean())


def not_led(stamp_ns: np.ndarray, closed: np.ndarray, near: np.ndarray) -> np.ndarray:
    """Return whether nobody leads the knee: valves closed on purpose, or since then not yet caught up.

    Args:
        stamp_ns: (n,) stamps.
        closed: (n,) whether the valves are to stay closed.
        near: (n,) whether the knee is near its reference.
    """
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


def velocity_lag(angle: Series, velocity: Series) -> float | None:
    """Return the delay (s) of a velocity estimate behind the motion of a measured angle.

    The integral of a velocity that lags by d is q(t - d) = q(t) - d q-dot(t) to first order, so d
    is the least-squares slope of q minus that integral over the velocity; offset and drift are
    fitted beside it. No noisy differentiation is needed. None if nothing moves.
    """
    stamps, (q, rate) = aligned(angle, velocity)
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
    """Return the tracking of the rest at the start, as a whole, and of each cycle, where there are samples.

    Args:
        since_start: (n,) s.
        error: (n,) degrees.
        hold_s: duration of the rest.
        cycle_s: duration of a cycle.
    """
    number = np.maximum(np.floor((since_start - hold_s) / cycle_s), -1)
    return [
        Cycle(0.0 if k < 0 else hold_s + k * cycle_s, float(np.abs(part).max()), _rms(part), int(k) + 1)
        for k in np.unique(number)
        for part in [error[number == k]]
    ]


def _read(path: Path, namespace: str) -> tuple[Bag, tuple[str, ...]]:
    """Return the bag, and why something that is not needed for tracking is left out, if it is."""
    try:
        return read_bag(path, _NEEDED, _USEFUL, namespace), ()
    except OrthosisError as error:
        return read_bag(path, _NEEDED, _REFERENCES, namespace), (str(error),)


def _incomplete(bag: Bag, judged: np.ndarray, skip_s: float) -> str:
    """Return what of the run cannot be judged though it should be, nothing if all can that matters.

    Args:
        judged: (n,) stamps.
        skip_s: seconds at the start that shall not be judged.
    """
    there = [bag[name].stamp_ns for name in ("angle", "reference_angle")]
    start = bag["angle"].stamp_ns[0]
    begin, end = start + round(skip_s * SECOND_NS), max(stamps[-1] for stamps in there)
    planned_s = bag.parameters.get("scenario.duration") if bag.run.get("scenario") else None
    missing_ns = 0 if planned_s is None else start + round(planned_s * SECOND_NS) - end
    if missing_ns > LONGEST_GAP_NS:
        return f"the bag ends after {(end - start) / SECOND_NS:.3f} of {planned_s:g} s"
    edges = np.concatenate([[begin], judged, [end]])
    gap = int(np.argmax(np.diff(edges)))
    if edges[gap + 1] - edges[gap] > LONGEST_GAP_NS:
        since, until = ((edge - start) / SECOND_NS for edge in edges[gap : gap + 2])
        return f"from {since:.3f} to {until:.3f} s angle and reference share no stamp"
    most = max(np.count_nonzero(stamps >= begin) for stamps in there)
    if len(judged) < LEAST_SHARE * most:
        return f"angle and reference share {len(judged)} of {most} stamps"
    return ""


def _check_enough(bag: Bag, judged: np.ndarray, incomplete: str) -> None:
    """Raise OrthosisError if too little of a run is there for any verdict."""
    span_s = float(judged[-1] - judged[0]) / SECOND_NS
    told_s = len(judged) * bag.parameters.get(PERIOD, span_s)
    if incomplete and min(span_s, told_s) < LEAST_SECONDS:
        raise OrthosisError(
            f"{bag.path}: {len(judged)} samples in {span_s:.3f} s are too few to judge a run by;"
            f" samples of {LEAST_SECONDS:g} s are needed"
        )


def _closed(bag: Bag, stamps: np.ndarray) -> np.ndarray:
    """Return whether the scenario lets the knee go, both valves closed, at stamps (n,) of the samples."""
    asked = bag["reference_angle"].stamp_ns
    asked = asked[np.searchsorted(asked, stamps, side="right") - 1]
    there = [bag[name] for name in _REFERENCES if name in bag.series]
    closed = [np.isin(asked, one.stamp_ns[one.value == CLOSED]) for one in there]
    asks = bag.parameters.get("scenario.trajectory") not in ALWAYS_LED  # no controller excuses itself
    return np.all(closed, axis=0) if asks and len(closed) == 2 else np.zeros(len(stamps), dtype=bool)


def _kept(bag: Bag, skip_s: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return stamps and values behind what is skipped, on the stamps that all have."""
    stamps, values = aligned(bag["angle"], *_reference(bag))
    if not len(stamps):
        raise OrthosisError(f"{bag.path}: angle and reference share no stamp")
    kept = (stamps - stamps[0]) / SECOND_NS >= skip_s
    if not kept.any():
        raise OrthosisError(f"{bag.path} holds no sample after the first {skip_s:g} s")
    return stamps[kept], [value[kept] for value in values]


def _reference(bag: Bag) -> tuple[Series, Series]:
    """Return angle and velocity of the reference, at two rates also at the samples between its own.

    Between two of its instants, where none was lost, it is the cubic of their angles and velocities.
    """
    angle, velocity = bag["reference_angle"], bag["reference_velocity"]
    every, period = bag.parameters.get("control.position.every", 1), bag.parameters.get(PERIOD)
    if every == 1 or period is None or len(angle.stamp_ns) < 2:
        return angle, velocity
    from scipy.interpolate import CubicHermiteSpline  # takes its time to load

    own, sampled = angle.stamp_ns, bag["angle"].stamp_ns
    later = np.searchsorted(own, sampled)
    inside = sampled[(later > 0) & (later < len(own))]
    behind = np.searchsorted(own, inside)
    whole = own[behind] - own[behind - 1] < (every + 0.5) * period * SECOND_NS
    between = np.setdiff1d(inside[whole], own)
    cubic = CubicHermiteSpline((own - own[0]) / SECOND_NS, angle.value, velocity.value)
    at = (between - own[0]) / SECOND_NS
    return _merged(angle, between, cubic(at)), _merged(velocity, between, cubic(at, 1))


def _merged(series: Series, stamp_ns: np.ndarray, value: np.ndarray) -> Series:
    """Return a series with more samples in it."""
    stamps, values = np.concatenate([series.stamp_ns, stamp_ns]), np.concatenate([series.value, value])
    order = np.argsort(stamps, kind="stable")
    return Series(stamps[order], values[order])


def _largest_after(
    since_start: np.ndarray, error: np.ndarray, hold_s: float | None, cycle_s: float | None
) -> float | None:
    """Return the largest |error| later than one cycle time after the motion has begun."""
    if hold_s is None or cycle_s is None:
        return None
    later = error[since_start >= hold_s + cycle_s]
    return float(np.abs(later).max()) if len(later) else None


def _observer_lag(bag: Bag) -> float | None:
    if "estimate_velocity" not in bag.series:
        return None
    lag = velocity_lag(bag["angle"], bag["estimate_velocity"])
    return None if lag is None else 1e3 * lag


def _voltage_variation(bag: Bag) -> dict[str, float]:
    return {
        muscle: total_variation_rate(bag[f"{muscle}_voltage"])
        for muscle in ("extensor", "flexor")
        if f"{muscle}_voltage" in bag.series
    }


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))
