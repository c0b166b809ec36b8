# SPDX-License-Identifier: Apache-2.0
"""The hidden plant: what `model.plant.Plant` is to the controllers, built from `physics` alone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from pam_orthosis.model.parameters import Parameters, Section
from pam_orthosis.testing import physics
from pam_orthosis.testing.quantities import Apparatus, Hidden, maps, muscle_and_valve

ANGLE_NOISE, ANGLE_RESOLUTION = 3.5e-4, 3.8349519697141030e-4  # rad
PRESSURE_NOISE, PRESSURE_RESOLUTION = 500.0, 244.0  # Pa
VOLTAGE_RESOLUTION = 10.0 / 65536
GRAVITY = 9.81
TABLE_START, TABLE_STEP, TABLE_SIZE = -0.3, 5.0e-4, 4401
NO_DEVIATION: Mapping[str, float] = {}


class Measurement(NamedTuple):
    """One sample of the sensors, in the order of the closed loop: knee angle rad, absolute pressures Pa."""

    angle: float
    extensor_pressure: float
    flexor_pressure: float


class Truth(NamedTuple):
    """What the closed loop records of the true state: rad, rad/s; the external torque is not known here."""

    angle: float
    velocity: float
    torque: float = float("nan")


class HiddenPlant:
    """Emulated hardware for blind tests, advanced one control period at a time.

    Args:
        parameters: the nominal model; what the plant is without deviations, misfits and hidden effects.
        hidden: sizes of the hidden effects.
        deviations: of the nuisance parameters, keys as in `gap.tolerance`.
        misfits: arrays of `Maps` that differ from none (force_waves, valve_waves, volume_waves, torque).
        seed: of the sensor noise.
    """

    def __init__(
        self,
        parameters: Parameters,
        hidden: Hidden = Hidden(),  # noqa: B008 immutable
        deviations: Mapping[str, float] = NO_DEVIATION,
        misfits: Mapping[str, np.ndarray] = NO_DEVIATION,
        seed: int = 0,
    ):
        period = parameters.scenario.control_period
        self.period_ns = round(period * 1e9)
        self._steps = round(period / physics.STEP)
        self._a = apparatus(parameters, deviations)
        self._h = hidden
        table = leg_table(parameters.leg, 1 + deviations.get("moving_mass", 0.0))
        self._maps = maps(parameters.muscle.dmsp_20, leg=table, **misfits)
        self._offsets = [deviations.get(f"{name}_offset", 0.0) for name in Measurement._fields]
        self._noise = np.random.default_rng(seed)
        self._closed = parameters.valve.closed_voltage
        self._index = 0
        self._volts = (
            deviations.get("extensor_closed_voltage", 0.0),
            deviations.get("flexor_closed_voltage", 0.0),
        )
        self._start(parameters)

    def measure(self) -> Measurement:
        """Return noisy, quantised sensor readings; draws noise once a call."""
        true, noise = self._sense(), self._noise.standard_normal(3)
        spread = (ANGLE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE)
        steps = (ANGLE_RESOLUTION, PRESSURE_RESOLUTION, PRESSURE_RESOLUTION)
        values = (x + o + s * n for x, o, s, n in zip(true, self._offsets, spread, noise, strict=True))
        return Measurement(*(round(v / step) * step for v, step in zip(values, steps, strict=True)))

    def advance(self, extensor_voltage: float, flexor_voltage: float) -> None:
        """Integrate one control period with the voltages held."""
        self._held = self._above_closed(extensor_voltage, flexor_voltage)
        self._index = physics.advance(
            self.x, self._wheel, self._spools, self._anchors, self._ring, self._index, self._steps,
            *self._held, self._a, self._h, self._maps,
        )  # fmt: skip

    def truth(self) -> Truth:
        """Return the true angle and velocity."""
        return Truth(*self.x[:2].tolist())

    def _sense(self) -> tuple[float, float, float]:
        return physics.sense(
            self.x, self._wheel, self._anchors, self._ring, self._index, *self._held,
            self._a, self._h, self._maps,
        )  # fmt: skip

    def _above_closed(self, *voltages: float) -> tuple[float, ...]:
        exact = (min(max(v - self._closed, -self._a.half_span), self._a.half_span) for v in voltages)
        quantised = (round(v / VOLTAGE_RESOLUTION) * VOLTAGE_RESOLUTION for v in exact)
        return tuple(v + shift for v, shift in zip(quantised, self._volts, strict=True))

    def _start(self, parameters: Parameters) -> None:
        """Find the state at rest with closed valves at the starting angle, pressures about the mean."""
        angle, mean = parameters.scenario.start_angle, parameters.control.position.mean_pressure
        self.x = np.zeros(physics.STATES)
        self.x[:4] = angle, 0.0, mean, mean
        self._held = (0.0, 0.0)
        self._wheel, self._spools = np.array([angle]), np.zeros(2)
        wound = self._a.radius * (angle - self._a.symmetric_angle)
        rest = self._a.symmetric_contraction
        self._anchors = np.outer([rest - wound, rest + wound], np.ones(physics.ELEMENTS))
        self._ring = np.zeros((6, physics.RING))
        low, high = -0.8 * mean, 0.8 * mean
        for _ in range(50 if self._a.locked == 0 else 0):
            shift = 0.5 * (low + high)
            self.x[physics.PE], self.x[physics.PF] = mean - shift, mean + shift
            low, high = (shift, high) if self._acceleration() < 0 else (low, shift)
        for row, state in ((physics.RING_Q, 0), (physics.RING_PE, 2), (physics.RING_PF, 3)):
            self._ring[row] = self.x[state]

    def _acceleration(self) -> float:
        out = np.zeros(physics.STATES)
        physics.rates(
            self.x, out, 0.0, 0.0, 0.0, 0.0, self._wheel[0], self._anchors, self._a, self._h, self._maps
        )
        return out[physics.W]


def apparatus(parameters: Parameters, deviations: Mapping[str, float]) -> Apparatus:
    """Return the true parameters: nominal values times one plus deviation."""
    leg, m, off = parameters.leg, parameters.muscle.dmsp_20, defaultdict(float, deviations)
    return Apparatus(
        **muscle_and_valve(m, parameters.valve, off),
        damping=m.force.damping * (1 + off["muscle_damping"]),
        extensor_force=1 + off["extensor_force"],
        flexor_force=1 + off["flexor_force"],
        supply=parameters.valve.supply_pressure * (1 + off["supply_pressure"]),
        radius=leg.cogwheel_diameter / 2,
        symmetric_angle=leg.symmetric_angle,
        symmetric_contraction=leg.symmetric_contraction,
        stop_low=leg.joint.minimum,
        stop_high=leg.joint.maximum,
        stop_stiffness=leg.joint.stop_stiffness,
        stop_damping=leg.joint.stop_damping,
        table_start=TABLE_START,
        table_step=TABLE_STEP,
        locked=float(leg.joint.locked),
    )


def leg_table(leg: Section, mass_factor: float) -> np.ndarray:
    """Return (6, n): inertia, its slope, gravity torque of the apparatus, then of 1 kg at the ankle."""
    q = TABLE_START + TABLE_STEP * np.arange(TABLE_SIZE)
    names = {"thigh": leg.thigh.mass, "knee": leg.knee_mass, "shank": leg.shank.mass, "ankle": leg.shoe_mass}
    apparatus = {name: mass_factor * mass for name, mass in names.items()}
    ankle = {**dict.fromkeys(names, 0.0), "ankle": 1.0}
    rows = [_inertia_and_gravity(q, leg, masses) for masses in (apparatus, ankle)]
    return np.array([row for m, g in rows for row in (m, np.gradient(m, TABLE_STEP), g)])


def _inertia_and_gravity(
    q: np.ndarray, leg: Section, mass: dict[str, float]
) -> tuple[np.ndarray, np.ndarray]:
    """Return inertia and gravity torque by q from velocities per unit of knee speed (planar linkage)."""
    thigh, shank, k = leg.thigh.length, leg.shank.length, leg.configuration
    a = _hip(q, thigh, shank, k, leg.bearing_height)
    s = a - k * q
    a1 = k * shank * np.cos(s) / (thigh * np.cos(a) + shank * np.cos(s))
    s1 = a1 - k
    knee = np.array([-np.sin(a), np.cos(a)]) * thigh * a1
    along = np.array([-np.sin(s), np.cos(s)]) * shank * s1
    speeds = {"thigh": 0.5 * knee, "knee": knee, "shank": knee + 0.5 * along, "ankle": knee + along}
    inertia = sum(mass[name] * (v**2).sum(axis=0) for name, v in speeds.items())
    inertia = inertia + mass["thigh"] * (thigh**2 + leg.thigh.width**2) / 12 * a1**2
    inertia = inertia + mass["shank"] * (shank**2 + leg.shank.width**2) / 12 * s1**2
    return inertia, GRAVITY * sum(mass[name] * v[1] for name, v in speeds.items())


def _hip(q: np.ndarray, thigh: float, shank: float, k: int, height: float) -> np.ndarray:
    """Return the hip angle that puts the ankle on its bearing, by Newton's method."""
    a = 0.5 * k * q
    for _ in range(30):
        wrong = thigh * np.sin(a) + shank * np.sin(a - k * q) - height
        a = a - wrong / (thigh * np.cos(a) + shank * np.cos(a - k * q))
    return a
