# SPDX-License-Identifier: Apache-2.0
"""The emulated hardware: true parameters, integration, sensors. Only the plant node and tests use it."""

import math
from collections import namedtuple
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import lru_cache
from operator import itemgetter
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate
from pam_orthosis.model.assembly import Hardware, assemble, check_strokes
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.components import muscle
from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.delay import Line, computing_ns, line_ns
from pam_orthosis.model.machine import ActuatorOf, Machine
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.person.volition import Volition
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression
from pam_orthosis.model.truth import true_parameters

Array: TypeAlias = npt.NDArray[np.float64]

BISECTIONS = 60  # until the machine rests
STILL = 0.1  # rad/s^2 or m/s^2 that a machine at rest may have left
# what the truth holds of an actuator -> as what the equations know it
TRUTH = {
    "contraction": "contraction", "rate": "rate", "force": "tension", "pressure": "pressure", "flow": "flow",
}  # fmt: skip


def true_hardware(parameters: Parameters) -> Hardware:
    """Return what the emulated hardware of the parameters' machine is built from."""
    true, machine = true_parameters(parameters), parameters.declared
    actuators = {one.name: _true_actuator(one, true) for one in machine.actuators}
    tissue = dict(true.plant.person.tissue.items()) if machine.tissue else {}
    settings = Section("plant", dict(true.plant.effects.items()) | tissue)
    return Hardware(machine, machine.mechanism(true), true.valve, actuators, settings)


def _true_actuator(one: ActuatorOf, true: Parameters) -> Actuator:
    """Return an actuator of the hardware; muscles obey the braid's geometry, or the nominal model of them."""
    if one.kind != "muscle" or true.plant.muscle_law != "geometric":
        return one.built(true)
    known = true.flat()
    keys = ((f"plant.deviation.{one.name}_force", 1.0), (f"plant.mounting.{one.name}", 0.0))
    force, shortened = (true.at(key) if key in known else default for key, default in keys)
    return muscle.braid(true.at(one.parameters), force, shortened).times(one.parallel)


