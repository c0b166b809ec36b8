# SPDX-License-Identifier: Apache-2.0
"""The closed loop without ROS: the same cores, wired by calls, for studies and tests.

It knows the orthosis' plant, as `rig_loop` knows the rig's, and passes on measurements only.
"""

from __future__ import annotations

import numpy as np

from pam_orthosis.control.guarded import GuardedPosition, GuardedPressure, GuardedValve
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.orthosis import MUSCLES
from pam_orthosis.model.plant import Plant
from pam_orthosis.progress import Progress, silent

TOLD = 200  # steps between two words on the progress

SIGNALS = (
    "time", "reference_angle", "reference_velocity", "reference_acceleration", "followed_angle",
    "angle", "extensor_pressure", "flexor_pressure",
    "estimated_angle", "estimated_velocity", "disturbance",
    "extensor_pressure_reference", "flexor_pressure_reference",
    "extensor_mass_flow", "flexor_mass_flow", "extensor_voltage", "flexor_voltage",
    "true_angle", "true_velocity", "true_torque", "saturated", "clamped",
)  # fmt: skip


class ClosedLoop:
    """Plant, trajectory and cascade of controllers in one process.

    Args:
        parameters: the whole tree.
        seed: of the sensor noise.
        plant: another plant with the methods of `Plant`.
        trajectory: another trajectory with the method `sample`.
        position: another position controller with the method `step` of `PositionController`.
    """

    def __init__(self, parameters, seed: int = 0, plant=None, trajectory=None, position=None):
        self.plant = Plant(parameters, seed) if plant is None else plant
        self._trajectory = make_trajectory(parameters) if trajectory is None else trajectory
        position = PositionController(parameters) if position is None else position
        self._every = parameters.control.position.every
        self._position = GuardedPosition(parameters, position)
        self._pressure = [GuardedPressure(parameters, PressureController(parameters, m)) for m in MUSCLES]
        self._valves = [GuardedValve(parameters, InverseValveModel(parameters, m)) for m in MUSCLES]

    def health(self) -> dict[str, dict]:
        """Return what each controller's guards have counted."""
        guarded = {"position": self._position}
        guarded |= {f"{m} pressure": each for m, each in zip(MUSCLES, self._pressure, strict=True)}
        guarded |= {f"{m} valve": each for m, each in zip(MUSCLES, self._valves, strict=True)}
        return {name: each.health() for name, each in guarded.items()}

    def run(self, steps: int, progress: Progress = silent) -> dict[str, np.ndarray]:
        """Advance; returns an array of `steps` samples for each of `SIGNALS`, SI units.

        What the position controller says is held between its steps; the reference is that of each instant.
        """
        table = np.empty((steps, len(SIGNALS)))
        for index in range(steps):
            if not index % TOLD:
                progress("simulating", index, steps)
            table[index] = self._step(index)
        return dict(zip(SIGNALS, table.T, strict=True))

    def _step(self, index: int) -> tuple:
        time_ns = index * self.plant.period_ns
        measured, truth = self.plant.measure(), self.plant.truth()
        reference = self._trajectory.sample(time_ns)
        followed = reference.angle if reference.planned_angle is None else reference.planned_angle
        held = index % self._every
        if not held:
            self._command = self._position.step(*measured, reference)
        command, age = self._command, held * self.plant.period_ns * 1e-9
        pressures, wanted = measured[1:], command[:2]
        flows = [
            controller.step(p, p_ref, command.angle, command.velocity, age=age)
            for controller, p, p_ref in zip(self._pressure, pressures, wanted, strict=True)
        ]
        voltages = [
            valve.step(flow, p) for valve, flow, p in zip(self._valves, flows, pressures, strict=True)
        ]
        self.plant.advance(*voltages)
        return (
            time_ns * 1e-9, *reference[:3], followed, *measured, command.angle, command.velocity,
            command.disturbance, *wanted, *flows, *voltages,
            truth.angle, truth.velocity, truth.torque, command.saturated, command.clamped,
        )  # fmt: skip
