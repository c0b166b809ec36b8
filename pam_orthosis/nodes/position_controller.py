# SPDX-License-Identifier: Apache-2.0
"""Node: observer and position controller, from angle, pressures and reference to pressures."""

from __future__ import annotations

import sys
from typing import Any

from sensor_msgs.msg import FluidPressure, JointState
from trajectory_msgs.msg import JointTrajectory

from pam_orthosis.bag.topics import POSITION
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.position import PositionController
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages


class PositionControllerNode(graph.GraphNode):
    """Publishes both pressure references, the estimate and the disturbance of each step."""

    def __init__(self) -> None:
        super().__init__(POSITION)
        self._controller = GuardedPosition(self.parameters, PositionController(self.parameters))
        self._saturated = self._clamped = 0
        self._residual = 0.0
        self._estimate = self.publish_to("estimate")
        self._disturbance = self.publish_to("disturbance")
        self._extensor = self.publish_to("extensor/pressure_reference")
        self._flexor = self.publish_to("flexor/pressure_reference")
        self._join = self.join_inputs(
            ("joint_states", "extensor/pressure", "flexor/pressure", "reference"), self._step, newest=True
        )

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

    def _step(
        self,
        stamp_ns: int,
        joint: JointState,
        extensor: FluidPressure,
        flexor: FluidPressure,
        reference: JointTrajectory,
    ) -> None:
        command = self._controller.step(
            messages.only(joint.position),
            extensor.fluid_pressure,
            flexor.fluid_pressure,
            messages.reference(reference),
        )
        self._estimate.publish(
            messages.joint_state(
                stamp_ns, [messages.KNEE], position=[command.angle], velocity=[command.velocity]
            )
        )
        self._extensor.publish(messages.fluid_pressure(stamp_ns, "extensor", command.extensor_pressure))
        self._flexor.publish(messages.fluid_pressure(stamp_ns, "flexor", command.flexor_pressure))
        self._disturbance.publish(messages.torque(stamp_ns, command.disturbance))
        self._saturated += command.saturated
        self._clamped += command.clamped
        self._residual = max(self._residual, abs(command.residual))
        self.step_done(stamp_ns)


def _mass_changed(before: Parameters, after: Parameters) -> bool:
    return before.leg.person.mass != after.leg.person.mass


def main() -> int:
    """Run the node."""
    return graph.run(lambda: [PositionControllerNode()])


if __name__ == "__main__":
    sys.exit(main())
