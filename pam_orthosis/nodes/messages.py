# SPDX-License-Identifier: Apache-2.0
"""Messages of the graph from plain numbers and back."""

from collections.abc import Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3, Vector3Stamped, WrenchStamped
from sensor_msgs.msg import FluidPressure, JointState, TimeReference
from std_msgs.msg import Header
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.control.reference import Motion

MOTION = [f"points[0].{field}[0]" for field in ("positions", "velocities", "accelerations")]
PRESSURE, FLOW, SPOOL = ["fluid_pressure"], ["vector.x"], ["position[0]"]
UNKNOWN, NUMBERS = float("nan"), ("position", "velocity", "effort")
# the numbers of a wrench before and behind a torque about y or a force along x, as the table of signals says
AROUND = {"rotation": ((0.0,) * 4, (0.0,)), "translation": ((), (0.0,) * 5)}


def time(stamp_ns: int) -> Time:
    """Return a ROS time."""
    return Time(sec=stamp_ns // SECOND_NS, nanosec=stamp_ns % SECOND_NS)


def nanoseconds(stamp: Time) -> int:
    """Return a ROS time in nanoseconds."""
    return int(stamp.sec * SECOND_NS + stamp.nanosec)


def header(stamp_ns: int, frame: str = "") -> Header:
    """Return a header."""
    return Header(stamp=time(stamp_ns), frame_id=frame)


def joint_state(stamp_ns: int, names: Sequence[str], **numbers: Sequence[float]) -> JointState:
    """Return named, stamped scalars: position, velocity, effort; what is not known stays empty."""
    return JointState(header=header(stamp_ns), name=list(names), **numbers)


def frame_of(leg: str, name: str) -> str:
    """Return the frame of a part of a leg, which is named if it is one of several."""
    return f"{leg}/{name}" if leg else name


def fluid_pressure(stamp_ns: int, muscle: str, pressure: float, leg: str = "") -> FluidPressure:
    """Return an absolute pressure of an actuator, or of all if none is named, Pa, of unknown variance."""
    frame = frame_of(leg, f"{muscle}_muscle") if muscle else ""
    return FluidPressure(header=header(stamp_ns, frame), fluid_pressure=pressure)


def mass_flow(stamp_ns: int, actuator: str, flow: float, leg: str = "") -> Vector3Stamped:
    """Return a mass flow into an actuator (kg/s): along x of the frame of its port."""
    frame = frame_of(leg, f"{actuator}_port")
    return Vector3Stamped(header=header(stamp_ns, frame), vector=Vector3(x=flow))


def time_reference(stamp_ns: int, at_ns: int) -> TimeReference:
    """Return the instant at which something happened to the sample of a stamp."""
    return TimeReference(header=header(stamp_ns), time_ref=time(at_ns), source="system clock")


def wrench(stamp_ns: int, joint: str, leg: str = "") -> WrenchStamped:
    """Return what acts on a joint, in its frame: nothing yet."""
    return WrenchStamped(header=header(stamp_ns, frame_of(leg, joint)))


def trajectory(stamp_ns: int, joint: str, motion: Motion) -> JointTrajectory:
    """Return the motion of a joint (rad, rad/s, rad/s^2 or m, m/s, m/s^2) at the instant of the stamp."""
    place, velocity, acceleration = motion
    point = JointTrajectoryPoint(positions=[place], velocities=[velocity], accelerations=[acceleration])
    return JointTrajectory(header=header(stamp_ns), joint_names=[joint], points=[point])


def controller_state(stamp_ns: int, joint: str) -> JointState:
    """Return reference, feedback and error of a joint, and the effort that is asked for: nothing yet."""
    names = [f"{joint}_{what}" for what in ("reference", "feedback", "error", "output")]
    return joint_state(stamp_ns, names, **dict.fromkeys(NUMBERS, [UNKNOWN] * len(names)))


def diagnostics(
    stamp_ns: int, name: str, level: bytes, message: str, values: Mapping[str, Any]
) -> DiagnosticArray:
    """Return a node's report of its health: level, what it is about, and its figures."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    status = DiagnosticStatus(
        level=level, name=name, message=message, hardware_id="pam_orthosis", values=pairs
    )
    return DiagnosticArray(header=header(stamp_ns), status=[status])
