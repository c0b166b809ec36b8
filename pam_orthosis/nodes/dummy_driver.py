# SPDX-License-Identifier: Apache-2.0
"""Node: an example of a hardware driver for `run --realtime --no-plant` (contract: docs/howto/driver.md).

It is no node of the graph, as a driver outside this package is none. Replace `EmulatedHardware` by calls
to the devices; the rest is what the controllers expect of any driver. Its parameters are those of
`config/`: the run must have the same `scenario.control_period`.
"""

from __future__ import annotations

import sys
from typing import Any

from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import FluidPressure, JointState

from pam_orthosis.control.guard import driven
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import VENT, voltage_of
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.nodes import messages, process
from pam_orthosis.nodes.layout import EVERYTHING, NodeSpec
from pam_orthosis.nodes.parameters import MACHINE, declare_rows, declare_settings, machine_of
from pam_orthosis.nodes.supervisor import ERROR_PREFIX

SPEC = NodeSpec("dummy_driver", "dummy_driver", EVERYTHING)
SILENCE_PERIODS = 20
INFINITE = float("inf")
SPIN_SECONDS = 0.2  # the events executor dispatches nothing without a time-out


class EmulatedHardware:
    """Stands for the devices: sensors that can be read, valves that take commands."""

    def __init__(self, parameters: Parameters):
        self.period_ns = round(parameters.scenario.control_period * 1e9)
        self._valve = parameters.valve
        self._plant = Plant(parameters)

    def read(self) -> tuple[float, ...]:
        """Return the coordinate, rad or m, and the absolute pressure of each actuator, Pa."""
        return tuple(self._plant.measure())

    def write(self, line: int, spool: float, at_ns: int) -> None:
        """Set the spool of an actuator's valve (its number), -1 to 1, at an instant since the start."""
        self._plant.take(line, driven(voltage_of(spool, self._valve), self._valve), at_ns)

    def vent(self) -> None:
        """Let the air out of all actuators."""
        for line in range(len(self._plant.machine.names)):
            self.write(line, VENT, self._plant.time_ns)

    def live_on(self, periods: int) -> None:
        """Let emulated time pass; devices just live on."""
        for _ in range(periods):
            self._plant.live_on()


class DummyDriver(Node):
    """Publishes a sample each period; sets a valve as soon as its command comes, vents if none come."""

    def __init__(self) -> None:
        super().__init__("dummy_driver")
        self._machine = machine_of(declare_settings(self, MACHINE))
        self._hardware = EmulatedHardware(declare_rows(self, self._machine, SPEC))
        self._joint = self.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
        self._pressures = [
            self.create_publisher(FluidPressure, f"{name}/pressure", qos_profile_sensor_data)
            for name in self._machine.names
        ]
        self._silent: dict[int, int] = {}  # periods since each valve's last command; none has come yet
        for line, name in enumerate(self._machine.names):
            self.create_subscription(JointState, f"{name}/valve_command", self._receiver(line), 10)
        self._first_ns, self._passed = self.get_clock().now().nanoseconds, 0
        self.create_timer(self._hardware.period_ns * 1e-9, self._tick)

    def _receiver(self, line: int):
        def receive(message: JointState) -> None:
            if message.position and abs(message.position[0]) < INFINITE:  # nor is NaN
                self._hardware.write(line, message.position[0], self._elapsed_ns())
                self._silent = {**dict.fromkeys(range(len(self._pressures)), 0), **self._silent, line: 0}

        return receive

    def vent(self) -> None:
        """Leave the hardware safe."""
        self._hardware.vent()

    def _tick(self) -> None:
        """Take the sample of the nearest period; skip those that are overdue, whose time has passed."""
        due = (self._elapsed_ns() + self._hardware.period_ns // 2) // self._hardware.period_ns
        if due > self._passed:
            self._act(due - self._passed)
            self._passed = due
            self._publish(self._first_ns + due * self._hardware.period_ns)

    def _elapsed_ns(self) -> int:
        return self.get_clock().now().nanoseconds - self._first_ns

    def _publish(self, stamp_ns: int) -> None:
        place, *pressures = self._hardware.read()
        self._joint.publish(messages.joint_state(stamp_ns, [self._machine.name], position=[place]))
        for publisher, name, pressure in zip(self._pressures, self._machine.names, pressures, strict=True):
            publisher.publish(messages.fluid_pressure(stamp_ns, name, pressure))

    def _act(self, periods: int) -> None:
        """Let periods pass; vent all actuators when the commands of one have stopped coming."""
        self._silent = {line: count + periods for line, count in self._silent.items()}
        if max(self._silent.values(), default=0) > SILENCE_PERIODS:
            self._hardware.vent()
        self._hardware.live_on(periods)


def main() -> int:
    """Run the driver until SIGINT or SIGTERM."""
    caught = process.caught_signals()
    try:
        process.start_ros()
        driver = DummyDriver()
    except OrthosisError as error:
        print(f"{ERROR_PREFIX}{error}", file=sys.stderr)
        return error.exit_status
    executor: Any = EventsExecutor()
    executor.add_node(driver)
    try:
        while not caught:
            executor.spin_once(timeout_sec=SPIN_SECONDS)
    finally:  # whatever has happened
        driver.vent()
        process.leave([driver])
    return 0


if __name__ == "__main__":
    sys.exit(main())
