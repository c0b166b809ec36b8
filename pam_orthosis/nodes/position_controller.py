# SPDX-License-Identifier: Apache-2.0
"""Node: observer and position controller, from sample, pressures and reference to pressures."""

from __future__ import annotations

import sys
from typing import Any

from pam_orthosis.bag.topics import POSITION, REFERENCE, SAMPLE
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.reference import Reference, as_number
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process

UNKNOWN_VARIANCE = 0.0


class PositionControllerNode(graph.GraphNode):
    """Publishes the pressure references, the estimate and the disturbance of each step."""

    def __init__(self) -> None:
        super().__init__(POSITION)
        self._controller = GuardedPosition(self.parameters, PositionController(self.parameters))
        self._saturated = self._clamped = 0
        self._residual = 0.0
        joint, names = self.machine.name, self.machine.names
        motion = messages.joint_state(0, [joint], position=[0.0], velocity=[0.0])
        self._estimate = self.publish_numbers("estimate", motion)
        leg = self.settings["leg"]
        self._before, self._behind = messages.AROUND[self.machine.coordinate.kind]
        self._disturbance = self.publish_numbers("disturbance", messages.wrench(0, joint, leg))
        self._pressures = [
            self.publish_numbers(f"{name}/pressure_reference", messages.fluid_pressure(0, name, 0.0, leg=leg))
            for name in names
        ]
        pressures = {f"{name}/pressure": ["fluid_pressure"] for name in names}
        inputs = {SAMPLE: ["position[0]"], **pressures, REFERENCE: messages.REFERENCE}
        self._join = self.join_inputs(inputs, self._step, newest=True)

    def health(self) -> dict[str, Any]:
        """Count steps out of reach or outside the actuators' model, lost inputs; tell what the guards did."""
        return {
            **self._controller.health(),
            "saturated": self._saturated,
            "clamped": self._clamped,
            "dropped_inputs": self._join.dropped,
        }

    def figures(self) -> dict[str, Any]:
        """Return the largest |y - y-hat| of the observer since the last report."""
        residual, self._residual = self._residual, 0.0
        return {f"observer_residual_{self.machine.coordinate.unit}": residual}

    def retune(self, parameters: Parameters) -> None:
        """Take new gains, observer poles or another load from the next step on."""
        self._controller.retune(parameters)

    def _step(self, stamp_ns: int, sample: tuple, *others: tuple) -> None:
        *pressures, reference = others
        periods = self.periods_since(stamp_ns)
        wanted = Reference.from_numbers(*reference)
        command = self._controller.step(*sample, tuple(one for (one,) in pressures), wanted, periods)
        self._estimate(stamp_ns, command.position, command.velocity)
        for send, pressure in zip(self._pressures, command.pressures, strict=True):
            send(stamp_ns, as_number(pressure), UNKNOWN_VARIANCE)
        self._disturbance(stamp_ns, *self._before, command.disturbance, *self._behind)
        self._saturated += command.saturated
        self._clamped += command.clamped
        self._residual = max(self._residual, abs(command.residual))
        self.step_done(stamp_ns)


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PositionControllerNode()])


if __name__ == "__main__":
    sys.exit(main())
