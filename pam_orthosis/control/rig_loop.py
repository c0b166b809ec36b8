# SPDX-License-Identifier: Apache-2.0
"""The procedures of sections 2.4 and 2.5 on the emulated rig, without ROS.

The controllers and the procedures get measurements only; truth is passed on for the recorder.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.linearisation import (
    CarriageController,
    CarriageEstimate,
    CarriageReference,
    slack_pressure,
)
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.machines import RIG
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rig import Cylinder, RigMeasurement, RigPlant

PATIENCE = 20.0  # s until a pressure has to be set and a ramp has to end
DIAGNOSTIC_START = 0.01  # m: the polynomials end at no contraction, and the carriage overshoots
DIAGNOSTIC_PRESSURES = (3.0e5, 3.8e5, 4.6e5)  # Pa absolute, one a run
DIAGNOSTIC_STEP = 1.5e5  # Pa, to the second pressure of a run
DIAGNOSTIC_PLACES = (0.7, 0.2, 0.9, 0.4)  # of the stroke


class RigSample(NamedTuple):
    """All that one step of the rig yields; `cylinder` only where a calliper was put on."""

    time_ns: int
    measured: RigMeasurement
    reference: CarriageReference
    pressure_reference: float
    estimate: CarriageEstimate
    flows: tuple[float, float]
    voltages: tuple[float, float]
    truth: Any  # as `Plant.truth`
    cylinder: Cylinder | None = None
    force_rate: float = 0.0  # what the control took for the derivative of the specimen's force, N/s


class Ramp:
    """A ramp with round corners: a stepwise speed behind three equal low-pass filters.

    Three times differentiable, and it can be stopped at any time: `stopping_distance` says how far
    it will still go.
    """

    def __init__(self, corner: float, period: float, position: float):
        c = corner
        a = np.array([[0, 1, 0], [0, 0, 1], [-(c**3), -3 * c**2, -3 * c]])
        whole = np.zeros((5, 5))  # position; speed and its two derivatives; commanded speed
        whole[0, 1], whole[1:4, 1:4], whole[3, 4] = 1, a, c**3
        self._transition = linalg.expm(whole * period)
        self._remaining = -linalg.inv(a)[0]
        self._state = np.array([position, 0.0, 0.0, 0.0, 0.0])

    def step(self, speed: float) -> CarriageReference:
        """Advance one period towards a speed, m/s; returns the reference of the new instant."""
        self._state[4] = speed
        self._state = self._transition @ self._state
        return self.reference

    @property
    def reference(self) -> CarriageReference:
        """The reference of this instant."""
        return CarriageReference(*self._state[:4].tolist())

    @property
    def stopping_distance(self) -> float:
        """Distance until rest if the speed is set to zero now, m."""
        return float(self._remaining @ self._state[1:4])


class PressureHolder:
    """PI control of the investigated muscle's pressure; its output is a mass flow."""

    def __init__(self, parameters: Parameters, specimen: str):
        nominal = parameters.rig_nominal()
        settings, m = nominal.rig.pressure, getattr(nominal.muscle, specimen)
        # Eq. (6) at the nominal length: one gain for all pressures and contractions
        volume = m.volume.v[0] * m.length / m.map_length + nominal.valve.hose.volume
        per_pressure = volume / (
            nominal.valve.polytropic_exponent * pneumatics.GAS_CONSTANT * nominal.valve.temperature
        )
        self._gain = settings.gain * per_pressure
        self._integral_gain = self._gain * settings.integral * nominal.rig.control_period
        self._limit = 0.2 * self._gain * nominal.valve.ambient_pressure
        self._integral = 0.0

    def step(self, pressure: float, reference: float) -> float:
        """Return the mass flow into the muscle, kg/s (absolute Pa)."""
        error = reference - pressure
        wanted: float = self._integral + self._integral_gain * error
        self._integral = min(max(wanted, -self._limit), self._limit)
        flow: float = self._gain * error + self._integral
        return flow


class _Bench:
    """The emulated rig, what holds the investigated muscle's pressure, and a clock."""

    def __init__(self, parameters: Parameters, specimen: str, plant: RigPlant):
        self.rig, self.plant = parameters.rig, plant
        self._holder = PressureHolder(parameters, specimen)
        self._index = 0

    def _time_ns(self) -> int:
        """Return the stamp of a control period, and count it."""
        stamp: int = self._index * self.plant.period_ns
        self._index += 1
        return stamp

    def _steps(self, duration: float) -> int:
        steps: int = round(duration / self.rig.control_period)
        return steps


