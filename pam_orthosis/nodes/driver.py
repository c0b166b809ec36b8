# SPDX-License-Identifier: Apache-2.0
"""What drivers for `run --realtime --no-plant` have in common (docs/howto/driver.md)."""

import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from enum import Enum
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import FluidPressure, JointState
from std_srvs.srv import Trigger

from pam_orthosis.bag.topics import EMERGENCY_STOP
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.model.parameters import NOMINAL
from pam_orthosis.nodes import messages, process
from pam_orthosis.nodes.emergency import StopState
from pam_orthosis.nodes.layout import NodeSpec
from pam_orthosis.nodes.parameters import MACHINE, Setting, declare_rows, declare_settings, machine_of
from pam_orthosis.nodes.supervisor import ERROR_PREFIX
from pam_orthosis.nodes.transport import qos

SILENCE_PERIODS = 20
SETTINGS = {
    **MACHINE,
    "reconnect_time": Setting(0.2, "wall time between two attempts to reach the device [s]"),
    "deadline": Setting(
        0.1, "wall time that a sample may take to be read; then the device counts as lost [s]"
    ),
}


class State(Enum):
    """What a driver can do: the valves follow commands in READY alone, and are vented in all others."""

    DISCONNECTED = "disconnected"
    HOMING = "homing"
    READY = "ready"
    FAULT = "fault"


LEVELS = {
    State.READY: DiagnosticStatus.OK,
    State.HOMING: DiagnosticStatus.WARN,
    State.DISCONNECTED: DiagnosticStatus.ERROR,
    State.FAULT: DiagnosticStatus.ERROR,
}


