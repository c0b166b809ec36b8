# SPDX-License-Identifier: Apache-2.0
"""Diagnostic experiments: motions that separate confounded effects.

An experiment is a sequence of phases, each with a path of the position, a path of the mean pressure
of the actuators (co-contraction) and a switch that keeps the valves closed.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import NamedTuple

from pam_orthosis.control.reference import PressureReference, Reference, Valve
from pam_orthosis.model.parameters import Parameters, Section
from pam_orthosis.model.shapes import quintic

# time since the start of a phase -> value and its first two derivatives
Path = Callable[[float], tuple[float, float, float]]


class Phase(NamedTuple):
    """A part of an experiment: duration s, position rad or m, mean pressure absolute Pa, valves closed."""

    duration: float
    position: Path
    mean: Path
    closed: bool = False


class Experiment:
    """Phases run through one after the other after a rest; the end of the last one is held."""

    def __init__(self, phases: Sequence[Phase], rest: float):
        self._phases = list(phases)
        self._starts = list(accumulate((phase.duration for phase in phases), initial=rest))[:-1]
        self.duration = rest + sum(phase.duration for phase in phases)

    def sample(self, time_ns: int) -> Reference:
        """Return the reference at an instant, nanoseconds since the start."""
        time = time_ns * 1e-9
        index = max(bisect_right(self._starts, time) - 1, 0)
        phase = self._phases[index]
        since = min(max(time - self._starts[index], 0.0), phase.duration)
        closed = phase.closed and time >= self._starts[index]
        mean: PressureReference = Valve.CLOSED if closed else phase.mean(since)[0]
        return Reference(*phase.position(since), mean)


def hold(value: float) -> Path:
    """Return a path that stays."""
    return lambda time: (value, 0.0, 0.0)


def move(start: float, end: float, duration: float, blend: float) -> Path:
    """Return a path of constant speed that starts and stops smoothly within `blend`, at rest outside."""
    speed = (end - start) / (duration - blend)

    def rise(time: float) -> tuple[float, float, float]:
        s = time / blend
        return speed * blend * (s**3 - s**4 / 2), speed * s**2 * (3 - 2 * s), 6 * speed * s * (1 - s) / blend

    def path(time: float) -> tuple[float, float, float]:
        if time <= 0 or time >= duration:
            return (start if time <= 0 else end), 0.0, 0.0
        if time < blend:
            way, rate, acceleration = rise(time)
            return start + way, rate, acceleration
        if time > duration - blend:
            way, rate, acceleration = rise(duration - time)
            return end - way, rate, -acceleration
        return start + speed * (time - blend / 2), speed, 0.0

    return path


def multisine(centre: float, amplitude: float, duration: float) -> Path:
    """Return a sum of sines of `multisine_hz`, each of this amplitude, that fades in and out."""
    multisine_hz = (0.2, 0.5, 0.9, 1.6, 2.9)

    def path(time: float) -> tuple[float, float, float]:
        w, w1, w2 = _window(time, duration)
        f = f1 = f2 = 0.0
        for number, frequency in enumerate(multisine_hz):
            omega = 2 * math.pi * frequency
            phase = omega * time + math.pi * number**2 / len(multisine_hz)  # Schroeder: a low crest
            f += amplitude * math.sin(phase)
            f1 += amplitude * omega * math.cos(phase)
            f2 -= amplitude * omega**2 * math.sin(phase)
        return centre + w * f, w1 * f + w * f1, w2 * f + 2 * w1 * f1 + w * f2

    return path


def _window(time: float, duration: float) -> tuple[float, float, float]:
    """Return a quintic fade in and out with its two derivatives."""
    rising = time < duration / 2
    fade = 1.0  # s, in which a multisine comes and goes
    s = min(max((time if rising else duration - time) / fade, 0.0), 1.0)
    value, slope, bend = quintic(s)
    return value, slope / fade if rising else -slope / fade, bend / fade**2


class Script:
    """Writes an experiment from where the joint is: each call appends a phase."""

    def __init__(self, position: float, mean: float):
        self.position, self.mean = position, mean
        self.phases: list[Phase] = []

    def rest(self, duration: float) -> None:
        """Stay."""
        self.phases.append(Phase(duration, hold(self.position), hold(self.mean)))

    def go(self, duration: float, position: float | None = None, mean: float | None = None) -> None:
        """Move position and mean pressure, at constant speed but for the ends."""
        position = self.position if position is None else position
        mean = self.mean if mean is None else mean
        blend = min(0.25, 0.4 * duration)
        path = move(self.position, position, duration, blend)
        self.phases.append(Phase(duration, path, move(self.mean, mean, duration, blend)))
        self.position, self.mean = position, mean

    def throw(self, duration: float, position: float, closed: float) -> None:
        """Start a move and close the valves in its middle: the joint swings freely about its end."""
        path = move(self.position, position, duration, 0.4 * duration)
        rest = lambda time: path(0.5 * duration + time)  # noqa: E731
        self.phases.append(Phase(0.5 * duration, path, hold(self.mean)))
        self.phases.append(Phase(closed, rest, hold(self.mean), closed=True))
        self.position = position

    def close(self, duration: float) -> None:
        """Keep the valves closed; the reference stays."""
        self.phases.append(Phase(duration, hold(self.position), hold(self.mean), closed=True))

    def shake(self, duration: float, amplitude: float, mean: float) -> None:
        """A multisine about the present position while the mean pressure moves."""
        paths = multisine(self.position, amplitude, duration), move(self.mean, mean, duration, 0.25)
        self.phases.append(Phase(duration, *paths))
        self.mean = mean


def triangle(script: Script, d: Section) -> None:
    """Slow triangle at two mean pressures, 10 s: friction and hysteresis against elasticity."""
    for mean in (d.low_mean, d.high_mean):
        script.go(1.0, d.low_angle, mean)
        script.go(2.0, d.high_angle)
        script.go(2.0, d.low_angle)


def amplitudes(script: Script, d: Section) -> None:
    """Triangles of three amplitudes, 15 s: pre-sliding, backlash, dead band."""
    script.go(1.0, 0.5 * (d.low_angle + d.high_angle), 0.5 * (d.low_mean + d.high_mean))
    centre, whole = script.position, d.high_angle - d.low_angle
    for share, period in ((0.06, 2.0), (0.2, 2.0), (0.5, 3.0)):
        for _ in range(2):
            script.go(period / 4, centre + share * whole)
            script.go(period / 2, centre - share * whole)
            script.go(period / 4, centre)


def cocontraction(script: Script, d: Section) -> None:
    """Sweep of the mean pressure at two held positions, 10 s: scales and offsets of force and pressure."""
    for angle in (d.low_angle, d.high_angle):
        script.go(1.0, angle)
        script.go(1.4, mean=d.high_mean)
        script.go(1.6, mean=d.low_mean)
        script.go(1.0, mean=0.5 * (d.low_mean + d.high_mean))


def closed_hold(script: Script, d: Section) -> None:
    """Closed valves at four levels of pressure and position, 10 s: leaks and creep."""
    for angle, mean in (
        (d.low_angle, d.low_mean), (d.high_angle, d.low_mean),
        (d.high_angle, d.high_mean), (d.low_angle, d.high_mean),
    ):  # fmt: skip
        script.go(0.7, angle, mean)
        script.rest(0.2)
        script.close(1.6)


def shaking(script: Script, d: Section) -> None:
    """Multisine with a slowly varying mean pressure, 10 s: inertia, lags, delays."""
    script.go(1.0, 0.5 * (d.low_angle + d.high_angle), d.low_mean)
    script.shake(9.0, 0.05, d.high_mean)


def decay(script: Script, d: Section) -> None:
    """Fast steps, then closed valves: free decay at two mean pressures, 10 s: damping, mass, volume."""
    for mean in (d.low_mean, d.high_mean):
        script.go(1.0, d.low_angle, mean)
        for angle in (d.high_angle, d.low_angle):
            script.throw(0.4, angle, closed=1.3)
            script.rest(0.5)


def locked(script: Script, d: Section) -> None:
    """Steps of both pressures, 10 s, for a locked joint: volume, exponent, valve, hose, delays."""
    for mean in (d.high_mean, d.low_mean, 0.5 * (d.low_mean + d.high_mean)) * 2:
        script.go(0.1, mean=mean)
        script.rest(0.9)
    script.go(2.0, mean=d.high_mean)
    script.go(2.0, mean=d.low_mean)


def stiffness(script: Script, d: Section) -> None:
    """Closed valves, 15 s, for a torque from outside: stiffness at the mean pressure of the controller."""
    script.rest(1.0)
    script.close(14.0)


EXPERIMENTS: dict[str, tuple[Callable[[Script, Section], None], ...]] = {
    "triangle": (triangle, amplitudes),
    "cocontraction": (cocontraction,) * 2,
    "locked": (locked,) * 2,
    "decay": (decay,) * 2,
    "closed": (closed_hold,) * 2,
    "stiffness": (stiffness,),
    "protocol": (triangle, amplitudes, cocontraction, closed_hold, shaking, decay),
}


def make_experiment(name: str, parameters: Parameters) -> Experiment:
    """Return the experiment of this name, one of `EXPERIMENTS` with the levels of `scenario.diagnostic`."""
    scenario = parameters.scenario
    script = Script(parameters.at(parameters.declared.start), parameters.control.position.mean_pressure)
    for part in EXPERIMENTS[name]:
        part(script, scenario.diagnostic)
    return Experiment(script.phases, scenario.start_hold)