class Rig(_Bench):
    """The emulated rig with its controllers in closed loop; the carriage starts at `position`, m."""

    def __init__(
        self,
        parameters: Parameters,
        specimen: str,
        seed: int = 0,
        position: float = 0.0,
        plant: RigPlant | None = None,
    ):
        parameters = RIG.taken(parameters)
        taut = float(slack_pressure(position, parameters.rig_nominal()))
        super().__init__(parameters, specimen, plant or RigPlant(parameters, specimen, seed, position, taut))
        self.readings: int = getattr(self.rig.volume_readings, specimen)
        self._speed = self.rig.procedure.speed * getattr(parameters.muscle, specimen).length
        self._carriage = CarriageController(parameters)
        self._valves = [InverseValveModel(parameters, parameters.declared.names[0]) for _ in range(2)]
        self._ramp = Ramp(self.rig.reference.corner, self.rig.control_period, position)
        self._force = 0.0
        self._pressure = parameters.valve.ambient_pressure

    def step(self, pressure_reference: float, speed: float, calliper: bool = False) -> RigSample:
        """Advance one period with a pressure for the specimen (absolute Pa) and a ramp speed (m/s)."""
        measured, truth, reference = self.plant.measure(), self.plant.truth(), self._ramp.reference
        cylinder = self.plant.calliper() if calliper else None
        specimen_flow = self._holder.step(measured.specimen_pressure, pressure_reference)
        flow, estimate = self._carriage.step(
            measured.position, measured.positioner_pressure, measured.force, reference
        )
        flows = specimen_flow, flow
        first, second = (v.step(f, p) for v, f, p in zip(self._valves, flows, measured[1:3], strict=True))
        self.plant.advance(first, second)
        self._ramp.step(speed)
        force_filter_time = 0.02  # s, of the load cell where the release watches for 'no force'
        self._force += self.rig.control_period / force_filter_time * (measured.force - self._force)
        return RigSample(
            self._time_ns(), measured, reference, pressure_reference, estimate, flows, (first, second), truth,
            cylinder, self._carriage.force_rate,
        )  # fmt: skip

    def rest(self, pressure: float, duration: float) -> Iterator[RigSample]:
        """Hold pressure and position."""
        for _ in range(self._steps(duration)):
            yield self.step(pressure, 0.0)

    def set_pressure(self, pressure: float) -> Iterator[RigSample]:
        """Bring the specimen to a pressure, absolute Pa, gently, then rest; RunFailed if that fails."""
        slew = 2.0e5 * self.rig.control_period  # Pa, a control period
        pressure_tolerance = 3.0e3  # Pa within which a pressure counts as set
        for _ in range(self._steps(PATIENCE)):
            self._pressure += min(max(pressure - self._pressure, -slew), slew)
            sample = self.step(self._pressure, 0.0)
            yield sample
            if abs(sample.measured.specimen_pressure - pressure) < pressure_tolerance:
                break
        else:
            raise RunFailed(f"the rig's investigated muscle did not reach {pressure:g} Pa in {PATIENCE:g} s")
        yield from self.rest(pressure, self.rig.procedure.rest)

    def ramp_to(
        self, pressure: float, position: float, share: float = 1.0, rest: float | None = None
    ) -> Iterator[RigSample]:
        """Move the carriage to a position at a share of the procedure's speed, then rest (s)."""
        sign = math.copysign(1.0, position - self._ramp.reference.position)
        while sign * (position - self._ramp.reference.position) > sign * self._ramp.stopping_distance:
            yield self.step(pressure, sign * share * self._speed)
        yield from self.rest(pressure, self.rig.procedure.rest if rest is None else rest)

    def release(self, pressure: float) -> Iterator[RigSample]:
        """Let the specimen contract until no force is measured, then rest; RunFailed if one remains."""
        settings = self.rig.procedure
        cautious_force = 100.0  # N above 'no force' at which a release slows down
        creep = 0.05  # share of the procedure's speed that remains
        for _ in range(self._steps(PATIENCE)):
            share = (self._force - settings.free_force) / cautious_force
            yield self.step(pressure, self._speed * min(max(share, creep), 1.0))
            if share < 0:
                break
        else:
            raise RunFailed(f"the force at {pressure:g} Pa did not vanish in {PATIENCE:g} s of release")
        yield from self.rest(pressure, self.rig.procedure.rest)

    @property
    def reference_position(self) -> float:
        """Where the carriage is asked to be, m."""
        return self._ramp.reference.position


