# SPDX-License-Identifier: Apache-2.0
"""Judge the tracking of a run from its bag alone.

Error = reference - measured coordinate, joined by header stamp. Angles come out in degrees, positions in mm.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.completeness import PERIOD, check_enough, incomplete
from pam_orthosis.bag.legs import namespaces
from pam_orthosis.bag.read import (
    Bag,
    Series,
    aligned,
    legs_of,
    read_bag,
    recorded_machine,
    recorded_valve,
    run_record,
)
from pam_orthosis.bag.releases import Release, begun_anew, releases
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.bag.tracking import (
    Cycle,
    Load,
    Timing,
    cycle_table,
    loads_of,
    not_led,
    rms,
    steady_state_error,
    timing,
    total_variation_rate,
    velocity_lag,
)
from pam_orthosis.control.reference import Valve
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine

ALWAYS_LED = ("gait", "sine", "steps", "hold")  # trajectories that never let the machine go
IN_UNIT = ("max_abs_error", "rms_error", "steady_state_error", "max_abs_error_after_first_cycle", "bound")


class Bound(NamedTuple):
    """A bound on the largest error, in a unit; none: in that in which the machine's errors are shown.

    `own`: namespace, or the end of it, -> a bound of its own.
    """

    value: float = 3.0
    unit: str = ""
    own: Mapping[str, float] = {}

    def at(self, namespace: str) -> Bound:
        """Return the bound of a namespace."""
        name = namespace.strip("/")
        own = [value for end, value in self.own.items() if _named(end, [name])]
        return self._replace(value=own[0]) if own else self


DEFAULT = Bound()


@dataclass(frozen=True)
class Verdict:
    """What `check` reports; None where the bag does not say.

    `steady_state_error` is the mean |error| while the reference rests (|velocity| below 2 % of
    its peak for at least 0.1 s). `observer_velocity_lag_ms` is the delay of the estimated velocity
    behind the measured motion. `voltage_variation_per_s` is the total variation of each valve
    voltage per second: chatter. `timing` is that of a run in real time. `not_led` samples are not judged:
    the scenario kept the valves closed, or the machine was on its way back from there. `incomplete` says what
    cannot be judged though it should be; then it is not passed. Errors and bound are in `unit`. `loads` are
    those of cushions, which have to be good too. `releases` count by the error that they leave; a run that
    ends released is not passed.
    """

    max_abs_error: float
    rms_error: float
    steady_state_error: float | None
    max_abs_error_after_first_cycle: float | None
    bound: float
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
    unit: str = "deg"
    loads: Mapping[str, Load] = field(default_factory=dict)
    releases: tuple[Release, ...] = ()

    @property
    def answer(self) -> str:
        """The verdict in a word; what is incomplete has failed only if what is there fails."""
        if self.passed:
            return "PASSED"
        held = _good(self.max_abs_error, self.bound, self.releases, self.loads)
        return "INCOMPLETE" if held else "FAILED"

    def figures(self) -> list[tuple[str, float, str]]:
        """Return in words what of the tracking is known: what, how much, unit."""
        rows = [
            ("maximum error", self.max_abs_error, self.unit),
            ("  after the first cycle", self.max_abs_error_after_first_cycle, self.unit),
            ("RMS error", self.rms_error, self.unit),
            ("steady-state error", self.steady_state_error, self.unit),
            ("observer's velocity lag", self.observer_velocity_lag_ms, "ms"),
        ]
        rows += [
            (f"{name} voltage variation", one, "V/s") for name, one in self.voltage_variation_per_s.items()
        ]
        return [(name, value, unit) for name, value, unit in rows if value is not None]

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict as plain data for JSON, errors with their unit in the name."""
        fields = self._named(asdict(self))
        del fields["unit"]
        if not self.loads:
            del fields["loads"]
        return fields | {"cycles": [self._named(cycle) for cycle in fields["cycles"]]}

    def _named(self, values: Mapping[str, Any]) -> dict[str, Any]:
        return {f"{key}_{self.unit}" if key in IN_UNIT else key: value for key, value in values.items()}


