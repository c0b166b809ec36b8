# SPDX-License-Identifier: Apache-2.0
"""Node: observer and position controller, from sample, pressures and reference to pressures."""

from collections.abc import Mapping, Sequence
from typing import Any

from pam_orthosis.bag.topics import BESIDE, MEAN_PRESSURE, PLANNED, POSITION, REFERENCE, SAMPLE
from pam_orthosis.control.guarded import GuardedPosition
from pam_orthosis.control.peers import make_controller
from pam_orthosis.control.position import PositionCommand
from pam_orthosis.control.reference import Motion, Reference, as_number, from_number
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.emergency import hear_reset
from pam_orthosis.nodes.topic_node import Numbers


class PositionControllerNode(graph.GraphNode):
    """Publishes the pressure references, the estimate and the disturbance of each step."""

    def __init__(self, place: Sequence[str] = ()) -> None:
        super().__init__(POSITION, place=place)

    def configure(self) -> None:
        """Make the controller, and what it hears and says."""
        super().configure()
        self._controller = GuardedPosition(self.parameters, make_controller(self.parameters, live=True))
        self._saturated = self._clamped = 0
        self._residual = 0.0
        joint, names = self.machine.name, self.machine.names
        motion = messages.joint_state(0, [joint], position=[0.0], velocity=[0.0])
        self._estimate = self.publish_numbers("estimate", motion)
        leg = self.leg
        self._before, self._behind = messages.AROUND[self.machine.coordinate.kind]
        self._disturbance = self.publish_numbers("disturbance", messages.wrench(0, joint, leg))
        self._pressures = [
            self.publish_numbers(f"{name}/pressure_reference", messages.fluid_pressure(0, name, 0.0, leg=leg))
            for name in names
        ]
        self._state = self.publish_numbers("controller_state", messages.controller_state(0, joint))
        pressures = {f"{name}/pressure": messages.PRESSURE for name in names}
        asked = {REFERENCE: messages.MOTION, MEAN_PRESSURE: messages.PRESSURE, PLANNED: messages.MOTION}
        asked[BESIDE] = messages.MOTION
        self._asked = [topic for topic in asked if topic in self.topics]
        inputs = {SAMPLE: ["position[0]"], **pressures, **{topic: asked[topic] for topic in self._asked}}
        self._join = self.join_inputs(inputs, self._step, newest=True)
        hear_reset(self, self._controller.reset)

    def health(self) -> dict[str, Any]:
        """Count steps out of reach or outside the actuators' model, lost inputs; what the guards did."""
        return {
            **self._controller.health(),
            "saturated": self._saturated,
            "clamped": self._clamped,
            "dropped_inputs": self._join.dropped,
        }

    def figures(self) -> dict[str, Any]:
        """Return, since the last report, the largest |y - y-hat| and why the joint was released."""
        residual, self._residual = self._residual, 0.0
        figures: dict[str, Any] = {f"observer_residual_{self.machine.coordinate.unit}": residual}
        return {**figures, "released": reason} if (reason := self._controller.released()) else figures

    def latched(self) -> str:
        """Return why it vents until somebody acts, if it does."""
        return self._controller.latched

    def retune(self, parameters: Parameters) -> None:
        """Take new gains, another mode of cooperation or another load from the next step on."""
        self._controller.retune(parameters)

    def _step(self, stamp_ns: int, sample: Numbers, *others: Numbers) -> None:
        count, (position,) = len(self._pressures), sample
        periods = self.periods_since(stamp_ns)
        wanted = _reference(dict(zip(self._asked, others[count:], strict=True)))
        (first,), (second,) = others[:count]
        command = self._controller.step(position, (first, second), wanted, periods)
        self._estimate(stamp_ns, command.position, command.velocity)
        for send, pressure in zip(self._pressures, command.pressures, strict=True):
            send(stamp_ns, as_number(pressure), 0.0)  # of unknown variance
        self._disturbance(stamp_ns, *self._before, command.disturbance, *self._behind)
        self._state(stamp_ns, *_state(wanted, command))
        self._saturated += command.saturated
        self._clamped += command.clamped
        self._residual = max(self._residual, abs(command.residual))
        self.step_done(stamp_ns)


def _reference(asked: Mapping[str, Numbers]) -> Reference:
    position, velocity, acceleration = asked[REFERENCE]
    mean, planned, beside = (asked.get(topic) for topic in (MEAN_PRESSURE, PLANNED, BESIDE))
    return Reference(
        position,
        velocity,
        acceleration,
        from_number(*mean) if mean else None,
        Motion(*planned) if planned else None,
        Motion(*beside) if beside else None,
    )


def _state(wanted: Reference, command: PositionCommand) -> tuple[float, ...]:
    """Return the numbers of `messages.controller_state`."""
    (place, rate), none = wanted[:2], messages.UNKNOWN
    places = place, command.position, place - command.position, none
    rates = rate, command.velocity, rate - command.velocity, none
    return (*places, *rates, none, none, none, command.effort)


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PositionControllerNode()])