class Driver(Node, ABC):
    """Publishes a sample each period while its device answers, and hands it the valves' commands.

    A subclass overrides `connect`, `read`, `write` and `vent`, and where its device asks for it `home` and
    `disconnect`. Each raises OSError (ConnectionError, TimeoutError) if the device does not answer; then the
    driver is DISCONNECTED, publishes no samples and tries `connect` again. A device that has come back after
    a loss is in FAULT: it stays vented until the service `~/reset`. No call may take longer than the setting
    `deadline`: give the protocol such a time-out.

    Args:
        name: of the node.
        settings: of the device, beside those that all drivers have.
        branches: of the parameters that the node may be given.

    Attributes:
        machine, parameters, settings: of the node.
        period_ns: from one sample to the next.
        state, reason: what it can do, and why no more than that.

    Raises:
        OrthosisError: unusable parameters.
    """

    def __init__(
        self, name: str, settings: Mapping[str, Setting] | None = None, branches: Sequence[str] = NOMINAL
    ) -> None:
        super().__init__(name)
        self.settings = declare_settings(self, {**SETTINGS, **(settings or {})})
        self.machine = machine_of(self.settings)
        self.parameters = declare_rows(self, self.machine, NodeSpec(name, "driver", tuple(branches)))
        self.period_ns = round(self.parameters.scenario.control_period * 1e9)
        self.state, self.reason = State.DISCONNECTED, "not connected yet"
        self._homed, self._loss = False, ""  # since it was connected; why it was lost, until a reset
        self._lines = range(len(self.machine.names))
        self._joint = self.create_publisher(JointState, "joint_states", qos_profile_sensor_data)
        self._pressures = [
            self.create_publisher(FluidPressure, f"{one}/pressure", qos_profile_sensor_data)
            for one in self.machine.names
        ]
        self._health = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._counts = dict.fromkeys(("skipped_samples", "lost_connections", "silent_periods"), 0)
        self._commands: dict[int, float] = {}
        self._silent: dict[int, int] = {}  # periods since each valve's last command; none has come yet
        for line, one in enumerate(self.machine.names):
            self.create_subscription(JointState, f"{one}/valve_command", partial(self._on_command, line), 10)
        self._stop_state = StopState()  # by a node of the graph
        self.create_subscription(DiagnosticArray, EMERGENCY_STOP, self._on_stop_state, qos(latched=True))
        self.create_service(Trigger, "~/emergency_stop", self._on_stop)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self._first_ns, self._passed = self.get_clock().now().nanoseconds, 0
        self._connect_due = 0.0
        self.create_timer(self.period_ns * 1e-9, self._tick)
        self.create_timer(1.0, self._report)

    @abstractmethod
    def connect(self) -> None:
        """Reach the device."""

    @abstractmethod
    def read(self) -> Sequence[float]:
        """Return the coordinate (rad or m) and the absolute pressure of each actuator (Pa), read now."""

    @abstractmethod
    def write(self, line: int, spool: float) -> None:
        """Set the spool of an actuator's valve (its number) to a relative position, -1 vent to 1 fill."""

    @abstractmethod
    def vent(self) -> None:
        """Let the air out of all actuators."""

    def home(self) -> bool:
        """Do the next part of what the device needs before use, vented; return whether that was all.

        It is called once a period.
        """
        return True

    def disconnect(self) -> None:
        """Release the device."""

    def fault(self, reason: str) -> None:
        """Vent until the service `~/reset`: the device, or somebody, says that something is wrong."""
        self.state, self.reason = State.FAULT, reason
        self.get_logger().error(f"vented until reset: {reason}")
        self._guarded(self.vent)

    def leave(self) -> None:
        """Leave the device vented, whatever has happened."""
        with suppress(OSError):
            self.vent()
        with suppress(OSError):
            self.disconnect()

    @property
    def elapsed_ns(self) -> int:
        """The time since the first period began."""
        return self.get_clock().now().nanoseconds - self._first_ns

    def _tick(self) -> None:
        """Take the sample of the nearest period; skip those that are overdue, whose time has passed."""
        due = (self.elapsed_ns + self.period_ns // 2) // self.period_ns
        passed, self._passed = due - self._passed, max(due, self._passed)
        if passed <= 0:
            return
        self._silent = {line: count + passed for line, count in self._silent.items()}
        if self.state is State.DISCONNECTED:
            self._try_to_connect()
        else:
            self._counts["skipped_samples"] += passed - 1
            self._guarded(self._live, self._first_ns + due * self.period_ns)

    def _live(self, stamp_ns: int) -> None:
        """Vent if that is due, and publish a sample."""
        if self.state is State.HOMING and self.home() and self.state is State.HOMING:
            self._be_ready()
        self._counts["silent_periods"] += self._is_silent()
        if not self._follows():
            self.vent()
        began = time.monotonic()
        place, *pressures = self._numbers(self.read())
        if time.monotonic() - began > self.settings["deadline"]:
            raise TimeoutError(f"a sample took longer than {self.settings['deadline']:g} s")
        self._joint.publish(messages.joint_state(stamp_ns, [self.machine.name], position=[place]))
        for publisher, name, pressure in zip(self._pressures, self.machine.names, pressures, strict=True):
            publisher.publish(messages.fluid_pressure(stamp_ns, name, pressure))

    def _numbers(self, sample: Sequence[float]) -> list[float]:
        """Return a sample as numbers; vent and take the device for lost if it is none."""
        with suppress(TypeError, ValueError):
            numbers = [float(number) for number in sample]
            if len(numbers) == 1 + len(self._pressures):
                return numbers
        self.vent()
        raise ConnectionError(f"read() returned {sample!r}, not a place and {len(self._pressures)} pressures")

    def _is_silent(self) -> bool:
        return max(self._silent.values(), default=0) > SILENCE_PERIODS

    def _follows(self) -> bool:
        """Return whether the valves follow their commands, all of which have come of late."""
        return self.state is State.READY and not self._is_silent() and not self._stop_state.active

    def _try_to_connect(self) -> None:
        if time.monotonic() < self._connect_due:
            return
        self._connect_due = time.monotonic() + self.settings["reconnect_time"]
        if self._guarded(self.connect):
            self.state, self._homed = State.HOMING, False
            self.get_logger().info("connected")

    def _be_ready(self) -> None:
        """Be ready, but after a loss: what the device did meanwhile somebody has to look at."""
        self._homed = True
        if self._loss:
            self.fault(f"connected again after a loss: {self._loss}")
        else:
            self.state, self.reason = State.READY, ""
            self.get_logger().info("ready")

    def _guarded(self, call: Callable[..., None], *arguments: Any) -> bool:
        """Call the device; return whether it answers, and be disconnected if not."""
        try:
            call(*arguments)
        except OSError as error:
            self._lose(error)
            return False
        return True

    def _lose(self, error: OSError) -> None:
        """Be disconnected; after a loss its reason stands, whatever later attempts to connect fail of."""
        reason = str(error) or type(error).__name__
        if self.state is State.DISCONNECTED:
            self.reason = self._loss or reason
            return
        self._counts["lost_connections"] += 1
        self.get_logger().error(f"connection lost: {reason}")
        self.leave()
        self.state, self.reason, self._connect_due = State.DISCONNECTED, reason, 0.0
        self._loss = reason

    def _on_command(self, line: int, message: JointState) -> None:
        spool = message.position[0] if message.position else float("nan")
        if not abs(spool) < float("inf"):  # nor is NaN
            return
        was_silent = not self._follows()
        self._commands[line] = min(max(spool, VENT), -VENT)
        self._silent = {**dict.fromkeys(self._lines, 0), **self._silent, line: 0}
        if self._follows():
            for each in self._commands if was_silent else (line,):
                if not self._guarded(self.write, each, self._commands[each]):
                    break

    def _on_stop_state(self, report: DiagnosticArray) -> None:
        """Vent, or not any more, as the latched topic says."""
        self._stop_state.hear(report)

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self.state is not State.DISCONNECTED:
            self.fault("emergency stop")
        response.success = self.state is State.FAULT
        response.message = "vented until reset" if response.success else self.reason
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = self.state is State.FAULT, self.state.value
        if response.success and self._homed:
            self.state, self.reason, self._loss = State.READY, "", ""
            response.message = "the valves follow their commands"
        elif response.success:
            self.state, self.reason = State.HOMING, self._loss
            response.message = "the device homes before its valves follow their commands"
        self.get_logger().info(f"reset: {response.message}")
        return response

    def _report(self) -> None:
        stamp_ns, name = self.get_clock().now().nanoseconds, self.get_fully_qualified_name().lstrip("/")
        message = self.state.value + (f": {self.reason}" if self.reason else "")
        level = DiagnosticStatus.ERROR if self._stop_state.active else LEVELS[self.state]
        counts = {**self._counts, "emergency_stop": self._stop_state.active}
        self._health.publish(messages.diagnostics(stamp_ns, name, level, message, counts))


def run(make: Callable[[], Driver]) -> int:
    """Run a driver until SIGINT or SIGTERM, and leave its device vented; return the exit status."""
    caught = process.caught_signals()
    try:
        process.start_ros()
        driver = make()
    except OrthosisError as error:
        print(f"{ERROR_PREFIX}{error}", file=sys.stderr)
        return error.exit_status
    try:
        process.spin_while(driver, lambda: not caught)
    finally:  # whatever has happened
        driver.leave()
        process.leave([driver])
    return 0
