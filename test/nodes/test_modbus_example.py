# SPDX-License-Identifier: Apache-2.0
"""The example of a driver that speaks Modbus TCP: it loses its terminal, vents, and comes back by command."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("pymodbus")
FOLDER = Path(__file__).resolve().parents[2] / "examples" / "modbus"
LIMIT_S = 120.0
FULL, EMPTY = 3e5, 1.2e5  # Pa


@contextmanager
def started(file, *words):
    """Run a file of the example."""
    process = subprocess.Popen([sys.executable, FOLDER / file, *words])
    try:
        yield process
    finally:
        process.terminate()
        assert process.wait(LIMIT_S) in (0, -signal.SIGTERM)


@pytest.fixture
def peer(stranger):
    """Return a node that sends both valves a command a few times a second, and keeps what the driver says."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.qos import qos_profile_sensor_data
    from sensor_msgs.msg import FluidPressure, JointState
    from std_srvs.srv import Trigger

    stranger.command, stranger.pressures, stranger.state, stranger.samples = 0.0, {}, "", 0
    senders = [
        stranger.create_publisher(JointState, f"{one}/valve_command", 10) for one in ("extensor", "flexor")
    ]

    def send():
        for sender in senders:
            sender.publish(JointState(position=[stranger.command]))

    def hear(name, message):
        stranger.samples += 1
        stranger.pressures[name] = message.fluid_pressure

    for name in ("extensor", "flexor"):
        stranger.create_subscription(
            FluidPressure, f"{name}/pressure", lambda m, name=name: hear(name, m), qos_profile_sensor_data
        )
    stranger.create_subscription(
        DiagnosticArray, "/diagnostics", lambda m: setattr(stranger, "state", m.status[0].message), 10
    )
    stranger.reset = stranger.create_client(Trigger, "/modbus_driver/reset")
    stranger.create_timer(0.02, send)
    return stranger


def test_the_driver_loses_its_terminal_vents_and_comes_back_by_command(peer):
    from std_srvs.srv import Trigger

    executor = rclpy.executors.SingleThreadedExecutor(context=peer.context)
    executor.add_node(peer)

    def until(condition):
        deadline = peer.get_clock().now().nanoseconds + LIMIT_S * 1e9
        while not condition():
            assert peer.get_clock().now().nanoseconds < deadline, (peer.state, peer.pressures)
            executor.spin_once(timeout_sec=0.1)

    def pressures(low, high):
        return len(peer.pressures) == 2 and all(low < one < high for one in peer.pressures.values())

    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # slow enough for any machine
    words = [
        "--ros-args",
        "-p",
        f"port:={port}",
        "-p",
        "scenario.control_period:=0.02",
        "-p",
        "deadline:=1.0",
    ]
    with (
        started("terminal.py", "--port", str(port), "--watchdog", "1.0") as terminal,
        started("driver.py", *words),
    ):
        peer.command = 0.3
        until(lambda: peer.state == "ready" and pressures(FULL, 1e6))
        os.kill(terminal.pid, signal.SIGUSR1)
        until(lambda: peer.state.startswith("disconnected"))
        before = peer.samples
        until(lambda: peer.state.startswith("fault: connected again after a loss"))
        until(lambda: peer.samples > before and pressures(0.0, EMPTY))  # though it is asked to fill
        assert peer.reset.wait_for_service(LIMIT_S)
        answer = peer.reset.call_async(Trigger.Request())
        until(answer.done)
        assert answer.result().success
        until(lambda: peer.state == "ready" and pressures(FULL, 1e6))
