# SPDX-License-Identifier: Apache-2.0
"""Print who publishes on topics in the ROS domain of the environment: python -m ... TOPIC ..."""

import sys
import time
from collections.abc import Sequence

import rclpy
from rclpy.node import Node


def publishing(node: Node, topics: Sequence[str]) -> list[str]:
    """Return `node publishes on topic` for those that are known by now."""
    return sorted(
        f"{one.node_namespace.rstrip('/')}/{one.node_name} publishes on {topic}"
        for topic in topics
        for one in node.get_publishers_info_by_topic(topic)
        if "UNKNOWN" not in one.node_name
    )


def main() -> int:
    """Look until somebody is found, or long enough."""
    rclpy.init(args=[])
    node = rclpy.create_node("pam_orthosis_neighbours")
    until = time.monotonic() + 3.0  # everybody who is there has been discovered then
    while not (found := publishing(node, sys.argv[1:])) and time.monotonic() < until:
        time.sleep(0.1)
    print("\n".join(found[:1]))
    rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
