# SPDX-License-Identifier: Apache-2.0
"""Bags with known signals, written through the package's own writer."""

import json

import numpy as np
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.topics import SECOND_NS, Topics, resolve
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

PERIOD_NS = 5_000_000
ANGLE_TYPE = TABLE.by_name["joint_states"].type
STORE = get_typestore(Stores.ROS2_JAZZY)


def _type(name):
    return STORE.types[name]


def header(stamp_ns):
    time = _type("builtin_interfaces/msg/Time")(stamp_ns // SECOND_NS, stamp_ns % SECOND_NS)
    return _type("std_msgs/msg/Header")(time, "")


def joint_state(stamp_ns, name, position=(), velocity=(), effort=()):
    arrays = [np.array(values, dtype=float) for values in (position, velocity, effort)]
    return _type("sensor_msgs/msg/JointState")(header(stamp_ns), [name], *arrays)


def reference(stamp_ns, motion):
    """Return a trajectory of one point: a motion (angle, velocity)."""
    duration = _type("builtin_interfaces/msg/Duration")(0, 0)
    values = [np.array([value], dtype=float) for value in (*motion, 0.0)]
    point = _type("trajectory_msgs/msg/JointTrajectoryPoint")(*values, np.array([]), duration)
    return _type("trajectory_msgs/msg/JointTrajectory")(header(stamp_ns), ["knee"], [point])


def serialised_angle(stamp_ns, angle):
    return bytes(STORE.serialize_cdr(joint_state(stamp_ns, "knee", [angle]), ANGLE_TYPE))


def write(writer, topic, stamp_ns, message):
    data = STORE.serialize_cdr(message, TABLE.by_name[topic].type)
    writer.write(resolve(topic), stamp_ns, bytes(data))


def write_tracking_bag(folder, stamps, wanted, angle, parameters=None, drop_angle=()):
    """Write joint_states and reference; the angle is left out at the indices of `drop_angle`."""
    run = {"parameters": json.dumps(parameters), "scenario": "test"} if parameters else {}
    velocity = np.gradient(wanted, stamps * 1e-9)
    with BagWriter(folder, run) as writer:
        for topic in ("joint_states", "reference"):
            writer.add_topic(resolve(topic), TABLE.by_name[topic].type)
        for k, stamp_ns in enumerate(stamps.tolist()):
            if k not in drop_angle:
                write(writer, "joint_states", stamp_ns, joint_state(stamp_ns, "knee", [angle[k]]))
            write(writer, "reference", stamp_ns, reference(stamp_ns, (wanted[k], velocity[k])))
    return folder
