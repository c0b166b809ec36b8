# SPDX-License-Identifier: Apache-2.0
"""Node: the emulated hardware, in lockstep with its controllers or in real time."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from operator import itemgetter

from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from pam_orthosis.bag.topics import CLOCK, PLANT, SAMPLE, TRUTH
from pam_orthosis.control.guard import driven
from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.nodes import messages, process
from pam_orthosis.nodes.emergency import EmergencyStop
from pam_orthosis.nodes.pace import Lockstep, PacedNode, RealTime
from pam_orthosis.nodes.parameters import Setting
from pam_orthosis.nodes.topic_node import Numbers

VENT_SAMPLES, VENT_SAMPLE_NS = 10, 50_000_000  # after the end of a run that was cut short
DELIVERY_SECONDS = 0.3  # less than the supervisor grants for the end


class PlantSimulator(PacedNode):
    """Publishes what the sensors say and takes the valves' commands; begins when all nodes are ready.

    The device has an emergency stop of its own: the service `~/emergency_stop` lets all valves vent, whatever
    is commanded, until `~/reset`.
    """

    def __init__(self) -> None:
        timeout = Setting(5.0, "wall time without an answer after which the run fails [s]")
        paced = Setting(False, "in lockstep no faster than the wall clock")
        super().__init__(PLANT, {"answer_timeout": timeout, "paced": paced})
        self._plant = Plant(self.parameters, self.parameters.scenario.seed)
        self._absent = set(self.topics["ready"].producers)
        self._newest_ns: int | None = None
        self._stop = EmergencyStop(self)
        self._time = None if self.realtime else self.publish_numbers(CLOCK, Clock())
        joint, actuators = self.machine.name, self.machine.names
        self._joint = self.publish_numbers(SAMPLE, messages.joint_state(0, [joint], position=[0.0]))
        leg = self.leg
        self._pressures = [
            self.publish_numbers(f"{name}/pressure", messages.fluid_pressure(0, name, 0.0, leg=leg))
            for name in actuators
        ]
        sensor = self.parameters.plant.sensor
        self._variance = sensor.pressure_noise**2 + sensor.pressure_resolution**2 / 12
        true = messages.joint_state(0, [joint, *actuators], *[[0.0] * (1 + len(actuators))] * 3)
        self._ordered = order_of_truth(len(actuators))
        self._truth = self.publish_numbers(TRUTH, true)
        self._gas = [self._truth_of(name, leg) for name in actuators]
        self._pace = RealTime(self) if self.realtime else Lockstep(self)

    def _truth_of(self, name: str, leg: str) -> tuple[Callable[..., None], Callable[..., None]]:
        """Return what publishes true pressure and mass flow of an actuator."""
        pressure, flow = messages.fluid_pressure(0, name, 0.0, leg=leg), messages.mass_flow(0, name, 0.0, leg)
        group = f"{TRUTH}/{name}"
        return self.publish_numbers(f"{group}/pressure", pressure), self.publish_numbers(
            f"{group}/mass_flow", flow
        )

    def started(self) -> None:
        """Hear who is ready; not before, so that it is said by those alone who are there now."""
        self.listen_to("ready", self._on_ready, latched=True)

    def health(self) -> dict[str, int]:
        """Count lost or late inputs; tell of an emergency stop."""
        return {**self._pace.health(), "emergency_stop": self._stop.active}

    def latched(self) -> str:
        """Return why all valves vent until somebody acts, if they do."""
        return "emergency stop" if self._stop.active else ""

    def advance(self, *spools: float) -> None:
        """Let one period pass that these commands answer; a valve vents under none that it can follow."""
        self._plant.advance(*map(self._driven, spools))

    def take(self, line: int, spool: float, at_ns: int) -> None:
        """Take a command for an actuator's valve (its number) that comes at an instant of the run."""
        self._plant.take(line, self._driven(spool), at_ns)

    def _driven(self, spool: float) -> float:
        valve = self.parameters.valve
        return driven(voltage_of(VENT if self._stop.step() else spool, valve), valve)

    def live_on(self) -> None:
        """Let one period pass under the commands that have come."""
        self._plant.live_on()

    def abandon(self) -> bool:
        """Let the hardware live on alone: valves without commands vent, as the last samples show."""
        self.abandoned = True
        vents = [VENT] * len(self._pressures)
        periods = max(1, VENT_SAMPLE_NS // self.period_ns)
        for _ in range(0 if self._newest_ns is None else VENT_SAMPLES):
            for _ in range(periods):
                self.advance(*vents)
            self.publish_sample(self._newest_ns + periods * self.period_ns)
        self.wait_until_delivered(DELIVERY_SECONDS)
        return False

    def retune(self, parameters: Parameters) -> None:
        """Take another load, such as a person of another mass, from the next step on."""
        self._plant.retune(parameters)

    def publish_sample(self, stamp_ns: int) -> None:
        """Publish the sensors' values and the truth of the present step."""
        self._newest_ns = stamp_ns
        place, *pressures = self._plant.measure()
        self._joint(stamp_ns, place)
        for send, pressure in zip(self._pressures, pressures, strict=True):
            send(stamp_ns, pressure, self._variance)
        moving, gas = self._ordered(self._plant.truth())
        self._truth(stamp_ns, *moving)
        for (send_pressure, send_flow), (pressure, flow) in zip(self._gas, gas, strict=True):
            send_pressure(stamp_ns, pressure, 0.0)
            send_flow(stamp_ns, flow, 0.0, 0.0)
        if self._time and stamp_ns % (self.every * self.control_ns) == 0:
            self._time(stamp_ns)

    def _on_ready(self, message: String) -> None:
        started = not self._absent
        self._absent.discard(message.data)
        if not self._absent and not started:
            self._pace.begin()


def order_of_truth(count: int) -> Callable[[Sequence[float]], tuple[Numbers, list[Numbers]]]:
    """Return what sorts the truth of so many actuators: what moves, in the order of its message, and the gas.

    The former is positions, velocities, then efforts of the joint and of the actuators, the latter the
    pressure and the mass flow of each.
    """
    kinds = [range(first, first + count) for first in range(3, 3 + 5 * count, count)]
    contractions, rates, forces, pressures, flows = kinds
    moving = itemgetter(0, *contractions, 1, *rates, 2, *forces)
    gas = [itemgetter(*each) for each in zip(pressures, flows, strict=True)]
    return lambda truth: (moving(truth), [of_one(truth) for of_one in gas])


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PlantSimulator()])


if __name__ == "__main__":
    sys.exit(main())
