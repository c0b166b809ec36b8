# SPDX-License-Identifier: Apache-2.0
"""Node: inverse valve model of both muscles, from mass flow and pressure to valve voltage."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from sensor_msgs.msg import FluidPressure, JointState

from pam_orthosis.bag.topics import VALVE
from pam_orthosis.control.inverse_valve import InverseValveModel
from pam_orthosis.nodes import graph, messages
from pam_orthosis.nodes.join import Join

MUSCLES = ("extensor", "flexor")


class InverseValveModelNode(graph.GraphNode):
    """Publishes each step's voltage of each valve as soon as its own inputs are there."""

    def __init__(self) -> None:
        super().__init__(VALVE)
        self._both = Join(MUSCLES, lambda stamp_ns, *_: self.step_done(stamp_ns))
        self._joins = [
            self.join_inputs((f"{muscle}/mass_flow", f"{muscle}/pressure"), self._step(muscle))
            for muscle in MUSCLES
        ]

    def health(self) -> dict[str, Any]:
        """Count lost inputs."""
        return {"dropped_inputs": sum(join.dropped for join in self._joins)}

    def _step(self, muscle: str) -> Callable[[int, JointState, FluidPressure], None]:
        model = InverseValveModel(self.parameters)
        publisher = self.publish_to(f"{muscle}/valve_voltage")

        def step(stamp_ns: int, flow: JointState, pressure: FluidPressure) -> None:
            voltage = model.step(flow.velocity[0], pressure.fluid_pressure)
            publisher.publish(messages.joint_state(stamp_ns, [f"{muscle}_valve"], effort=[voltage]))
            self._both.add(muscle, stamp_ns, voltage)

        return step


def main() -> int:
    """Run the node."""
    return graph.run(lambda: [InverseValveModelNode()])


if __name__ == "__main__":
    sys.exit(main())
