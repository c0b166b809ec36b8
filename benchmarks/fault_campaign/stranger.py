# SPDX-License-Identifier: Apache-2.0
"""A ROS node of somebody else, in a process of its own: forges messages, a service or the name of a node.

python stranger.py publish TOPIC TYPE latched|kept|volatile | serve SERVICE | call NAME
`kept` is as `latched`, but waits for a listener.
Prints `spoke SECONDS` (since 1970) at its first message, or when it is there; lives until it is killed.
"""

from __future__ import annotations

import json
import sys
import time
from importlib import import_module
from typing import Any

import rclpy
from rclpy.qos import QoSDurabilityPolicy, QoSProfile
from std_srvs.srv import Trigger

from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

PERIOD_S = 0.02
ANGLE_RAD, PRESSURE_PA, TORQUE_N_M, FLOW_KG_S = 1.0, 6e5, 10.0, 0.01
AHEAD_S = 0.05
LISTENER_S = 60.0  # of patience


def forged(type_name: str, stamp_s: float) -> list[Any]:
    """Return messages of a type that would do harm if somebody acted upon them."""
    package, _, name = type_name.split("/")
    kind = getattr(import_module(f"{package}.msg"), name)
    if name == "String":
        nothing = {"settings": {}, "parameters": {}}
        return [kind(data=role) for role in TABLE.nodes] + [
            kind(data=json.dumps({"role": role, "node": "/stranger", **nothing})) for role in TABLE.nodes
        ]
    message = kind()
    stamp = message if name == "Time" else message.clock if name == "Clock" else message.header.stamp
    stamp.sec, stamp.nanosec = int(stamp_s), int(stamp_s % 1 * 1e9)
    if name == "JointState":
        message.name, message.position = ["knee"], [ANGLE_RAD]
        message.velocity, message.effort = [0.0], [TORQUE_N_M]
    if name == "Vector3Stamped":
        message.vector.x = FLOW_KG_S
    if name == "FluidPressure":
        message.fluid_pressure = PRESSURE_PA
    return [message]


def speak(node: Any, topic: str, type_name: str, last: str) -> None:
    """Publish on a topic for ever, of instants near the present one by the wall clock and by the run's."""
    kept = last != "volatile"
    durability = QoSDurabilityPolicy.TRANSIENT_LOCAL if kept else QoSDurabilityPolicy.VOLATILE
    kind = type(forged(type_name, 0.0)[0])
    publisher = node.create_publisher(kind, topic, QoSProfile(depth=200, durability=durability))
    until = time.monotonic() + LISTENER_S
    while last != "latched" and not publisher.get_subscription_count():
        if time.monotonic() > until:
            sys.exit(f"nobody who can hear {last} messages listens to {topic}")
        time.sleep(0.001)
    print(f"spoke {time.time()}", flush=True)
    began = time.monotonic()
    while True:
        for stamp_s in (time.monotonic() - began, time.time() + AHEAD_S):
            for message in forged(type_name, stamp_s):
                publisher.publish(message)
        time.sleep(PERIOD_S)


def main() -> None:
    """Do what the command line says."""
    act, name, *rest = sys.argv[1:]
    rclpy.init(args=[])
    node = rclpy.create_node(name if act == "call" else "stranger")
    if act == "publish":
        speak(node, name, rest[0], rest[1])
    if act == "serve":
        node.create_service(Trigger, name, lambda _request, response: response)
    print(f"spoke {time.time()}", flush=True)
    rclpy.spin(node)


if __name__ == "__main__":
    main()
