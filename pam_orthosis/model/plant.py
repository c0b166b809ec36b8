# SPDX-License-Identifier: Apache-2.0
"""The emulated hardware: true parameters, integration, sensors. Only the plant node and tests use it."""

from __future__ import annotations

import math
from typing import NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate, orthosis
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.delay import Line, computing_ns, line_ns
from pam_orthosis.model.deviations import DEVIATIONS

BISECTIONS = 60  # until the knee rests
STILL = 0.1  # rad/s^2 that a knee at rest may have left
SAME_FACTOR = 1e-4  # relative difference of two factors that are written with six digits


class Measurement(NamedTuple):
    """One sample of the sensors: knee angle rad, absolute pressures Pa."""

    angle: float
    extensor_pressure: float
    flexor_pressure: float


class Truth(NamedTuple):
    """The true state: rad, rad/s, N m (external torque on the knee), m, m/s, N, Pa, kg/s."""

    angle: float
    velocity: float
    torque: float
    extensor_contraction: float
    flexor_contraction: float
    extensor_rate: float
    flexor_rate: float
    extensor_force: float
    flexor_force: float
    extensor_pressure: float
    flexor_pressure: float
    extensor_flow: float
    flexor_flow: float


def true_parameters(parameters):
    """Return the parameters of the emulated hardware: the belief times its deviations."""
    values = parameters.flat()
    true = {}
    for name, keys in DEVIATIONS.items():
        for key in keys:
            true[key] = values[key] * values[f"plant.deviation.{name}"]
    return parameters.substituted(true)


def with_belief(parameters, changes):
    """Return the tree with another belief about the same emulated hardware: deviations make up for it.

    Args:
        changes: dotted key -> value, of the belief.

    Raises:
        OrthosisError: unusable values, or a belief so far from the hardware that no deviation reaches it.
    """
    before, after = parameters.flat(), parameters.changed(changes).flat()
    deviations = {}
    for name, keys in DEVIATIONS.items():
        if gone := [key for key in keys if before[key] and not after[key]]:
            raise OrthosisError(f"{gone[0]} = 0: no deviation leads from nothing to the hardware's")
        ratios = [before[key] / after[key] for key in keys if after[key]] or [1.0]
        if max(ratios) - min(ratios) > SAME_FACTOR * max(ratios):
            raise OrthosisError(f"{', '.join(keys)} deviate together: change them by one factor")
        if max(ratios) != 1.0:
            deviations[f"plant.deviation.{name}"] = before[f"plant.deviation.{name}"] * max(ratios)
    return parameters.changed({**changes, **deviations})


def true_hardware(parameters) -> orthosis.Hardware:
    """Return what the emulated hardware is built from."""
    true = true_parameters(parameters)
    m, plant = true.muscle.dmsp_20, true.plant
    if plant.muscle_law == "geometric":
        laws = {
            name: orthosis.geometric_law(
                m,
                getattr(plant.deviation, f"{name}_force"),
                getattr(plant.mounting, name),
            )
            for name in orthosis.MUSCLES
        }
    else:
        laws = dict.fromkeys(orthosis.MUSCLES, orthosis.polynomial_law(m))
    return orthosis.Hardware(true.leg, m, true.valve, laws, plant.effects)