class Plant:
    """Emulated machine with sensors, advanced one control period at a time; `seed`: of their noise.

    Raises:
        OrthosisError: it cannot be held at its start with these parameters.
    """

    def __init__(self, parameters: Parameters, seed: int = 0, machine: Machine | None = None):
        machine = machine or parameters.declared
        self._p, self.machine = parameters, machine
        given, live = parameters.symbolic(machine.live)  # inputs: they may change on the way
        hardware = self._hardware(given)
        check_strokes(hardware)
        self.assembly = assembly = assemble(hardware)
        self.states, self.locked = assembly.states, hardware.mechanism.locked
        self._names = (*assembly.states, *machine.outputs)
        self.symbols = [assembly.x, ca.vertcat(assembly.u, live)]
        self.period_ns = round(parameters.scenario.control_period * 1e9)
        self._step_ns = round(parameters.plant.simulation.step * 1e9)
        self._computing_ns, line = self._delays_ns()
        # a voltage that comes late changes within one of the steps
        self._whole, _ = _divided(self.period_ns, self._step_ns, ())
        self.steps = len(self._whole) + ((self._computing_ns + line) % self.period_ns > 0)
        self._outputs = compiled(ca.Function("plant_outputs", self.symbols, [assembly.outputs]))
        self._noise = np.random.default_rng(seed)
        self._sensors = [*_sensors(machine, parameters)]
        self._measurement, self._truth, self._of_truth = _tuples(machine)
        closed, count = parameters.valve.closed_voltage, len(machine.actuators)
        self.lines = tuple(Line(closed, line) for _ in machine.actuators)
        self._volition = self._person()
        self.state, inputs_of_steps, self._lengths = self._memory()
        self.state[0] = parameters.at(machine.start) if machine.start else 0.0
        self._held = np.array([*[closed] * count, *self._external(0.0), 0.0, *self._live_values()])
        self._own = slice(count, len(machine.inputs))  # of the inputs, those beside the voltages
        self._inputs = inputs_of_steps.reshape(self.steps, -1)
        self._index = 0
        self._reported: dict[str, float] | None = None
        self.state[:] = self._start(hardware, self._acceleration())

    def measure(self) -> Any:
        """Return noisy, quantised sensor readings of the present state, with the names of the channels.

        It draws noise once a call.
        """
        y, drawn = self._report(), self._noise.standard_normal(len(self._sensors)).tolist()
        shown = zip(self._sensors, drawn, strict=True)
        if not math.isfinite(y[self._sensors[0][0]]):
            stiff = "a stiffness or damping (of stops: stop_stiffness, stop_damping) is too large"
            raise OrthosisError(
                f"the simulation of the {self.machine.name} diverges: {stiff} for its inertia"
            )
        return self._measurement(*(quantised(y[name] + noise * d, step) for (name, noise, step), d in shown))

    def truth(self) -> Any:
        """Return the true state, SI (for the recorder and for tests, never for a controller).

        Coordinate, velocity, effort from outside; then of all actuators contractions, rates, forces,
        pressures (absolute) and flows.
        """
        position, velocity, *others = self._of_truth(self._report())
        return self._truth(position, velocity, float(self._held[self._own.start]), *others)

    def advance(self, *voltages: float) -> None:
        """Let a control period pass; the voltages answer the sample at its start.

        They come when they have been computed, and act when they have gone through converter, valve and hose.

        Raises:
            OrthosisError: a voltage is not finite.
        """
        at_ns = self.time_ns + self._computing_ns
        for line, voltage in zip(range(len(self.lines)), voltages, strict=True):
            self.take(line, voltage, at_ns)
        self.live_on()

    def take(self, line: int, voltage: float, at_ns: int) -> None:
        """Take the voltage of a valve (its number) that comes at an instant; OrthosisError: not finite."""
        if not math.isfinite(voltage):
            raise OrthosisError(f"the {self.machine.name} was given a valve voltage that is not finite")
        self.lines[line].put(quantised(voltage, self._p.plant.voltage_resolution), at_ns)

    def live_on(self) -> None:
        """Integrate one control period with the voltages that act in it; a step begins where one changes."""
        begin_ns, coming = self.time_ns, self.coming()
        if coming <= {begin_ns}:
            self._held[: len(self.lines)] = [line.at(begin_ns) for line in self.lines]
            self._integrate(np.broadcast_to(self._held, self._inputs.shape), self._whole)
        else:
            inputs, lengths = self.inputs_of(coming)
            for first in range(0, len(lengths), self.steps):
                self._integrate(inputs[first : first + self.steps], lengths[first : first + self.steps])
        self.lived()

    def coming(self) -> set[int]:
        """Return the instants, ns, at which voltages change in the present period, which begins here."""
        begin_ns = self.time_ns
        self._held[self._own] = *self._external(begin_ns * 1e-9), begin_ns * 1e-9
        changes = (line.changes(begin_ns + self.period_ns) for line in self.lines)
        return {max(instant, begin_ns) for of_line in changes for instant in of_line}

    def inputs_of(self, coming: Collection[int]) -> tuple[Array, Array]:
        """Return the inputs of the steps of this period, one begins at each instant, and their lengths, s."""
        begin_ns, instants, count = self.time_ns, sorted(coming), len(self.lines)
        offsets = tuple(instant - begin_ns for instant in instants)
        lengths, places = _divided(self.period_ns, self._step_ns, offsets)
        inputs = np.empty((len(lengths), len(self._held)))
        inputs[:] = self._held
        for instant, place in zip(instants, places, strict=True):
            inputs[place:, :count] = [line.at(instant) for line in self.lines]
        self._held[:] = inputs[-1]
        return inputs, lengths

    def lived(self) -> None:
        """Note that the present period is over."""
        self._index += 1
        self._reported = None

    def retune(self, parameters: Parameters) -> None:
        """Take other values of what may change on the way, from the next period on."""
        self._p = parameters
        self._volition = self._person()
        self._held[self._own.stop :] = self._live_values()
        self._reported = None

    def intend(self, aim: Callable[[float], tuple[float, float, float]]) -> None:
        """Let the person, if one acts, intend the motion that `aim` returns for a time, s."""
        if self._volition:
            self._volition.aim = aim

    def signals(self) -> dict[str, float]:
        """Return states and outputs by name, free of noise (for the recorder, studies and tests)."""
        return dict(self._report())

    @property
    def time_ns(self) -> int:
        """The present instant, ns since the start."""
        return int(self._index * self.period_ns)

    def _memory(self) -> tuple[Array, Array, Array]:
        """Return where state, inputs and lengths of the steps are; prepare their integration."""
        rates = ca.Function("plant_rates", self.symbols, ca.cse([self.assembly.rates, self.assembly.outputs]))
        self._advance = compiled(integrate.steps_map("plant_steps", rates, self.steps))
        state, inputs, lengths = self._advance.inputs
        return state, inputs, lengths

    def _acceleration(self) -> ca.Function:
        """Return (state, inputs) -> acceleration, for the search of rest."""
        return ca.Function("acceleration", self.symbols, [self.assembly.rates[1]])

    def _hardware(self, parameters: Parameters) -> Hardware:
        return true_hardware(parameters)

    def _delays_ns(self) -> tuple[int, int]:
        """Return how long a voltage is computed and how long it is on its way, ns."""
        return computing_ns(self._p), line_ns(self._p)

    def _external(self, time: float) -> Sequence[float]:
        """Return what acts on the mechanism from outside at a time, s."""
        shaken = external_torque(self._p, time, math.sin)
        if self._volition is None:
            return (shaken,)
        return (shaken + self._volition.effort(time, float(self.state[0]), float(self.state[1])),)

    def _person(self) -> Volition | None:
        """Return the person who acts on the machine, if there is one."""
        if not self._p.plant.person.volition.enabled:
            return None
        return Volition(self._p, self.machine.mechanism(true_parameters(self._p)))

    def _live_values(self) -> list[float]:
        return [self._p.at(key) for key in self.machine.live]

    def _integrate(self, inputs: Array, lengths: Array) -> None:
        """Take at most as many steps as are compiled, each of its length, s, and under its inputs."""
        self._inputs[: len(inputs)] = inputs
        self._lengths[:] = 0.0
        self._lengths[: len(lengths)] = lengths
        self._advance.evaluate()
        self.state[:] = self._advance.outputs[0]

    def _report(self) -> dict[str, float]:
        """Return states and outputs by name at the present step, evaluated once a step."""
        if self._reported is None:
            values = self.state.tolist() + self._outputs(self.state, self._held)[0].tolist()
            self._reported = dict(zip(self._names, values, strict=True))
        return self._reported

    def _start(self, hardware: Hardware, accelerate: ca.Function) -> Array:
        """Return the state at rest at the start, valves closed, pressures near their mean."""
        start = self._p.at(self.machine.start)
        mean = self._p.control.position.mean_pressure
        x = np.zeros(len(self.states))
        x[0], x[2 : 2 + len(self.lines)] = start, mean
        if self.locked:
            return x
        q = ca.SX.sym("q")
        pulls = ca.jacobian(ca.vertcat(*hardware.mechanism.contractions(q)), q)
        signs = np.sign(ca.Function("pulls", [q], [pulls])(start).full()).ravel()
        ambient, supply = self._p.valve.ambient_pressure, self._p.valve.supply_pressure
        low, high = ambient - mean, supply - mean  # what moves it up is added where an actuator does so
        for _ in range(BISECTIONS):
            shift = 0.5 * (low + high)
            x[2 : 2 + len(signs)] = np.clip(mean + signs * shift, ambient, supply)
            low, high = (shift, high) if float(accelerate(x, self._held)) < 0 else (low, shift)
        if not abs(float(accelerate(x, self._held))) <= STILL:
            place = f"{self.machine.start} = {start} {self.machine.coordinate.unit}"
            raise OrthosisError(
                f"the actuators cannot hold the {self.machine.name} at {place}: choose another"
                f" {self.machine.coordinate.name}, a lighter person or load, or a higher supply pressure"
            )
        return x


