# SPDX-License-Identifier: Apache-2.0
"""Reference trajectories: twice differentiable, starting smoothly from rest."""

import math
from typing import NamedTuple

from pam_orthosis.control import diagnostic
from pam_orthosis.control.diagnostic import Experiment
from pam_orthosis.control.reference import Motion, Reference
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.mechanisms import Sole
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rules import out_of_reach
from pam_orthosis.model.shapes import Shape, fourier_shape, scaled_shape, scenario_shape, smooth_step

COUPLED = ("gait", "hold")  # motions that are another joint's too


class Planned(NamedTuple):
    """Shapes, over the cycles from where it starts, of what a plan asks for; see `planning`.

    `change` is the planned less the desired position, `mean` the mean pressure, absolute Pa, `resting` at
    rest. Both were planned for one cycle time, s. A load shrinks with the cadence: its position is `unloaded`
    at rest; None: the machine presses on nobody.
    """

    change: Shape
    mean: Shape
    resting: float
    cycle_time: float
    unloaded: float | None = None


class Trajectory:
    """A periodic shape run through at a cadence that rises smoothly from zero, and may change on the way.

    Args:
        shape: cycle phase -> position and its first two derivatives by the phase.
        cycle_time, hold, ramp: duration of a cycle, of the rest before the motion and of each change
            of the cadence, s.
        phase: phase of the cycle at rest.
        plan: of the motion near this one that is followed instead, if any.
        beside: the shape that a coupled joint runs through at the same cadence, if there is one.
    """

    def __init__(
        self,
        shape: Shape,
        cycle_time: float,
        hold: float,
        ramp: float,
        phase: float,
        plan: Planned | None = None,
        beside: Shape | None = None,
    ):
        self._shape, self._plan, self._beside = shape, plan, beside
        self._hold, self._ramp, self._start = hold, ramp, phase
        self._cycle_time, self._target = cycle_time, math.inf
        self._changes: list[tuple[float, float, float]] = []
        self._change(0.0, cycle_time)

    @property
    def stopped(self) -> bool:
        """Whether it rests, or is on the way to rest, since `stop`."""
        return math.isinf(self._target)

    def sample(self, time_ns: int) -> Reference:
        """Return the reference at an instant, nanoseconds since the start."""
        phase, rate, curvature = self.phase(time_ns)
        reference = Reference(*_moved(self._shape(self._start + phase), rate, curvature))
        if self._beside is not None:
            reference = reference._replace(beside=_moved(self._beside(self._start + phase), rate, curvature))
        return reference if self._plan is None else _planned(self._plan, reference, phase, rate, curvature)

    def phase(self, time_ns: int) -> tuple[float, float, float]:
        """Return the phase since the start, in cycles, and its two time derivatives."""
        return self._phase(time_ns * 1e-9 - self._hold)

    def set_cycle_time(self, time_ns: int, cycle_time: float) -> None:
        """Pass smoothly to another cycle time (s) from an instant on; the phase does not jump."""
        self._cycle_time = cycle_time
        if not self.stopped:
            self._change(time_ns * 1e-9 - self._hold, cycle_time)

    def stop(self, time_ns: int) -> None:
        """Come smoothly to rest, wherever in the cycle that is."""
        self._change(time_ns * 1e-9 - self._hold, math.inf)

    def go_on(self, time_ns: int) -> None:
        """Pass smoothly from rest to the cycle time."""
        self._change(time_ns * 1e-9 - self._hold, self._cycle_time)

    def _change(self, begin: float, cycle_time: float) -> None:
        """Note a change of the cadence: its beginning, the cycle times before and after."""
        self._changes.append((max(0.0, begin), self._target, cycle_time))
        self._target = cycle_time

    def _phase(self, time: float) -> tuple[float, float, float]:
        """Return phase and its two time derivatives, the sum of all changes of the cadence."""
        phase = rate = curvature = 0.0
        for begin, before, after in self._changes:
            covered, cadence, growth = smooth_step(time - begin, self._ramp)
            phase += covered / after - covered / before
            rate += cadence / after - cadence / before
            curvature += growth / after - growth / before
        return phase, rate, curvature


def _moved(shape: tuple[float, float, float], rate: float, curvature: float) -> Motion:
    """Return the motion along a shape, given with its derivatives by the phase, whose phase has these."""
    position, slope, bend = shape
    return Motion(position, slope * rate, bend * rate**2 + slope * curvature)


