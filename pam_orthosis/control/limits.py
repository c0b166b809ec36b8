# SPDX-License-Identifier: Apache-2.0
"""Limits apart from the controllers: a monitor of measurements that can only take air out.

It allows the actuators a pressure. Above it a valve may not fill, further above it vents, whatever a
controller commands; below it the command passes. While all is well the highest pressure is allowed, after a
trip none, after a spasm that at which the joint is soft. It goes on by command only, and slowly.
"""

import re
from collections import deque
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import casadi as ca

from pam_orthosis.control.axis import Axis
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Section

SPASM, STALE, UNHEEDED = "spasm", "stale data", "command"
HALF = 4  # samples, of the span over which a motion is differentiated: as long before as after its middle


class Trip(NamedTuple):
    """A limit that was exceeded: which one, what was measured, what is allowed (SI), and when."""

    limit: str
    value: float
    allowed: float
    time_ns: int

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.limit} {self.value:.4g} beyond {self.allowed:.4g} at {self.time_ns * 1e-9:.3f} s"


def trips_in(words: str) -> list[Trip]:
    """Return the trips that a text is about, as they are in words."""
    found = re.findall(r"([a-z ]+) (\S+) beyond (\S+) at (\S+) s", words)
    return [
        Trip(limit.strip(), float(value), float(allowed), round(float(time) * 1e9))
        for limit, value, allowed, time in found
    ]


class Observed(NamedTuple):
    """What is compared with the limits: of now, but the effort from outside, which is `HALF` samples old.

    `effort` is that of the actuators on the joint and `force` the larger one of theirs, by the nominal model
    at the measured pressures; `outside` is what the measured motion takes beyond it, Eq. (26): a person,
    friction, errors of the model.
    """

    position: float
    velocity: float
    acceleration: float
    pressure: float
    effort: float
    force: float
    outside: float


class SafetyMonitor:
    """Watches a machine by its sensors alone; knows the nominal model and no controller.

    Attributes:
        trips: the limits that were exceeded since all was well; none: all is well.
    """

    def __init__(self, parameters: Parameters):
        nominal = parameters.nominal()
        self._limits, self._valve = nominal.control.limits, nominal.valve
        self._unheeded: dict[int, int] = {}  # valve -> since when its commands are above what is allowed
        self._ceilings: tuple[float, ...] = ()
        self._period = nominal.scenario.control_period
        self._estimate = compiled(watched_function(nominal, HALF * self._period))
        self._samples: deque[Sequence[float]] = deque(maxlen=2 * HALF + 1)
        self._outside: deque[float] = deque(maxlen=max(2, round(self._limits.spasm_time / self._period)))
        self._time_ns = 0
        self._allowed: float = self._limits.pressure
        self.trips: list[Trip] = []

    def step(self, time_ns: int, position: float, pressures: Sequence[float]) -> tuple[float, ...]:
        """Take a sample; return the highest voltage that each valve may have, V."""
        if self._samples and time_ns - self._time_ns > self._limits.stale_time * 1e9:
            self._note(STALE, (time_ns - self._time_ns) * 1e-9, self._limits.stale_time, time_ns)
        self._time_ns = time_ns
        sample = position, *pressures
        if not all(abs(number) < float("inf") for number in sample):
            self._note(STALE, position, self._limits.stale_time, time_ns)
            self._ceilings = self.vented()
            return self._ceilings
        self._samples.append(sample)
        if len(self._samples) == self._samples.maxlen:
            self._watch(self._now())
        elif max(pressures) > self._limits.pressure:
            self._note("pressure", max(pressures), self._limits.pressure, time_ns)
        self._allow()
        self._ceilings = tuple(
            ceiling(pressure, self.allowed, self._valve, self._limits.band) for pressure in pressures
        )
        return self._ceilings

    @property
    def allowed(self) -> float:
        """The pressure above which no valve may fill, and far above which it vents, Pa."""
        return 0.0 if self.venting else self._allowed

    def heard(self, line: int, voltage: float) -> None:
        """Take the command of a valve (its number), V: one that fills for long against the limits trips."""
        if not self._ceilings or voltage <= self._ceilings[line]:
            self._unheeded.pop(line, None)
            return
        since = (self._time_ns - self._unheeded.setdefault(line, self._time_ns)) * 1e-9
        if since > self._limits.stale_time:
            self._note(UNHEEDED, voltage, self._ceilings[line], self._time_ns)

    def retune(self, parameters: Parameters) -> None:
        """Take other limits."""
        self._limits = parameters.nominal().control.limits

    def silent(self, time_ns: int) -> bool:
        """Note that there is no sample yet at an instant; return whether valves have to vent by now."""
        age = (time_ns - self._time_ns) * 1e-9
        if age > self._limits.stale_time:
            self._note(STALE, age, self._limits.stale_time, time_ns)
        return self.venting

    @property
    def venting(self) -> bool:
        """Whether no pressure is allowed: a limit other than a spasm was exceeded."""
        return any(trip.limit != SPASM for trip in self.trips)

    def vented(self) -> tuple[float, ...]:
        """Return the voltages that vent all valves."""
        return tuple([self._valve.minimum_voltage] * (len(self._samples[0]) - 1 if self._samples else 2))

    def resume(self) -> str:
        """Go on by command; return why not, or nothing. The allowed pressure rises slowly from now on."""
        if not self.trips:
            return "nothing has tripped"
        now = self._now() if len(self._samples) == self._samples.maxlen else None
        broken = "no samples" if now is None else next((name for name, *_ in self._exceeded(now)), "")
        if not broken:
            self.trips.clear()
            self._outside.clear()
        return broken

    def _now(self) -> Observed:
        first, middle, last = (self._samples[index] for index in (0, HALF, -1))
        found = self._estimate([one[0] for one in (first, middle, last)], middle[1:], last[1:])[0].tolist()
        velocity, acceleration, effort, outside, *forces = found
        strongest = max(map(abs, forces))
        return Observed(last[0], velocity, acceleration, max(last[1:]), effort, strongest, outside)

    def _watch(self, now: Observed) -> None:
        for name, value, allowed in self._exceeded(now):
            self._note(name, value, allowed, self._time_ns)
        self._outside.append(now.outside)
        change = now.outside - self._outside[0]
        against = change * now.velocity < 0 or abs(now.velocity) < self._limits.still
        if against and abs(change) > self._limits.spasm:
            self._note(SPASM, change, self._limits.spasm, self._time_ns)

    def _exceeded(self, now: Observed) -> Iterator[tuple[str, float, float]]:
        """Yield name, value and limit of what is exceeded, or will be when valves have vented."""
        low, high = self._limits.low, self._limits.high
        time = self._limits.look_ahead
        ahead = now.position + time * (now.velocity + 0.5 * time * now.acceleration)
        if abs(now.velocity) < self._limits.still:  # who trembles goes nowhere yet
            ahead = now.position
        if not low <= ahead <= high:
            yield "range of motion", ahead, low if ahead < low else high
        for name, value, allowed in (
            ("speed", now.velocity + time * now.acceleration, self._limits.speed),
            ("torque", now.effort, self._limits.effort),
            ("force", now.force, self._limits.force),
            ("pressure", now.pressure, self._limits.pressure),
        ):
            if abs(value) > allowed:
                yield name, value, allowed

    def _note(self, limit: str, value: float, allowed: float, time_ns: int) -> None:
        """Keep the first trip of each limit."""
        if limit not in (trip.limit for trip in self.trips):
            self.trips.append(Trip(limit, value, allowed, time_ns))

    def _allow(self) -> None:
        """Set the allowed pressure: at once when something has tripped, slowly when it goes on."""
        limits = self._limits
        if self.trips:
            self._allowed = 0.0 if self.venting else limits.soft_pressure
        elif self._allowed < limits.pressure:
            least = max(self._allowed, limits.soft_pressure)
            rise = (limits.pressure - limits.soft_pressure) * self._period / limits.resume_time
            self._allowed = min(least + rise, limits.pressure)