def judge(
    path: Path, bound: Bound = DEFAULT, skip_s: float = 0.0, namespace: str = "", partial: bool = False
) -> Verdict:
    """Judge a bag.

    Args:
        path: bag folder or file.
        bound: passed if the largest |error| is at most this.
        skip_s: seconds at the start that are not judged.
        namespace: of the leg.
        partial: what is there is judged as if it were all, if it lasts `LEAST_SECONDS`.

    Raises:
        OrthosisError: the bag is unusable, holds no sample after `skip_s`, or is of a machine whose errors
            are in another unit than the bound.
    """
    bag, remarks = _read(path, namespace)
    coordinate = bag.machine.coordinate
    most = bound_in(bound, bag.machine)
    stamps, (place, reference, velocity) = _kept(bag, skip_s)
    timed = timing(bag.path, namespace, bag.parameters.get(PERIOD))
    missing = incomplete(bag, stamps, skip_s, lockstep=timed is None)
    if partial:
        check_enough(bag, stamps, missing)
        missing = ""
    error = (reference - place) * coordinate.shown_factor
    near = np.abs(error) <= most
    lowest: float = recorded_valve(bag.path, bag.run, namespace).minimum_voltage
    released = releases(bag, lowest, (stamps, near), namespace)
    led = ~not_led(stamps, _closed(bag, stamps), near)
    if not led.any():
        raise OrthosisError(f"{bag.path}: the valves are closed throughout; there is no tracking to judge")
    stamps, error, velocity = stamps[led], error[led], velocity[led]
    since_start = (stamps - bag[coordinate.name].stamp_ns[0]) / SECOND_NS
    hold_s, cycle_s = (bag.parameters.get(f"scenario.{name}") for name in ("start_hold", "cycle_time"))
    largest, loads = float(np.abs(error).max()), loads_of(bag, namespace)
    if not partial and (missing or largest > most) and (anew := begun_anew(bag, namespace)):
        missing = "; ".join(filter(None, [missing, f"the hardware began anew, at rest, {anew}"]))
    return Verdict(
        max_abs_error=largest,
        rms_error=rms(error),
        steady_state_error=steady_state_error(stamps, error, velocity),
        max_abs_error_after_first_cycle=_largest_after(since_start, error, hold_s, cycle_s),
        bound=most,
        passed=not missing and _good(largest, most, released, loads),
        samples=len(stamps),
        duration_s=float(stamps[-1] - stamps[0]) / SECOND_NS,
        observer_velocity_lag_ms=_observer_lag(bag),
        voltage_variation_per_s=_voltage_variation(bag),
        cycles=[] if hold_s is None or not cycle_s else cycle_table(since_start, error, hold_s, cycle_s),
        scenario=bag.run.get("scenario"),
        not_led=int(np.count_nonzero(~led)),
        incomplete=missing,
        remarks=remarks,
        timing=timed,
        unit=coordinate.shown_unit,
        loads=loads,
        releases=released,
    )


def _good(largest: float, bound: float, released: Iterable[Release], loads: Mapping[str, Load]) -> bool:
    lost = any(release.lasts for release in released)
    return largest <= bound and not lost and all(load.passed for load in loads.values())


def bound_in(bound: Bound, machine: Machine) -> float:
    """Return a bound in the unit of a machine's errors; OrthosisError if it is in another."""
    unit = machine.coordinate.shown_unit
    if bound.unit not in ("", unit):
        raise OrthosisError(
            f"--bound-{bound.unit}: errors of the {machine.name} are in {unit}; give --bound-{unit}"
        )
    return bound.value


def judge_all(
    path: Path,
    bound: Bound = DEFAULT,
    skip_s: float = 0.0,
    partial: bool = False,
    namespace: str | None = None,
) -> dict[str, Verdict]:
    """Judge each leg of a bag, or one; the verdicts by the leg's namespace, none if there is one leg only.

    OrthosisError as of `judge`, or if a leg of the run is not in the bag.
    """
    if namespace is not None:
        return {namespace.strip("/"): judge(path, bound.at(namespace), skip_s, namespace, partial)}
    names = namespaces(path)
    verdicts = {name.strip("/"): judge(path, bound.at(name), skip_s, name, partial) for name in names}
    if strange := [end for end in bound.own if not _named(end, verdicts)]:
        there = f"there are: {', '.join(verdicts)}" if any(verdicts) else "it has one joint; give one bound"
        raise OrthosisError(f"{path}: no {strange[0]} to bound; {there}")
    if lost := sorted(legs_of(path, run_record(path)).keys() - verdicts.keys()):
        raise OrthosisError(
            f"{path}: the run had a leg {lost[0]}, and the bag has no /{lost[0]}/joint_states"
        )
    return verdicts