def _planned(plan: Planned, wanted: Reference, phase: float, rate: float, curvature: float) -> Reference:
    """Return the reference with the plan's motion; below the planned cadence less of its mean pressure."""
    change, slope, bend = plan.change(phase)
    share = min(1.0, rate * plan.cycle_time)
    planned = Motion(
        wanted.position + change,
        wanted.velocity + slope * rate,
        wanted.acceleration + bend * rate**2 + slope * curvature,
    )
    mean = plan.resting + share * (plan.mean(phase)[0] - plan.resting)
    if plan.unloaded is not None:
        growth = curvature * plan.cycle_time if share < 1.0 else 0.0
        desired = _shrunk(Motion(*wanted[:3]), plan.unloaded, share, growth)
        planned = _shrunk(planned, plan.unloaded, share, growth)
        wanted = Reference(*desired, beside=wanted.beside)
    return wanted._replace(mean_pressure=mean, planned=planned)


def _shrunk(motion: Motion, rest: float, share: float, growth: float) -> Motion:
    """Return a share of a motion's distance from rest; how the share's growth changes moves nothing heavy."""
    away = motion.position - rest
    return Motion(
        rest + share * away,
        share * motion.velocity + growth * away,
        share * motion.acceleration + 2.0 * growth * motion.velocity,
    )


def settling_shape(settled: Shape, more: Shape, cycles: float) -> Shape:
    """Return a shape to which is added at the start what dies away by a factor e within so many cycles."""

    def shape(phase: float) -> tuple[float, float, float]:
        position, slope, bend = settled(phase)
        a, s, b = more(phase)
        left = math.exp(-phase / cycles)
        return (
            position + left * a,
            slope + left * (s - a / cycles),
            bend + left * (b - 2 * s / cycles + a / cycles**2),
        )

    return shape


def make_trajectory(parameters: Parameters) -> Trajectory | Experiment:
    """Return what `scenario` asks for: a `Trajectory` or a diagnostic experiment.

    Raises:
        OrthosisError: the machine's stops are in the way, or the experiment is not for this machine.
    """
    s, machine = parameters.scenario, parameters.declared
    for sentence in out_of_reach(parameters.flat(), machine):
        raise OrthosisError(sentence)
    if s.trajectory in diagnostic.EXPERIMENTS:
        if not machine.experiments:
            raise OrthosisError(f"scenario.trajectory = {s.trajectory} is not for the {machine.name}")
        return diagnostic.make_experiment(s.trajectory, parameters)
    plan = _plan(parameters) if s.plan.enabled else None
    start = parameters.at(machine.start) if machine.start else 0.0
    shape = scaled_shape(scenario_shape(parameters), start, _load(parameters))
    return Trajectory(
        shape, s.cycle_time, s.start_hold, s.start_ramp, s.start_phase, plan,
        _beside(parameters),
    )  # fmt: skip


def _beside(parameters: Parameters) -> Shape | None:
    """Return the shape of a coupled joint, if there is one: its gait, or its rest."""
    s, machine = parameters.scenario, parameters.declared
    if not machine.coupled:
        return None
    if s.trajectory not in COUPLED:
        told = " or ".join(COUPLED)
        raise OrthosisError(f"scenario.trajectory = {s.trajectory}: coupled joints move by {told}")
    gait = s.trajectory == "gait"
    return fourier_shape(s.beside.cosine, s.beside.sine) if gait else fourier_shape([s.beside.start], [0.0])


def _plan(parameters: Parameters) -> Planned:
    plan = parameters.scenario.plan
    change, mean = (
        settling_shape(
            fourier_shape(s.cosine, s.sine), fourier_shape(more.cosine, more.sine), plan.start.settling
        )
        if any(more.cosine) or any(more.sine)
        else fourier_shape(s.cosine, s.sine)
        for s, more in ((plan.angle, plan.start.angle), (plan.pressure, plan.start.pressure))
    )
    resting = parameters.control.position.mean_pressure
    loads = isinstance(parameters.declared.mechanism(parameters), Sole)
    unloaded = parameters.machine.mechanism.start if loads else None
    return Planned(change, scaled_shape(mean, resting, _load(parameters)), resting, plan.cycle_time, unloaded)


def _load(parameters: Parameters) -> float:
    """Return how many times the load of the scenario a machine that loads something is asked for."""
    mechanism = parameters.declared.mechanism(parameters)
    return mechanism.load if isinstance(mechanism, Sole) else 1.0
