# SPDX-License-Identifier: Apache-2.0
"""What a topic is to the middleware: quality of service and class of its messages."""

from functools import lru_cache
from importlib import import_module

from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy

QUEUE_DEPTH = 10


def qos(depth: int = QUEUE_DEPTH, latched: bool = False, reliable: bool = True) -> QoSProfile:
    """Return the quality of service of a topic: keep last; volatile and reliable if not said otherwise."""
    reliability = QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=reliability,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )


@lru_cache
def message_class(type_name: str) -> type:
    """Return the class of `package/msg/Type`."""
    package, _, name = type_name.split("/")
    found: type = getattr(import_module(f"{package}.msg"), name)
    return found