def force_procedure(rig: Rig, pressure: float) -> Iterator[RigSample]:
    """Run the procedure of section 2.5 at one pressure (absolute Pa).

    Starting at zero contraction: set the pressure, release to the force-free contraction, pull to
    zero contraction, and go back to the force-free contraction.
    """
    yield from rig.set_pressure(pressure)
    yield from rig.release(pressure)
    free = rig.reference_position
    yield from rig.ramp_to(pressure, 0.0)
    yield from rig.ramp_to(pressure, free)


def volume_procedure(rig: Rig, pressure: float) -> Iterator[RigSample]:
    """Measure the cylinder of section 2.3 at stations between the force-free and zero contraction.

    Each station is read as often as `rig.volume_readings` says: the calliper errs by as much on a thin muscle
    as on a thick one.
    """
    yield from rig.set_pressure(pressure)
    yield from rig.release(pressure)
    stations = np.linspace(rig.reference_position, 0.0, rig.rig.procedure.volume_stations)
    for station in stations.tolist():
        yield from rig.ramp_to(pressure, station)
        for _ in range(rig.readings):
            yield rig.step(pressure, 0.0, calliper=True)


def diagnostic_procedure(
    rig: Rig, pressures: Sequence[float], places: Sequence[float]
) -> Iterator[RigSample]:
    """Move the carriage at several pressures (absolute Pa), slowly, fast, and back and forth by little.

    The runs that show friction of the carriage, hysteresis and damping of the muscles, and errors of the
    force maps apart; to be recorded at every control period. `places` are visited at each pressure,
    as shares of the stroke.
    """
    stroke = 0.04  # m, within which all pressures from 3 bar on keep both muscles taut
    speeds = (1.0, 2.5, 0.4, 1.5)  # of the procedure's
    reversals = (2.0e-3, -1.0e-3, 5.0e-3, 0.0)  # m
    rest = 0.2  # s
    for pressure in pressures:
        yield from rig.set_pressure(pressure)
        for number, place in enumerate(places):
            share = speeds[number % len(speeds)]
            yield from rig.ramp_to(pressure, place * stroke, share, rest)
        here = rig.reference_position
        for offset in reversals:
            yield from rig.ramp_to(pressure, here + offset, 0.5, rest)


class DecayRig(_Bench):
    """The rig prepared for the free decay of section 2.4: a weight in place of the MAS-40."""

    def __init__(self, parameters: Parameters, specimen: str, seed: int = 0):
        parameters = RIG.taken(parameters)
        self._settings = getattr(parameters.rig.decay, specimen)
        plant = RigPlant(parameters, specimen, seed, weight=self._settings.weight)
        super().__init__(parameters, specimen, plant)
        self._valve = InverseValveModel(parameters, parameters.declared.names[0])
        self._closed = parameters.valve.closed_voltage
        self._ambient = parameters.valve.ambient_pressure

    def run(self, pressure: float) -> Iterator[RigSample]:
        """Set the pressure, close the valve, pull the carriage from its rest and let it go.

        Yields the time from the release on. The valve is closed because a pressure control that
        lags behind the oscillation feeds or damps it: the enclosed gas is a spring without loss.
        """
        rest_time = 4.0  # s in which the weight comes to rest
        resting = self._steps(rest_time)
        for index in range(resting):
            rising = self._ambient + (pressure - self._ambient) * min(1.0, 2.0 * index / resting)
            self._step(pressure, rising, hand=0.0)
        for _ in range(resting):
            rest = self._step(pressure, pressure).measured.position
        pulled = rest - self._settings.pull
        pull_time = 0.5  # s in which the hand pulls
        for share in np.linspace(0.0, 1.0, self._steps(pull_time)).tolist():
            self._step(pressure, None, rest + share * (pulled - rest))
        self._index = 0
        yield from (self._step(pressure, None) for _ in range(self._steps(self.rig.decay.duration)))

    def _step(self, pressure: float, wanted: float | None, hand: float | None = None) -> RigSample:
        """Advance one period; `wanted` None: the valve is closed."""
        measured, truth = self.plant.measure(), self.plant.truth()
        flow, voltage = 0.0, self._closed
        if wanted is not None:
            flow = self._holder.step(measured.specimen_pressure, wanted)
            voltage = self._valve.step(flow, measured.specimen_pressure)
        voltages = voltage, self._closed
        self.plant.advance(*voltages, hand=hand)
        still = CarriageReference(measured.position, 0.0, 0.0, 0.0)
        estimate = CarriageEstimate(*still[:3])
        return RigSample(self._time_ns(), measured, still, pressure, estimate, (flow, 0.0), voltages, truth)
