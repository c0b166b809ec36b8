# SPDX-License-Identifier: Apache-2.0
"""Node: the emulated hardware in lockstep: step k is over when both its voltages are there."""

from __future__ import annotations

import sys
import time

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from pam_orthosis.bag.topics import BY_NAME, NODES, PLANT
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.plant import Measurement, Plant, Truth
from pam_orthosis.nodes import graph, messages
from pam_orthosis.nodes.parameters import Setting

MAX_UNRECORDED_STEPS = 100
WATCH_SECONDS = 0.25
INPUTS = ("extensor/valve_voltage", "flexor/valve_voltage")


class PlantSimulator(graph.GraphNode):
    """Publishes what the sensors of step k say, waits for the valve voltages of step k, advances.

    It stays at most `MAX_UNRECORDED_STEPS` ahead of the recorder, and after the last step it ends
    the run for all nodes once everything is recorded.
    """

    def __init__(self) -> None:
        timeout = Setting(5.0, "wall time without an answer after which the run fails [s]")
        super().__init__(PLANT, {"answer_timeout": timeout})
        scenario = self.parameters.scenario
        self._plant = Plant(self.parameters, scenario.seed)
        self._last_ns = (round(scenario.duration * 1e9 / self.period_ns) - 1) * self.period_ns
        self._stamp_ns = 0
        self._recorded_ns = -1
        self._waits = False
        self._absent = set(NODES)
        self._progress = time.monotonic()
        self._time = self.publish_to("/clock")
        self._joint = self.publish_to("joint_states")
        self._extensor = self.publish_to("extensor/pressure")
        self._flexor = self.publish_to("flexor/pressure")
        self._truth = self.publish_to("truth")
        self._end = self.publish_to("end")
        self._join = self.join_inputs(INPUTS, self._advance)
        self.listen_to("ready", self._on_ready, latched=True)
        self.listen_to("recorded", self._on_recorded)
        self.create_timer(WATCH_SECONDS, self._watch)

    def health(self) -> dict[str, int]:
        """Count lost inputs."""
        return {"dropped_inputs": self._join.dropped}

    def _on_ready(self, message: String) -> None:
        started = not self._absent
        self._absent.discard(message.data)
        if not self._absent and not started:
            self._publish_step()

    def _publish_step(self) -> None:
        """Publish the sensors' values and the truth of the present step."""
        self._progress = time.monotonic()
        stamp_ns, measured, truth = self._stamp_ns, self._plant.measure(), self._plant.truth()
        self._publish_measurement(stamp_ns, measured)
        self._truth.publish(truth_message(stamp_ns, truth))
        self._time.publish(Clock(clock=messages.time(stamp_ns)))

    def _publish_measurement(self, stamp_ns: int, measured: Measurement) -> None:
        sensor = self.parameters.plant.sensor
        variance = sensor.pressure_noise**2 + sensor.pressure_resolution**2 / 12
        self._joint.publish(messages.joint_state(stamp_ns, [messages.KNEE], position=[measured.angle]))
        for muscle, publisher, pressure in (
            ("extensor", self._extensor, measured.extensor_pressure),
            ("flexor", self._flexor, measured.flexor_pressure),
        ):
            publisher.publish(messages.fluid_pressure(stamp_ns, muscle, pressure, variance))

    def _advance(self, stamp_ns: int, extensor: JointState, flexor: JointState) -> None:
        self._plant.advance(extensor.effort[0], flexor.effort[0])
        self.step_done(stamp_ns)
        self._progress = time.monotonic()
        self._stamp_ns += self.period_ns
        self._waits = True
        self._go_on()

    def _on_recorded(self, message: Time) -> None:
        self._recorded_ns = messages.nanoseconds(message)
        self._go_on()

    def _go_on(self) -> None:
        """Take the next step, or end the run, when the recorder is near enough."""
        if not self._waits:
            return
        if self._stamp_ns > self._last_ns:
            if self._recorded_ns >= self._last_ns:
                self._finish()
        elif self._stamp_ns - self._recorded_ns <= MAX_UNRECORDED_STEPS * self.period_ns:
            self._waits = False
            self._publish_step()

    def _finish(self) -> None:
        self._waits = False
        self._end.publish(messages.time(self._last_ns))
        self._end.wait_for_all_acked(Duration(seconds=1.0))
        self.ended = True

    def _watch(self) -> None:
        """Fail, naming what is missing, when nothing has moved for too long."""
        limit = self.settings["answer_timeout"]
        if self._absent or self.ended or time.monotonic() - self._progress < limit:
            return
        at = f"at {self._stamp_ns / 1e9:.3f} s for {limit:g} s"
        if self._waits:
            raise RunFailed(f"plant_simulator waited {at}: bag_recorder does not keep up")
        topics = self._join.missing(self._stamp_ns)
        producers = {name for topic in topics for name in BY_NAME[topic].producers}
        raise RunFailed(
            f"plant_simulator waited {at}: {' and '.join(topics)} did not come from"
            f" {' and '.join(sorted(producers))}"
        )


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
