# SPDX-License-Identifier: Apache-2.0
"""Node: the emulated hardware, in lockstep with its controllers or in real time."""

from __future__ import annotations

import sys

from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from pam_orthosis.bag.topics import NODES, PLANT
from pam_orthosis.control.guard import driven
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Measurement, Plant, Truth
from pam_orthosis.nodes import graph, messages
from pam_orthosis.nodes.pace import Lockstep, RealTime
from pam_orthosis.nodes.parameters import Setting

VENT_SAMPLES, VENT_SAMPLE_NS = 10, 50_000_000  # after the end of a run that was cut short


class PlantSimulator(graph.GraphNode):
    """Publishes what the sensors say and takes the valve voltages; begins when all nodes are ready."""

    def __init__(self) -> None:
        timeout = Setting(5.0, "wall time without an answer after which the run fails [s]")
        super().__init__(PLANT, {"answer_timeout": timeout})
        self._plant = Plant(self.parameters, self.parameters.scenario.seed)
        self._absent = set(NODES)
        self._newest_ns, self.abandoned = -1, False
        self._time = None if self.realtime else self.publish_to("/clock")
        self._joint = self.publish_to("joint_states")
        self._extensor = self.publish_to("extensor/pressure")
        self._flexor = self.publish_to("flexor/pressure")
        self._truth = self.publish_to("truth")
        self._pace = RealTime(self) if self.realtime else Lockstep(self)
        self.listen_to("ready", self._on_ready, latched=True)

    def health(self) -> dict[str, int]:
        """Count lost or late inputs."""
        return self._pace.health()

    def advance(self, extensor_voltage: float, flexor_voltage: float) -> None:
        """Let one period pass under these voltages; a valve vents under none that it can follow."""
        valve = self.parameters.valve
        self._plant.advance(driven(extensor_voltage, valve), driven(flexor_voltage, valve))

    def abandon(self) -> bool:
        """Let the hardware live on alone: valves without commands vent, as the last samples show."""
        self.abandoned = True
        vent, periods = self.parameters.valve.minimum_voltage, max(1, VENT_SAMPLE_NS // self.period_ns)
        for _ in range(VENT_SAMPLES if self._newest_ns >= 0 else 0):
            for _ in range(periods):
                self.advance(vent, vent)
            self.publish_sample(self._newest_ns + periods * self.period_ns)
        return True

    def retune(self, parameters: Parameters) -> None:
        """Put a person of another mass into the orthosis, from the next step on."""
        if not parameters.leg.person.present:
            raise OrthosisError("leg.person.mass: no person is in the orthosis (leg.person.present)")
        self._plant.retune(parameters)

    def publish_sample(self, stamp_ns: int) -> None:
        """Publish the sensors' values and the truth of the present step."""
        self._newest_ns = stamp_ns
        measured, truth = self._plant.measure(), self._plant.truth()
        self._publish_measurement(stamp_ns, measured)
        self._truth.publish(truth_message(stamp_ns, truth))
        if self._time:
            self._time.publish(Clock(clock=messages.time(stamp_ns)))

    def _on_ready(self, message: String) -> None:
        started = not self._absent
        self._absent.discard(message.data)
        if not self._absent and not started:
            self._pace.begin()

    def _publish_measurement(self, stamp_ns: int, measured: Measurement) -> None:
        sensor = self.parameters.plant.sensor
        variance = sensor.pressure_noise**2 + sensor.pressure_resolution**2 / 12
        self._joint.publish(messages.joint_state(stamp_ns, [messages.KNEE], position=[measured.angle]))
        for muscle, publisher, pressure in (
            ("extensor", self._extensor, measured.extensor_pressure),
            ("flexor", self._flexor, measured.flexor_pressure),
        ):
            publisher.publish(messages.fluid_pressure(stamp_ns, muscle, pressure, variance))


def truth_message(stamp_ns: int, truth: Truth) -> JointState:
    """Return the truth as named scalars: motion and torque of the knee, muscles, gas."""
    return messages.joint_state(
        stamp_ns,
        [messages.KNEE, "extensor", "flexor", "extensor_gas", "flexor_gas"],
        position=[truth.angle, truth.extensor_contraction, truth.flexor_contraction, 0.0, 0.0],
        velocity=[
            truth.velocity,
            truth.extensor_rate,
            truth.flexor_rate,
            truth.extensor_flow,
            truth.flexor_flow,
        ],
        effort=[
            truth.torque,
            truth.extensor_force,
            truth.flexor_force,
            truth.extensor_pressure,
            truth.flexor_pressure,
        ],
    )


def main() -> int:
    """Run the node."""
    return graph.run(lambda: [PlantSimulator()])


if __name__ == "__main__":
    sys.exit(main())
