# SPDX-License-Identifier: Apache-2.0
"""The test rig of the paper's fig. 2 as emulated hardware, Eqs. (1)-(2) and (6)-(8).

A carriage rolls between the investigated muscle (left) and a MAS-40 (right). Its position x_S counts
from the place where the investigated muscle is not contracted, positive where it contracts, so that
dL_M,d = x_S and dL_M,r = X_S - x_S, Eq. (2). Gas, valves and the effects of muscles and valves are
those of the knee: the investigated muscle takes the extensor's place, the MAS-40 the flexor's.

For the free decay of section 2.4 a weight over a pulley replaces the MAS-40, and a hand (a stiff
spring) pulls the carriage.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate, orthosis
from pam_orthosis.model import muscle as muscle_model
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import ActiveEffects, Effect
from pam_orthosis.model.effects.carriage_friction import RIG_EFFECTS
from pam_orthosis.model.leg import GRAVITY
from pam_orthosis.model.parameters import Section
from pam_orthosis.model.plant import quantised

BASE_STATES = ("position", "velocity", "extensor_pressure", "flexor_pressure")
INPUTS = ("extensor_voltage", "flexor_voltage", "weight", "hand_stiffness", "hand_position")
OUTPUTS = ("extensor_tension", "flexor_tension", "extensor_flow", "flexor_flow", "diameter", "length")
# of the knee's effects, those of muscles and valves act at the rig too
SHARED_EFFECTS = ("muscle_hysteresis", "valve_lag", "valve_dead_band")
HAND_STIFFNESS = 2.0e5  # N/m, of the hand that pulls the carriage
HAND_DAMPING_TIME = 5.0e-3  # s, its damping / stiffness


class RigMeasurement(NamedTuple):
    """One sample of the sensors: carriage position m, absolute pressures Pa, load cell N."""

    position: float
    specimen_pressure: float
    positioner_pressure: float
    force: float


class RigTruth(NamedTuple):
    """The true state: m, m/s, N (tensions), absolute Pa, kg/s."""

    position: float
    velocity: float
    specimen_force: float
    positioner_force: float
    specimen_pressure: float
    positioner_pressure: float
    specimen_flow: float
    positioner_flow: float


class Cylinder(NamedTuple):
    """What a calliper reads on the investigated muscle: diameter and length of its cylinder, m."""

    diameter: float
    length: float


def at_rig(parameters):
    """Return the parameters with supply and control period of the rig."""
    rig = parameters.rig
    return parameters.changed(
        {"valve.supply_pressure": rig.supply_pressure, "scenario.control_period": rig.control_period}
    )


def carriage_acceleration(left, right, mass):
    """Return x_S-double-dot of Eq. (1) for the forces to the left and to the right, m/s^2."""
    return (left - right) / mass


def positioner_contraction(position, parameters):
    """Return dL_M,r of Eq. (2), m."""
    return parameters.rig.position_offset - position


@dataclass(frozen=True)
class RigHardware:
    """What the rig's equations are built from.

    Attributes:
        rig, valve: sections of parameters.
        muscles: muscle -> its section of `config/muscle.yaml`.
        damping: muscle -> its damping factor D, N s/m.
        laws: muscle -> static force and volume.
        effects: settings of the effects of `catalogue`.
    """

    rig: object
    valve: object
    muscles: Mapping[str, object]
    damping: Mapping[str, object]
    laws: Mapping[str, orthosis.MuscleLaw]
    effects: object
    catalogue: Mapping[str, Effect]


def assemble(parameters, specimen: str) -> orthosis.Assembly:
    """Return the equations of the emulated rig, Eq. (7) with the gas of Eq. (6) and all its effects."""
    true = _true_valve(parameters)
    settings = {name: getattr(true.plant.effects, name) for name in SHARED_EFFECTS}
    settings |= dict(true.plant.rig.effects.items())
    types = {"extensor": specimen, "flexor": "mas_40"}
    muscles = {name: getattr(true.muscle, type_) for name, type_ in types.items()}
    own = {name: getattr(true.plant.rig, type_) for name, type_ in types.items()}
    hardware = RigHardware(
        rig=true.rig,
        valve=true.valve,
        muscles=muscles,
        damping={name: one.damping for name, one in own.items()},
        laws={name: orthosis.geometric_law(muscles[name], one.force) for name, one in own.items()},
        effects=Section("plant.rig.effects", settings),
        catalogue=CATALOGUE | RIG_EFFECTS,
    )
    return assembled(hardware)


def assembled(hardware: RigHardware) -> orthosis.Assembly:
    """Return the equations of a rig, Eq. (7) with the gas of Eq. (6) and the effects that are on."""
    effects = ActiveEffects(hardware.catalogue, hardware.effects)
    names = (*BASE_STATES, *effects.states)
    x, u = ca.SX.sym("x", len(names)), ca.SX.sym("u", len(INPUTS))
    effects.bind(ca.vertsplit(x)[len(BASE_STATES) :])
    s = _signals(x, u, hardware)
    orthosis.valves_to_forces(s, hardware.laws, effects)
    _tensions(s, hardware)
    _carriage_force(s)
    effects.stages(s, "torque")
    s.acceleration = carriage_acceleration(s.carriage_force, 0, hardware.rig.carriage_mass + s.weight)
    s.diameter, s.length, _ = muscle_model.cylinder(
        s.extensor_contraction, s.extensor_gauge, hardware.muscles["extensor"]
    )
    for name in orthosis.MUSCLES:
        pressure = getattr(s, f"{name}_pressure") + getattr(s, f"{name}_line_drop")
        setattr(s, f"measured_{name}_pressure", pressure)
    effects.stages(s, "sensor")
    rates = [s.velocity, s.acceleration, s.extensor_pressure_rate, s.flexor_pressure_rate]
    outputs = ca.vertcat(*(getattr(s, name) for name in OUTPUTS))
    return orthosis.Assembly(names, x, u, ca.vertcat(*rates, *effects.rates(s)), outputs, s)


class RigPlant:
    """Emulated rig with sensors, advanced one control period at a time.

    Args:
        parameters: the whole tree, truth included.
        specimen: the investigated muscle, one of `model.specimens.SPECIMENS`.
        seed: of the sensor noise.
        position: of the carriage at the start, m; the investigated muscle begins at ambient pressure.
        positioner_pressure: of the MAS-40 at the start, absolute Pa; None: ambient.
        weight: kg, hung on the carriage in place of the MAS-40 (0: the MAS-40 is hooked).
    """

    def __init__(
        self,
        parameters,
        specimen: str,
        seed: int = 0,
        position: float = 0.0,
        positioner_pressure: float | None = None,
        weight: float = 0.0,
    ):
        parameters = at_rig(parameters)
        self._plant = parameters.plant
        assembly = assemble(parameters, specimen)
        step, period = parameters.plant.simulation.step, parameters.scenario.control_period
        self.period_ns = round(period * 1e9)
        right_hand_side = assembly.function("rig_rates")
        self._advance = compiled(
            integrate.period_map("rig_period", right_hand_side, step, round(period / step))
        )
        self._outputs = compiled(ca.Function("rig_outputs", [assembly.x, assembly.u], [assembly.outputs]))
        self._noise = np.random.default_rng(seed)
        closed = parameters.valve.closed_voltage
        self._held = np.array([closed, closed, weight, 0.0, 0.0])
        self.states = assembly.states
        self.state = np.zeros(len(self.states))
        ambient = parameters.valve.ambient_pressure
        self.state[:4] = position, 0.0, ambient, positioner_pressure or ambient

    def measure(self) -> RigMeasurement:
        """Return noisy, quantised readings of the present state; draws noise once a call."""
        own, shared, noise = self._plant.rig.sensor, self._plant.sensor, self._noise.standard_normal(4)
        pressures = self.state[2:4] + shared.pressure_noise * noise[1:3]
        position = self.state[0] + own.position_noise * noise[0]
        return RigMeasurement(
            quantised(position, own.position_resolution),
            *(quantised(p, shared.pressure_resolution) for p in pressures.tolist()),
            self._load_cell(noise[3]),
        )

    def advance(self, specimen_voltage: float, positioner_voltage: float, hand: float | None = None) -> None:
        """Integrate one control period with the voltages held.

        Args:
            specimen_voltage, positioner_voltage: of the two valves, V.
            hand: position to which a hand pulls the carriage, m; None: no hand.

        Raises:
            OrthosisError: a voltage is not finite.
        """
        if not (math.isfinite(specimen_voltage) and math.isfinite(positioner_voltage)):
            raise OrthosisError("the rig was given a valve voltage that is not finite")
        resolution = self._plant.voltage_resolution
        self._held[:2] = quantised(specimen_voltage, resolution), quantised(positioner_voltage, resolution)
        self._held[3:] = (0.0, 0.0) if hand is None else (HAND_STIFFNESS, hand)
        self.state[:] = self._advance(self.state, self._held)[0]

    def calliper(self) -> Cylinder:
        """Return a noisy reading of the investigated muscle's cylinder; draws noise once a call."""
        y, sensor, noise = self._report(), self._plant.rig.sensor, self._noise.standard_normal(2)
        return Cylinder(
            y["diameter"] + sensor.calliper_noise * float(noise[0]),
            y["length"] + sensor.calliper_length_noise * float(noise[1]),
        )

    def truth(self) -> RigTruth:
        """Return the true state (for the recorder and for tests, never for a controller)."""
        y = self._report()
        position, velocity, *pressures = self.state[:4].tolist()
        forces = y["extensor_tension"], y["flexor_tension"]
        return RigTruth(position, velocity, *forces, *pressures, y["extensor_flow"], y["flexor_flow"])

    def _report(self) -> dict[str, float]:
        return dict(zip(OUTPUTS, self._outputs(self.state, self._held)[0].tolist(), strict=True))

    def _load_cell(self, noise: float) -> float:
        """Return the reading of a cell whose errors are shares of its class, N."""
        cell, force = self._plant.rig.load_cell, self._report()["extensor_tension"]
        error = cell.offset_share + cell.scale_share * force / cell.full_scale + cell.noise_share * noise
        return quantised(force + cell.accuracy * error, cell.accuracy * cell.step_share)