def ceiling(pressure: float, allowed: float, valve: Section, band: float) -> float:
    """Return the highest voltage that a valve may have, V; the lowest one if the pressure is no number."""
    if pressure <= allowed:
        return float(valve.maximum_voltage)
    return float(valve.closed_voltage if pressure <= allowed + band else valve.minimum_voltage)


def watched_function(nominal: Parameters, half: float) -> ca.Function:
    """Return (three positions, pressures then, pressures now) -> what is observed, one column.

    The positions are `half` s apart, the first one the oldest; `then` is the middle one. The rows are
    velocity, acceleration and effort now, the effort from outside then, and the actuators' forces now.
    """
    axis = Axis(nominal)
    q, v, a, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("a"), ca.SX.sym("p", 2)
    effort, terms = axis.effort(q, v, (p[0], p[1])), axis.terms(q, v)
    resisting = terms.coriolis + terms.gravity
    efforts = ca.Function("efforts", [q, v, a, p], [effort, terms.inertia * a + resisting - effort])
    accelerate = ca.Function("accelerate", [q, v, a, p], [(effort + a - resisting) / terms.inertia])
    places, then, now = ca.SX.sym("places", 3), ca.SX.sym("then", 2), ca.SX.sym("now", 2)
    first, middle, last = ca.vertsplit(places)
    velocity, latest = (last - first) / (2 * half), (last - middle) / half
    acceleration = (last - 2 * middle + first) / half**2
    outside = efforts(middle, velocity, acceleration, then)[1]
    ahead, effort = accelerate(last, latest, outside, now), efforts(last, latest, 0, now)[0]
    observed = ca.vertcat(latest, ahead, effort, outside, *axis.tensions(last, latest, (now[0], now[1])))
    return ca.Function("watched", [places, then, now], [observed])


def restrained(voltages: Sequence[float], ceilings: Sequence[float]) -> tuple[float, ...]:
    """Return what valves get: no more than the monitor lets through."""
    return tuple(map(min, voltages, ceilings))
