# SPDX-License-Identifier: Apache-2.0
"""Node: the emulated hardware, in lockstep with its controllers or in real time."""

from __future__ import annotations

import sys

from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from pam_orthosis.bag.topics import CLOCK, NODES, PLANT
from pam_orthosis.control.guard import driven
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant, Truth
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.pace import Lockstep, RealTime
from pam_orthosis.nodes.parameters import Setting

TRUE = ("knee", "extensor", "flexor", "extensor_gas", "flexor_gas")
VENT_SAMPLES, VENT_SAMPLE_NS = 10, 50_000_000  # after the end of a run that was cut short
DELIVERY_SECONDS = 0.3  # less than the supervisor grants for the end


class PlantSimulator(graph.GraphNode):
    """Publishes what the sensors say and takes the valve voltages; begins when all nodes are ready."""

    def __init__(self) -> None:
        timeout = Setting(5.0, "wall time without an answer after which the run fails [s]")
        super().__init__(PLANT, {"answer_timeout": timeout})
        self._plant = Plant(self.parameters, self.parameters.scenario.seed)
        self._absent = set(NODES)
        self._newest_ns, self.abandoned = -1, False
        self._time = None if self.realtime else self.publish_numbers(CLOCK, Clock())
        joint = messages.joint_state(0, [messages.KNEE], position=[0.0])
        self._joint = self.publish_numbers("joint_states", joint)
        leg = self.settings["leg"]
        self._pressures = [
            self.publish_numbers(f"{muscle}/pressure", messages.fluid_pressure(0, muscle, 0.0, leg=leg))
            for muscle in ("extensor", "flexor")
        ]
        sensor = self.parameters.plant.sensor
        self._variance = sensor.pressure_noise**2 + sensor.pressure_resolution**2 / 12
        zeros = [0.0] * len(TRUE)
        self._truth = self.publish_numbers("truth", messages.joint_state(0, TRUE, zeros, zeros, zeros))
        self._pace = RealTime(self) if self.realtime else Lockstep(self)

    def started(self) -> None:
        """Hear who is ready; not before, so that it is said by those alone who are there now."""
        self.listen_to("ready", self._on_ready, latched=True)

    def health(self) -> dict[str, int]:
        """Count lost or late inputs."""
        return self._pace.health()

    def advance(self, extensor_voltage: float, flexor_voltage: float) -> None:
        """Let one period pass that these voltages answer; a valve vents under none that it can follow."""
        valve = self.parameters.valve
        self._plant.advance(driven(extensor_voltage, valve), driven(flexor_voltage, valve))

    def take(self, line: int, voltage: float, at_ns: int) -> None:
        """Take a voltage of the extensor's (0) or flexor's (1) valve that comes at an instant of the run."""
        self._plant.take(line, driven(voltage, self.parameters.valve), at_ns)

    def live_on(self) -> None:
        """Let one period pass under the voltages that have come."""
        self._plant.live_on()

    def abandon(self) -> bool:
        """Let the hardware live on alone: valves without commands vent, as the last samples show."""
        self.abandoned = True
        vent, periods = self.parameters.valve.minimum_voltage, max(1, VENT_SAMPLE_NS // self.period_ns)
        for _ in range(VENT_SAMPLES if self._newest_ns >= 0 else 0):
            for _ in range(periods):
                self.advance(vent, vent)
            self.publish_sample(self._newest_ns + periods * self.period_ns)
        self.wait_until_delivered(DELIVERY_SECONDS)
        return False

    def retune(self, parameters: Parameters) -> None:
        """Put a person of another mass into the orthosis, from the next step on."""
        if not parameters.leg.person.present:
            raise OrthosisError("leg.person.mass: no person is in the orthosis (leg.person.present)")
        self._plant.retune(parameters)

    def publish_sample(self, stamp_ns: int) -> None:
        """Publish the sensors' values and the truth of the present step."""
        self._newest_ns = stamp_ns
        measured, truth = self._plant.measure(), self._plant.truth()
        self._joint(stamp_ns, measured.angle)
        for send, pressure in zip(self._pressures, measured[1:], strict=True):
            send(stamp_ns, pressure, self._variance)
        self._truth(stamp_ns, *true_numbers(truth))
        if self._time and stamp_ns % (self.every * self.control_ns) == 0:
            self._time(stamp_ns)

    def _on_ready(self, message: String) -> None:
        started = not self._absent
        self._absent.discard(message.data)
        if not self._absent and not started:
            self._pace.begin()


def true_numbers(truth: Truth) -> tuple[float, ...]:
    """Return the truth of each of `TRUE`: positions, then velocities, then efforts."""
    return (
        truth.angle, truth.extensor_contraction, truth.flexor_contraction, 0.0, 0.0,
        truth.velocity, truth.extensor_rate, truth.flexor_rate, truth.extensor_flow, truth.flexor_flow,
        truth.torque, truth.extensor_force, truth.flexor_force,
        truth.extensor_pressure, truth.flexor_pressure,
    )  # fmt: skip


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PlantSimulator()])


if __name__ == "__main__":
    sys.exit(main())
