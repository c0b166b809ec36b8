# SPDX-License-Identifier: Apache-2.0
"""Node: observer and position controller, from angle, pressures and reference to pressures."""

from __future__ import annotations

import sys
from typing import Any

from pam_orthosis.bag.topics import POSITION
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.trajectory import Reference
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process

INPUTS = {
    "joint_states": ["position[0]"],
    "extensor/pressure": ["fluid_pressure"],
    "flexor/pressure": ["fluid_pressure"],
    "reference": messages.REFERENCE,
}
UNKNOWN_VARIANCE = 0.0


class PositionControllerNode(graph.GraphNode):
    """Publishes both pressure references, the estimate and the disturbance of each step."""

    def __init__(self) -> None:
        super().__init__(POSITION)
        self._controller = GuardedPosition(self.parameters, PositionController(self.parameters))
        self._saturated = self._clamped = 0
        self._residual = 0.0
        motion = messages.joint_state(0, [messages.KNEE], position=[0.0], velocity=[0.0])
        self._estimate = self.publish_numbers("estimate", motion)
        leg = self.settings["leg"]
        self._disturbance = self.publish_numbers("disturbance", messages.torque(0, 0.0, leg))
        self._pressures = [
            self.publish_numbers(
                f"{muscle}/pressure_reference", messages.fluid_pressure(0, muscle, 0.0, leg=leg)
            )
            for muscle in ("extensor", "flexor")
        ]
        self._join = self.join_inputs(INPUTS, self._step, newest=True)

    def health(self) -> dict[str, Any]:
        """Count steps out of reach or outside the muscle model, lost inputs; tell what the guards did."""
        return {
            **self._controller.health(),
            "saturated": self._saturated,
            "clamped": self._clamped,
            "dropped_inputs": self._join.dropped,
        }

    def figures(self) -> dict[str, Any]:
        """Return the largest |y - y-hat| of the observer since the last report."""
        residual, self._residual = self._residual, 0.0
        return {"observer_residual_rad": residual}

    def retune(self, parameters: Parameters) -> None:
        """Take new gains, observer poles or the person's mass from the next step on."""
        if not parameters.leg.person.present and _mass_changed(self.parameters, parameters):
            raise OrthosisError("leg.person.mass: no person is in the orthosis (leg.person.present)")
        self._controller.retune(parameters)

    def _step(self, stamp_ns: int, joint: tuple, extensor: tuple, flexor: tuple, reference: tuple) -> None:
        periods = self.periods_since(stamp_ns)
        command = self._controller.step(*joint, *extensor, *flexor, Reference(*reference), periods)
        self._estimate(stamp_ns, command.angle, command.velocity)
        for send, pressure in zip(self._pressures, command[:2], strict=True):
            send(stamp_ns, pressure, UNKNOWN_VARIANCE)
        self._disturbance(stamp_ns, *messages.NO_FORCE, 0.0, command.disturbance, 0.0)
        self._saturated += command.saturated
        self._clamped += command.clamped
        self._residual = max(self._residual, abs(command.residual))
        self.step_done(stamp_ns)


def _mass_changed(before: Parameters, after: Parameters) -> bool:
    return before.leg.person.mass != after.leg.person.mass


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PositionControllerNode()])


if __name__ == "__main__":
    sys.exit(main())