def _named(end: str, names: Iterable[str]) -> bool:
    return any(f"/{name}".endswith(f"/{end}") for name in names)


def _read(path: Path, namespace: str) -> tuple[Bag, tuple[str, ...]]:
    """Return the bag, and why something that is not needed for tracking is left out, if it is."""
    machine = recorded_machine(path, namespace)
    name, asked = machine.coordinate.name, _pressure_references(machine)
    needed = (name, f"reference_{name}", "reference_velocity")
    useful = ("estimate_velocity", *(f"{one}_voltage" for one in machine.names))
    try:
        return read_bag(path, needed, (*useful, *asked), namespace), ()
    except OrthosisError as error:
        return read_bag(path, needed, asked, namespace), (str(error),)


def _pressure_references(machine: Machine) -> tuple[str, ...]:
    return tuple(f"{name}_pressure_reference" for name in machine.names)


def _closed(bag: Bag, stamps: np.ndarray) -> np.ndarray:
    """Return whether the scenario lets the machine go, all valves closed, at stamps (n,) of the samples."""
    asked = bag[f"reference_{bag.machine.coordinate.name}"].stamp_ns
    asked = asked[np.searchsorted(asked, stamps, side="right") - 1]
    names = _pressure_references(bag.machine)
    there = [bag[name] for name in names if name in bag.series]
    closed = [np.isin(asked, one.stamp_ns[one.value == Valve.CLOSED.value]) for one in there]
    asks = bag.parameters.get("scenario.trajectory") not in ALWAYS_LED  # no controller excuses itself
    return np.all(closed, axis=0) if asks and len(closed) == len(names) else np.zeros(len(stamps), dtype=bool)


def _kept(bag: Bag, skip_s: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return stamps and values behind what is skipped, on the stamps that all have."""
    name = bag.machine.coordinate.name
    stamps, values = aligned(bag[name], *_reference(bag))
    if not len(stamps):
        raise OrthosisError(f"{bag.path}: {name} and reference share no stamp")
    kept = (stamps - stamps[0]) / SECOND_NS >= skip_s
    if not kept.any():
        raise OrthosisError(f"{bag.path} holds no sample after the first {skip_s:g} s")
    return stamps[kept], [value[kept] for value in values]


def _reference(bag: Bag) -> tuple[Series, Series]:
    """Return place and velocity of the reference, at two rates also at the samples between its own.

    Between two of its instants, where none was lost, it is the cubic of their places and velocities.
    """
    name = bag.machine.coordinate.name
    place, velocity = bag[f"reference_{name}"], bag["reference_velocity"]
    every, period = bag.parameters.get("control.position.every", 1), bag.parameters.get(PERIOD)
    if every == 1 or period is None or len(place.stamp_ns) < 2:
        return place, velocity
    from scipy.interpolate import CubicHermiteSpline  # takes its time to load

    own, sampled = place.stamp_ns, bag[name].stamp_ns
    later = np.searchsorted(own, sampled)
    inside = sampled[(later > 0) & (later < len(own))]
    behind = np.searchsorted(own, inside)
    whole = own[behind] - own[behind - 1] < (every + 0.5) * period * SECOND_NS
    between = np.setdiff1d(inside[whole], own)
    cubic = CubicHermiteSpline((own - own[0]) / SECOND_NS, place.value, velocity.value)
    at = (between - own[0]) / SECOND_NS
    return _merged(place, between, cubic(at)), _merged(velocity, between, cubic(at, 1))


def _merged(series: Series, stamp_ns: np.ndarray, value: np.ndarray) -> Series:
    """Return a series with more samples in it."""
    stamps = np.concatenate([series.stamp_ns, stamp_ns])
    values = np.concatenate([series.value, value])
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
    lag = velocity_lag(bag[bag.machine.coordinate.name], bag["estimate_velocity"])
    return None if lag is None else 1e3 * lag


def _voltage_variation(bag: Bag) -> dict[str, float]:
    return {
        muscle: total_variation_rate(bag[f"{muscle}_voltage"])
        for muscle in bag.machine.names
        if f"{muscle}_voltage" in bag.series
    }
