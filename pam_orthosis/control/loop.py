# SPDX-License-Identifier: Apache-2.0
"""The closed loop without ROS: the same cores, wired by calls, for studies and tests.

It knows the emulated machine, as `rig_loop` knows the rig, and passes on measurements only.
"""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.diagnostic import Experiment
from pam_orthosis.control.guard import Guarded
from pam_orthosis.control.guarded import GuardedPosition, GuardedPressure, GuardedValve
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.limits import SafetyMonitor, restrained
from pam_orthosis.control.peers import make_controller
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import as_number
from pam_orthosis.control.repetition import Repetition
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.control.waiting import Waiting
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.progress import Progress, silent

TOLD = 200  # steps between two words on the progress


def signals(machine: Machine) -> tuple[str, ...]:
    """Return what a run of a machine reports, in this order; the true effort is that from outside."""
    q = machine.coordinate.name
    kinds = "pressure_reference", "mass_flow", "voltage"
    return (
        "time", f"reference_{q}", "reference_velocity", "reference_acceleration", f"followed_{q}",
        *machine.channels, f"estimate_{q}", "estimate_velocity", "disturbance",
        *(f"{name}_{kind}" for kind in kinds for name in machine.names),
        f"true_{q}", "true_velocity", f"true_{machine.coordinate.effort}", "saturated", "clamped",
    )  # fmt: skip


class Hardware(Protocol):
    """What takes part in the loop: the methods of `Plant`."""

    period_ns: int

    def measure(self) -> Sequence[float]:
        """Return a sample: position and both pressures."""

    def truth(self) -> Sequence[float]:
        """Return the true state: position, velocity, effort from outside, and more."""

    def advance(self, *voltages: float) -> None:
        """Let a control period pass."""


class Watched:
    """Hardware whose valves get no more than a safety monitor lets through."""

    def __init__(self, plant: Hardware, monitor: SafetyMonitor):
        self._plant, self.monitor = plant, monitor
        self.period_ns = plant.period_ns
        self._time_ns = 0
        self._ceilings: tuple[float, ...] = ()

    def measure(self) -> Sequence[float]:
        """Return a sample, which the monitor has seen."""
        sample = self._plant.measure()
        self._ceilings = self.monitor.step(self._time_ns, sample[0], sample[1:])
        return sample

    def truth(self) -> Sequence[float]:
        """Return the true state of the hardware."""
        return self._plant.truth()

    def advance(self, *voltages: float) -> None:
        """Let a control period pass."""
        self._plant.advance(*restrained(voltages, self._ceilings))
        self._time_ns += self.period_ns


def made_reference(parameters: Parameters) -> Trajectory | Experiment | Waiting:
    """Return what `scenario` asks for; it waits for the person if that is wanted."""
    trajectory = make_trajectory(parameters)
    return Waiting(trajectory, parameters) if parameters.control.cooperation.wait else trajectory


class ClosedLoop:
    """Plant, trajectory and cascade of controllers in one process; what is given stands in for these."""

    def __init__(
        self,
        parameters: Parameters,
        seed: int = 0,
        plant: Hardware | None = None,
        trajectory: Trajectory | Experiment | Waiting | Repetition | None = None,
        position: PositionController | None = None,
    ):
        self.plant: Hardware = Plant(parameters, seed) if plant is None else plant
        self._trajectory = made_reference(parameters) if trajectory is None else trajectory
        position = make_controller(parameters) if position is None else position
        self._every = parameters.control.position.every
        self._position = GuardedPosition(parameters, position)
        self._names, self.signals = parameters.declared.names, signals(parameters.declared)
        self._pressure = [GuardedPressure(parameters, PressureController(parameters, n)) for n in self._names]
        self._valves = [GuardedValve(parameters, InverseValveModel(parameters, n)) for n in self._names]

    def health(self) -> dict[str, dict[str, Any]]:
        """Return what each controller's guards have counted."""
        guarded: dict[str, Guarded] = {"position": self._position}
        guarded |= {f"{n} pressure": each for n, each in zip(self._names, self._pressure, strict=True)}
        guarded |= {f"{n} valve": each for n, each in zip(self._names, self._valves, strict=True)}
        return {name: each.health() for name, each in guarded.items()}

    def run(self, steps: int, progress: Progress = silent) -> dict[str, NDArray[np.float64]]:
        """Advance; returns an array of `steps` samples for each of `signals`, SI units.

        What the position controller says is held between its steps; the reference is that of each instant.
        """
        table = np.empty((steps, len(self.signals)))
        for index in range(steps):
            if not index % TOLD:
                progress("simulating", index, steps)
            table[index] = self.step(index)
        return dict(zip(self.signals, table.T, strict=True))

    def step(self, index: int) -> tuple[float, ...]:
        """Take the step of this number; return its values of `signals`."""
        time_ns = index * self.plant.period_ns
        (position, *pressures), truth = self.plant.measure(), self.plant.truth()
        reference = self._trajectory.sample(time_ns)
        if isinstance(self._trajectory, Waiting | Repetition):
            self._trajectory.heed(position)
        followed = reference.position if reference.planned is None else reference.planned.position
        held = index % self._every
        if not held:
            first, second = pressures
            self._command = self._position.step(position, (first, second), reference)
        command, age = self._command, held * self.plant.period_ns * 1e-9
        flows = [
            controller.step(p, p_ref, command.position, command.velocity, age=age)
            for controller, p, p_ref in zip(self._pressure, pressures, command.pressures, strict=True)
        ]
        voltages = [
            valve.step(flow, p) for valve, flow, p in zip(self._valves, flows, pressures, strict=True)
        ]
        self.plant.advance(*voltages)
        return (
            time_ns * 1e-9, *reference[:3], followed, position, *pressures, command.position,
            command.velocity, command.disturbance, *map(as_number, command.pressures), *flows, *voltages,
            *truth[:3], command.saturated, command.clamped,
        )  # fmt: skip
