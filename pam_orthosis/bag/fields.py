# SPDX-License-Identifier: Apache-2.0
"""Do messages of a standard type have the field that a signal is read from?"""

from typing import Any

from rosbags.interfaces import Nodetype

from pam_orthosis.bag.cdr import store
from pam_orthosis.bag.topics import JOINT, MOTION, Signal
from pam_orthosis.errors import OrthosisError

HEADER = "std_msgs/msg/Header"


def check_field(signal: Signal) -> None:
    """Raise OrthosisError if no such signal, which is a number with a stamp, can be read from its type."""
    known = store().fielddefs
    if signal.type not in known:
        raise OrthosisError(f"{signal.name}: ROS 2 has no standard type {signal.type!r}")
    if dict(known[signal.type][1]).get("header") != (Nodetype.NAME, HEADER):
        raise OrthosisError(f"{signal.name}: messages of type {signal.type} have no header, so no stamp")
    node: Nodetype = Nodetype.NAME
    what: Any = f"{MOTION}Point" if signal.type == MOTION else signal.type
    for name in signal.field.split("."):
        inside = dict(known[what][1]) if node == Nodetype.NAME else {}
        if name not in inside:
            there = ", ".join(inside) or "none"
            raise OrthosisError(
                f"{signal.name}: {signal.type} has no field {signal.field!r}: there are {there}"
            )
        node, what = inside[name]
    if (signal.type in (JOINT, MOTION)) != bool(signal.joint):
        needed = "needs the name of a joint" if not signal.joint else "has no joints"
        raise OrthosisError(f"{signal.name}: a signal of type {signal.type} {needed}")
    if node != (Nodetype.SEQUENCE if signal.joint else Nodetype.BASE) or "string" in str(what):
        raise OrthosisError(f"{signal.name}: {signal.field} of {signal.type} is no number")
