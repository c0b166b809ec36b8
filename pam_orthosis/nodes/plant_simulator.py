# SPDX-License-Identifier: Apache-2.0
"""Node: the emulated hardware, in lockstep with its controllers or in real time."""

from collections.abc import Callable, Sequence
from functools import partial
from operator import itemgetter
from typing import Any

from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from pam_orthosis.bag.topics import CLOCK, PLANT, SAMPLE, TRUTH
from pam_orthosis.control.guard import driven
from pam_orthosis.control.session import Follower
from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.coupled import Plants
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.nodes import messages, process
from pam_orthosis.nodes.emergency import EmergencyStop
from pam_orthosis.nodes.layout import PACE, RESTING, live_keys
from pam_orthosis.nodes.pace import Lockstep, PacedNode, RealTime
from pam_orthosis.nodes.parameters import LEGS, Setting
from pam_orthosis.nodes.topic_node import Numbers

VENT_SAMPLES, VENT_SAMPLE_NS = 10, 50_000_000  # after the end of a run that was cut short


class PlantSimulator(PacedNode):
    """Publishes what the sensors say and takes the valves' commands; begins when all nodes are ready.

    The device has an emergency stop of its own: the service `~/emergency_stop` lets all valves vent, whatever
    is commanded, until `~/reset`.
    """

    def __init__(self, place: Sequence[str] = ()) -> None:
        timeout = Setting(5.0, "wall time without an answer after which the run fails [s]")
        paced = Setting(False, "in lockstep no faster than the wall clock")
        super().__init__(PLANT, {"answer_timeout": timeout, "paced": paced, "legs": LEGS}, place=place)

    def configure(self) -> None:
        """Make the hardware, and what it hears and says."""
        super().configure()
        self._own = own = {leg: self.parameters_of(leg) for leg in self.legs}  # and what was changed since
        self._plants = Plants(own)
        self._led: dict[str, Follower] = {}
        self._absent = {leg: set(self.entry("ready", leg).producers) for leg in self.legs}
        self._hears_who_is_ready = False
        self._newest_ns: int | None = None
        self._stop = EmergencyStop(self)
        clocks = [] if self.realtime else self.legs
        self._clocks = [self.publish_numbers(CLOCK, Clock(), leg=leg) for leg in clocks]
        self._shown = [Shown(self, leg, self._plants.of[leg]) for leg in self.legs]
        self._valves = [one.valve for one in own.values() for _ in one.declared.names]
        self._pace = RealTime(self) if self.realtime else Lockstep(self)

    def started(self) -> None:
        """Hear who is ready; not before, so that it is said by those alone who are there now."""
        if self._hears_who_is_ready:
            self._pace.resume()
            return
        self._hears_who_is_ready = True
        for leg in self.legs:
            self.listen_to("ready", partial(self._on_ready, leg), leg=leg, latched=True)

    def health(self) -> dict[str, Any]:
        """Count lost or late inputs; report an emergency stop."""
        return {**self._pace.health(), "emergency_stop": self._stop.active}

    def latched(self) -> str:
        """Return why all valves vent until somebody acts, if they do."""
        return "emergency stop" if self._stop.active else ""

    def advance(self, *spools: float) -> None:
        """Let one period pass that these commands answer; a valve vents under none that it can follow."""
        self._plants.advance(*map(self._driven, range(len(spools)), spools))

    def take(self, line: int, spool: float, at_ns: int) -> None:
        """Take a command for an actuator's valve (its number) that comes at an instant of the run."""
        self._plants.take(line, self._driven(line, spool), at_ns)

    def _driven(self, line: int, spool: float) -> float:
        valve = self._valves[line]
        return driven(voltage_of(VENT if self._stop.step() else spool, valve), valve)

    def live_on(self) -> None:
        """Let one period pass under the commands that have come."""
        self._plants.live_on()

    def abandon(self) -> bool:
        """Let the hardware live on alone: valves without commands vent, as the last samples show.

        In lockstep without a supervisor no time passes until somebody goes on.
        """
        self.abandoned = True
        if not (self.realtime or self.supervised):
            return False
        vents = [VENT] * len(self._valves)
        periods = max(1, VENT_SAMPLE_NS // self.period_ns)
        if (stamp_ns := self._newest_ns) is not None:
            for _ in range(VENT_SAMPLES):
                for _ in range(periods):
                    self.advance(*vents)
                stamp_ns += periods * self.period_ns
                self.publish_sample(stamp_ns)
        self.wait_until_delivered(0.3)  # less than the supervisor grants for the end
        return False

    def retune(self, parameters: Parameters) -> None:
        """Take another load, such as a person of another mass, or will of theirs, from the next step on.

        A leg keeps what it has of its own but for the keys that change.
        """
        now = {key: parameters.at(key) for key in live_keys(self.machine)[PLANT]}
        new = {key: value for key, value in now.items() if value != self.parameters.at(key)}
        for leg, plant in self._plants.of.items():
            begun = self._own[leg]
            live = live_keys(begun.declared)[PLANT]
            own = self._own[leg] = begun.changed({key: value for key, value in new.items() if key in live})
            plant.retune(own)
            if leg in self._led or any(own.at(key) != begun.at(key) for key in (PACE, RESTING)):
                led = self._led.setdefault(leg, Follower(begun))
                led.hear(own.plant.person.volition, plant.time_ns)
                plant.intend(led.aim)

    def publish_sample(self, stamp_ns: int) -> None:
        """Publish the sensors' values and the truth of the present step."""
        self._newest_ns = stamp_ns
        for shown in self._shown:
            shown.publish(stamp_ns)
        if stamp_ns % (self.every * self.control_ns) == 0:
            for send in self._clocks:
                send(stamp_ns)

    def _on_ready(self, leg: str, message: String) -> None:
        started = not any(self._absent.values())
        self._absent[leg].discard(message.data)
        if not any(self._absent.values()) and not started:
            self._pace.begin()


class Shown:
    """What one plant shows: its sensors' values and its truth."""

    def __init__(self, node: PlantSimulator, leg: str, plant: Plant):
        self._plant, machine, frames = plant, plant.machine, leg or node.leg
        joint, actuators = machine.name, machine.names
        publish = partial(node.publish_numbers, leg=leg)
        self._joint = publish(SAMPLE, messages.joint_state(0, [joint], position=[0.0]))
        shown = {name: messages.fluid_pressure(0, name, 0.0, leg=frames) for name in actuators}
        self._pressures = [publish(f"{name}/pressure", one) for name, one in shown.items()]
        sensor = node.parameters_of(leg).plant.sensor
        self._variance = sensor.pressure_noise**2 + sensor.pressure_resolution**2 / 12
        zeros = dict.fromkeys(messages.NUMBERS, [0.0] * (1 + len(actuators)))
        true = messages.joint_state(0, [joint, *actuators], **zeros)
        self._ordered = order_of_truth(len(actuators))
        self._truth = publish(TRUTH, true)
        self._gas = [
            (
                publish(f"{TRUTH}/{name}/pressure", one),
                publish(f"{TRUTH}/{name}/mass_flow", messages.mass_flow(0, name, 0.0, frames)),
            )
            for name, one in shown.items()
        ]

    def publish(self, stamp_ns: int) -> None:
        """Publish the present step."""
        place, *pressures = self._plant.measure()
        self._joint(stamp_ns, place)
        for send, pressure in zip(self._pressures, pressures, strict=True):
            send(stamp_ns, pressure, self._variance)
        moving, gas = self._ordered(self._plant.truth())
        self._truth(stamp_ns, *moving)
        for (send_pressure, send_flow), (pressure, flow) in zip(self._gas, gas, strict=True):
            send_pressure(stamp_ns, pressure, 0.0)
            send_flow(stamp_ns, flow, 0.0, 0.0)


def order_of_truth(count: int) -> Callable[[Sequence[float]], tuple[Numbers, list[Numbers]]]:
    """Return what sorts the truth of so many actuators: what moves, in the order of its message, and the gas.

    The former is positions, velocities, then efforts of the joint and of the actuators, the latter the
    pressure and the mass flow of each.
    """
    kinds = [range(first, first + count) for first in range(3, 3 + 5 * count, count)]
    contractions, rates, forces, pressures, flows = kinds
    places = (0, *contractions, 1, *rates, 2, *forces)
    moving = itemgetter(*places)
    gas = [itemgetter(*each) for each in zip(pressures, flows, strict=True)]
    return lambda truth: (moving(truth), [of_one(truth) for of_one in gas])


def main() -> int:
    """Run the node."""
    return process.run(lambda: [PlantSimulator()])