class Plant:
    """Emulated orthosis with sensors, advanced one control period at a time.

    Args:
        parameters: the whole tree, truth included.
        seed: of the sensor noise.

    Raises:
        OrthosisError: the knee cannot be held at its starting angle with these parameters.
    """

    def __init__(self, parameters, seed: int = 0):
        self._p = parameters
        mass = ca.SX.sym("person_mass")  # an input: the person may change on the way
        assembly = orthosis.assemble(true_hardware(parameters.substituted({"leg.person.mass": mass})))
        self.states = assembly.states
        inputs = [assembly.x, ca.vertcat(assembly.u, mass)]
        right_hand_side = ca.Function("plant_rates", inputs, ca.cse([assembly.rates, assembly.outputs]))
        self.period_ns = round(parameters.scenario.control_period * 1e9)
        self._grid = np.arange(0, self.period_ns, round(parameters.plant.simulation.step * 1e9))
        self._steps = len(self._grid) + 1  # a voltage changes within one of them
        self._advance = compiled(integrate.steps_map("plant_steps", right_hand_side, self._steps))
        self._outputs = compiled(ca.Function("plant_outputs", inputs, [assembly.outputs]))
        self._noise = np.random.default_rng(seed)
        closed = parameters.valve.closed_voltage
        self._held = np.array([closed, closed, 0.0, 0.0, parameters.leg.person.mass])
        self.state, inputs_of_steps, self._lengths = self._advance.inputs
        self._inputs = inputs_of_steps.reshape(self._steps, -1)
        self._computing_ns = computing_ns(parameters)
        self.lines = tuple(Line(closed, line_ns(parameters)) for _ in orthosis.MUSCLES)
        self._index = 0
        self._reported: dict[str, float] | None = None
        self.state[:] = self._resting_state(ca.Function("acceleration", inputs, [assembly.rates[1]]))

    def retune(self, parameters) -> None:
        """Put a person of another mass into the orthosis, from the next period on."""
        self._p = parameters
        self._held[4] = parameters.leg.person.mass
        self._reported = None

    def measure(self) -> Measurement:
        """Return noisy, quantised sensor readings of the present state; draws noise once a call."""
        sensor, noise, y = self._p.plant.sensor, self._noise.standard_normal(3).tolist(), self._report()
        angle = y["measured_angle"] + sensor.angle_noise * noise[0]
        pressures = [
            y[f"measured_{muscle}_pressure"] + sensor.pressure_noise * noise[index]
            for index, muscle in enumerate(orthosis.MUSCLES, start=1)
        ]
        return Measurement(
            quantised(angle, sensor.angle_resolution),
            *(quantised(pressure, sensor.pressure_resolution) for pressure in pressures),
        )

    def advance(self, extensor_voltage: float, flexor_voltage: float) -> None:
        """Let a control period pass; the voltages answer the sample at its start.

        They come when they have been computed, and act when they have gone through converter, valve and hose.

        Raises:
            OrthosisError: a voltage is not finite.
        """
        at_ns = self.time_ns + self._computing_ns
        for line, voltage in enumerate((extensor_voltage, flexor_voltage)):
            self.take(line, voltage, at_ns)
        self.live_on()

    def take(self, line: int, voltage: float, at_ns: int) -> None:
        """Take a voltage of the extensor's (0) or flexor's (1) valve that comes at an instant of the plant.

        Raises:
            OrthosisError: a voltage is not finite.
        """
        if not math.isfinite(voltage):
            raise OrthosisError("the plant was given a valve voltage that is not finite")
        self.lines[line].put(quantised(voltage, self._p.plant.voltage_resolution), at_ns)

    def live_on(self) -> None:
        """Integrate one control period with the voltages that act in it; a step begins where one changes."""
        begin_ns = self.time_ns
        end_ns = begin_ns + self.period_ns
        self._held[2:4] = self._external_torque(), begin_ns * 1e-9
        coming = {max(instant, begin_ns) for line in self.lines for instant in line.changes(end_ns)}
        starts = np.union1d(self._grid, [instant - begin_ns for instant in coming])
        inputs = np.tile(self._held, (len(starts), 1))
        for instant in sorted(coming):
            inputs[np.searchsorted(starts, instant - begin_ns) :, :2] = self._acting(instant)
        lengths = np.diff(starts, append=self.period_ns) / 1e9
        for first in range(0, len(starts), self._steps):
            self._integrate(inputs[first : first + self._steps], lengths[first : first + self._steps])
        self._held[:] = inputs[-1]
        self._index += 1
        self._reported = None

    def _integrate(self, inputs: np.ndarray, lengths: np.ndarray) -> None:
        """Take at most as many steps as are compiled, each of its length, s, and under its inputs."""
        self._inputs[: len(inputs)] = inputs
        self._lengths[:] = 0.0
        self._lengths[: len(lengths)] = lengths
        self._advance.evaluate()
        self.state[:] = self._advance.outputs[0]

    def truth(self) -> Truth:
        """Return the true state (for the recorder and for tests, never for a controller)."""
        y = self._report()
        q, velocity, pe, pf = self.state[:4].tolist()
        return Truth(
            q, velocity, float(self._held[2]),
            y["extensor_contraction"], y["flexor_contraction"], y["extensor_rate"], y["flexor_rate"],
            y["extensor_tension"], y["flexor_tension"], pe, pf, y["extensor_flow"], y["flexor_flow"],
        )  # fmt: skip

    def signals(self) -> dict[str, float]:
        """Return the states and `orthosis.OUTPUTS` by name, free of noise (for studies and tests)."""
        return dict(zip(self.states, self.state.tolist(), strict=True)) | self._report()

    def _report(self) -> dict[str, float]:
        """Return the model's outputs by name at the present step, evaluated once a step."""
        if self._reported is None:
            values = self._outputs(self.state, self._held)[0].tolist()
            self._reported = dict(zip(orthosis.OUTPUTS, values, strict=True))
        return self._reported

    def _acting(self, instant_ns: int) -> list[float]:
        return [line.at(instant_ns) for line in self.lines]

    def _external_torque(self) -> float:
        return external_torque(self._p, self.time_ns * 1e-9, math.sin)

    @property
    def time_ns(self) -> int:
        """The present instant, ns since the start."""
        return self._index * self.period_ns

    def _resting_state(self, accelerate: ca.Function) -> np.ndarray:
        """Return the state at rest at the starting angle, valves closed, muscles near the mean pressure."""
        start = self._p.scenario.start_angle
        mean = self._p.control.position.mean_pressure
        x = np.zeros(len(self.states))
        x[:4] = start, 0.0, mean, mean
        if self._p.leg.joint.locked:
            return x
        ambient, supply = self._p.valve.ambient_pressure, self._p.valve.supply_pressure
        low, high = ambient - mean, supply - mean  # shift of the flexor up, of the extensor down
        for _ in range(BISECTIONS):
            shift = 0.5 * (low + high)
            x[2] = min(max(mean - shift, ambient), supply)
            x[3] = min(max(mean + shift, ambient), supply)
            low, high = (shift, high) if float(accelerate(x, self._held)) < 0 else (low, shift)
        if not abs(float(accelerate(x, self._held))) <= STILL:
            raise OrthosisError(
                f"the muscles cannot hold the knee at scenario.start_angle = {start} rad:"
                " choose another angle, a lighter person or a higher supply pressure"
            )
        return x


def external_torque(parameters, time, sine=ca.sin):
    """Return the torque that shakes the knee at a time, N m."""
    plant = parameters.plant
    return plant.external_torque * sine(2 * math.pi * plant.external_frequency * time)


def quantised(value: float, resolution: float) -> float:
    """Return the value on the grid of a sensor or converter; resolution 0 means none."""
    return float(round(value / resolution) * resolution) if resolution > 0 else float(value)
