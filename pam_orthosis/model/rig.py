# SPDX-License-Identifier: Apache-2.0
"""The test rig of the paper's fig. 2 as emulated hardware, Eqs. (1)-(2) and (6)-(8).

The investigated muscle is the machine's `specimen`, the MAS-40 its `positioner`. Gas, valves and the effects
of muscles and valves are those of all machines.
"""

from dataclasses import replace
from typing import NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.model.assembly import Hardware
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.components import muscle
from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.machines import RIG
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Array, Plant, quantised
from pam_orthosis.model.rows import Section
from pam_orthosis.model.truth import true_parameters

# of `plant.effects`, those of muscles and valves act at the rig too
SHARED_EFFECTS = ("muscle_hysteresis", "valve_lag", "valve_dead_band")


class RigMeasurement(NamedTuple):
    """One sample of the sensors: carriage position m, absolute pressures Pa, load cell N."""

    position: float
    specimen_pressure: float
    positioner_pressure: float
    force: float


class Cylinder(NamedTuple):
    """What a calliper reads on the investigated muscle: diameter and length of its cylinder, m."""

    diameter: float
    length: float


def with_specimen(specimen: str) -> Machine:
    """Return the rig with an investigated muscle, one of `model.specimens.SPECIMENS`."""
    return RIG.with_parts(specimen=f"muscle.{specimen}")


def true_hardware(parameters: Parameters, machine: Machine) -> Hardware:
    """Return what the emulated rig is built from."""
    true = true_parameters(parameters, ("valve.",))

    def actuator(branch: str) -> Actuator:
        own = true.at(f"plant.rig.{branch.removeprefix('muscle.')}")
        return replace(muscle.braid(true.at(branch), own.force), damping=own.damping)

    effects = {name: values for name, values in true.plant.effects.items() if name in SHARED_EFFECTS}
    settings = Section("plant.rig.effects", effects | dict(true.plant.rig.effects.items()))
    actuators = {one.name: actuator(one.parameters) for one in machine.actuators}
    return Hardware(machine, machine.mechanism(true), true.valve, actuators, settings)


class RigPlant(Plant):
    """Emulated rig with sensors; nothing is lost between a sample and the valves.

    Args:
        position: of the carriage at the start, m; the investigated muscle begins at ambient pressure.
        positioner_pressure: of the MAS-40 at the start, absolute Pa; None: ambient.
        weight: kg, hung on the carriage in place of the MAS-40 (0: the MAS-40 is hooked).
    """

    def __init__(
        self,
        parameters: Parameters,
        specimen: str,
        seed: int = 0,
        position: float = 0.0,
        positioner_pressure: float | None = None,
        weight: float = 0.0,
    ):
        ambient = parameters.valve.ambient_pressure
        self._begin = position, 0.0, ambient, positioner_pressure or ambient
        self._weight, self._hand = weight, (0.0, 0.0)
        super().__init__(RIG.taken(parameters), seed, with_specimen(specimen))
        x, u, s = self.assembly.x, self.assembly.u, self.assembly.signals.actuators["specimen"]
        cylinder = muscle.cylinder(s.contraction, s.gauge, parameters.at(f"muscle.{specimen}"))
        self._cylinder = compiled(ca.Function("rig_cylinder", [x, u], [ca.vertcat(*cylinder[:2])]))

    def measure(self) -> RigMeasurement:
        """Return noisy, quantised readings of the present state; draws noise once a call."""
        position, specimen, positioner = super().measure()
        force = self._load_cell(float(self._noise.standard_normal()))
        return RigMeasurement(position, specimen, positioner, force)

    def advance(self, *voltages: float, hand: float | None = None) -> None:
        """Let a control period pass under voltages of specimen and positioner; a hand pulls to a place, m."""
        hand_stiffness = 2.0e5  # N/m, of the hand that pulls the carriage
        self._hand = (0.0, 0.0) if hand is None else (hand_stiffness, hand)
        super().advance(*voltages)

    def calliper(self) -> Cylinder:
        """Return a noisy reading of the investigated muscle's cylinder; draws noise once a call."""
        diameter, length = self._cylinder(self.state, self._held)[0].tolist()
        sensor, noise = self._p.plant.rig.sensor, self._noise.standard_normal(2).tolist()
        return Cylinder(
            diameter + sensor.calliper_noise * noise[0], length + sensor.calliper_length_noise * noise[1]
        )

    def _hardware(self, parameters: Parameters) -> Hardware:
        return true_hardware(parameters, self.machine)

    def _delays_ns(self) -> tuple[int, int]:
        return 0, 0

    def _external(self, time: float) -> tuple[float, float, float]:
        return self._weight, *self._hand

    def _start(self, hardware: Hardware, accelerate: ca.Function) -> Array:
        x = np.zeros(len(self.states))
        x[:4] = self._begin
        return x

    def _load_cell(self, noise: float) -> float:
        """Return the reading of a cell whose errors are shares of its class, N."""
        cell, force = self._p.plant.rig.load_cell, self._report()["specimen_tension"]
        error = cell.offset_share + cell.scale_share * force / cell.full_scale + cell.noise_share * noise
        return quantised(force + cell.accuracy * error, cell.accuracy * cell.step_share)