@lru_cache(maxsize=64)
def _divided(period_ns: int, step_ns: int, offsets: tuple[int, ...]) -> tuple[Array, list[int]]:
    """Return the lengths of a period's steps, s, of which one begins at each offset, and their places."""
    starts = np.union1d(np.arange(0, period_ns, step_ns), offsets)
    return np.diff(starts, append=period_ns) / 1e9, np.searchsorted(starts, offsets).tolist()


def _sensors(machine: Machine, parameters: Parameters) -> Iterator[tuple[str, float, float]]:
    """Yield the output that each sensor shows, its noise and its step, as the machine's channels."""
    first, *pressures = (f"measured_{channel}" for channel in machine.channels)
    noise, step = (parameters.at(f"{machine.sensor}_{end}") for end in ("noise", "resolution"))
    yield first, noise, step
    shared = parameters.plant.sensor
    yield from ((name, shared.pressure_noise, shared.pressure_resolution) for name in pressures)


def _tuples(machine: Machine) -> tuple[Any, Any, Callable[[dict[str, float]], tuple[float, ...]]]:
    """Return the types of a measurement and of the truth, and what takes the latter out of a report."""
    named: Any = namedtuple  # a type checker cannot know these names
    shown, known = (
        [f"{name}_{kind}" for kind in told for name in machine.names] for told in (TRUTH, TRUTH.values())
    )
    own = machine.coordinate.name, "velocity"
    truth = named("Truth", (*own, machine.coordinate.effort, *shown))
    return named("Measurement", machine.channels), truth, itemgetter(*own, *known)


def external_torque(
    parameters: Parameters, time: Expression, sine: Callable[[Any], Any] = ca.sin
) -> Expression:
    """Return the torque that shakes the load at a time, N m."""
    plant = parameters.plant
    return plant.external_torque * sine(2 * math.pi * plant.external_frequency * time)


def quantised(value: float, resolution: float) -> float:
    """Return the value on the grid of a sensor or converter; resolution 0 means none."""
    return float(round(value / resolution) * resolution) if resolution > 0 else float(value)
