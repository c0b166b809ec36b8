# SPDX-License-Identifier: Apache-2.0
"""What the nodes of a run must have in common: how it is made, and every parameter that two of them know."""

import json
import time
from collections.abc import Collection, Mapping
from typing import Any

from std_msgs.msg import String

ALIKE = ("realtime", "with_plant", "replay")  # of a node's settings


class Agreement:
    """Compares what this node was started with with what the others say that they were.

    Args:
        node: full name of this node.
        role: that it has in the table of topics.
        values: its settings and parameters by name.
        others: roles of the nodes that are waited for.

    Attributes:
        message: what this node says of itself.
        absent: roles of the nodes that have not been heard.
        text: the contradiction, if there is one.
        again: somebody was heard twice: he was started again.
    """

    def __init__(self, node: str, role: str, values: Mapping[str, Any], others: Collection[str]):
        self._node, self._role, self._values = node, role, values
        self.message = String(data=json.dumps({"node": node, "role": role, "values": dict(values)}))
        self.absent = [other for other in others if other != role]
        self.text, self._found, self.again = "", 0.0, False

    def add(self, message: String) -> None:
        """Take what another node was started with; the first contradiction counts."""
        try:
            said = json.loads(message.data)
            node, role, values = said["node"], said["role"], said["values"]
            different = [key for key, value in self._values.items() if values.get(key, value) != value]
        except (ValueError, TypeError, AttributeError, KeyError):
            return  # no node of this package
        self.again = self.again or role not in (self._role, *self.absent)
        self.absent = [other for other in self.absent if other != role]
        if different and not self.text:
            key = different[0]
            more = f" (and {len(different) - 1} more)" if len(different) > 1 else ""
            self.text = (
                f"{key} is {self._values[key]} in {self._node} and {values[key]} in {node}{more}:"
                " give all nodes of a run the same parameters"
            )
            self._found = time.monotonic()

    def known_to_all(self) -> bool:
        """Whether the other node has had the time to hear of the contradiction too."""
        return time.monotonic() - self._found > 1.0