def _signals(x, u, p: RigHardware) -> SimpleNamespace:
    position, velocity, ambient = x[0], x[1], p.valve.ambient_pressure
    return SimpleNamespace(
        position=position,
        velocity=velocity,
        extensor_pressure=x[2],
        flexor_pressure=x[3],
        extensor_gauge=x[2] - ambient,
        flexor_gauge=x[3] - ambient,
        extensor_contraction=position,
        flexor_contraction=positioner_contraction(position, p),
        extensor_rate=velocity,
        flexor_rate=-velocity,
        extensor_voltage=u[0],
        flexor_voltage=u[1],
        weight=u[2],
        hand_stiffness=u[3],
        hand_position=u[4],
        supply_pressure=p.valve.supply_pressure,
        extensor_dead_volume=p.valve.hose.volume,
        flexor_dead_volume=p.valve.hose.volume,
        extensor_line_drop=0.0,
        flexor_line_drop=0.0,
        extensor_length=p.muscles["extensor"].length,
        flexor_length=p.muscles["flexor"].length,
        polytropic_exponent=p.valve.polytropic_exponent,
        temperature=p.valve.temperature,
        valve=p.valve,
    )


def _true_valve(parameters):
    """Return the parameters with the true valves and gas: the belief times the knee's deviations."""
    values = parameters.flat()
    return parameters.substituted(
        {
            key: values[key] * values[f"plant.deviation.{name}"]
            for name, keys in DEVIATIONS.items()
            for key in keys
            if key.startswith("valve.")
        }
    )


def _tensions(s, p: RigHardware) -> None:
    for name, damping in p.damping.items():
        true = SimpleNamespace(force=SimpleNamespace(damping=damping))
        elastic, rate = getattr(s, f"{name}_force"), getattr(s, f"{name}_rate")
        setattr(s, f"{name}_tension", muscle_model.tension(elastic, rate, true))


def _carriage_force(s) -> None:
    """Sum the forces to the left: a weight, where there is one, hangs in place of the MAS-40."""
    right = ca.if_else(s.weight > 0, s.weight * GRAVITY, s.flexor_tension)
    stretch = s.hand_position - s.position - HAND_DAMPING_TIME * s.velocity
    s.carriage_force = s.extensor_tension - right + s.hand_stiffness * stretch
