# SPDX-License-Identifier: Apache-2.0
"""Node: pressure controller of one actuator, from pressures and estimate to a mass flow."""

from collections.abc import Sequence
from typing import Any

from pam_orthosis.bag.topics import CONTROLLER
from pam_orthosis.control.guarded import GuardedPressure
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import from_number
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.emergency import hear_reset
from pam_orthosis.nodes.parameters import Setting
from pam_orthosis.nodes.topic_node import Numbers

NAME = "pressure_controller"


class PressureControllerNode(graph.GraphNode):
    """Publishes the mass flow of each step into an actuator of the machine."""

    def __init__(self, name: str = NAME, place: Sequence[str] = ()) -> None:
        of_name = name.removesuffix(NAME).rstrip("_")
        muscle = Setting(of_name, "actuator whose pressure is controlled, e.g. extensor")
        super().__init__(name, {"muscle": muscle}, CONTROLLER.format("{muscle}"), place)

    def configure(self) -> None:
        """Make the controller, and what it hears and says."""
        super().configure()
        self._muscle = self.settings["muscle"]
        controller = PressureController(self.parameters, self._muscle)
        self._controller = GuardedPressure(self.parameters, controller)
        flow = messages.mass_flow(0, self._muscle, 0.0, self.leg)
        self._flow = self.publish_numbers(f"{self._muscle}/mass_flow", flow)
        inputs = {
            f"{self._muscle}/pressure": messages.PRESSURE,
            f"{self._muscle}/pressure_reference": messages.PRESSURE,
            "estimate": ["position[0]", "velocity[0]"],
        }
        self._join = self.join_inputs(inputs, self._step)
        hear_reset(self, self._controller.reset)

    def health(self) -> dict[str, Any]:
        """Count lost inputs, and what the guards did."""
        return {**self._controller.health(), "dropped_inputs": self._join.dropped}

    def latched(self) -> str:
        """Return why it vents until somebody acts, if it does."""
        return self._controller.latched

    def retune(self, parameters: Parameters) -> None:
        """Take a new gain or bandwidth from the next step on."""
        self._controller.retune(parameters)

    def _step(
        self, stamp_ns: int, pressure: Numbers, wanted: Numbers, estimate: Numbers, age: float = 0.0
    ) -> None:
        periods, (measured,), (position, velocity) = self.periods_since(stamp_ns), pressure, estimate
        flow = self._controller.step(measured, from_number(*wanted), position, velocity, periods, age)
        self._flow(stamp_ns, flow, 0.0, 0.0)
        self.step_done(stamp_ns)


def main(name: str = NAME) -> int:
    """Run the node; its name, or else the parameter `muscle`, says for which actuator."""
    return process.run(lambda: [PressureControllerNode(name)])
