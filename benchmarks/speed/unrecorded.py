# SPDX-License-Identifier: Apache-2.0
"""The graph's own nodes without a recorder, to see what recording costs; for measurements only.

python -m speed.unrecorded NODE... --ros-args ...
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

from pam_orthosis.bag.topics import RECORDER, Topic, Topics
from pam_orthosis.model.machine import Machine
from pam_orthosis.nodes import composed, pace, topic_node


class Unrecorded(Topic):
    """A topic to which no recorder listens."""

    @property
    def subscribers(self) -> tuple[str, ...]:
        """The nodes that listen."""
        return self.consumers


class UnrecordedTopics(Topics):
    """A table without the recorder."""

    def __init__(self, machine: Machine):
        super().__init__(machine)
        self.nodes = tuple(node for node in self.nodes if node != RECORDER)

    def of_run(self, *_mode: Any, **_more: Any) -> dict[str, Topic]:
        """Return the topics of lockstep."""
        made = {}
        for name, topic in super().of_run().items():
            others = tuple(node for node in topic.producers if node != RECORDER)
            made[name] = Unrecorded(**vars(replace(topic, producers=others)))
        return made


def main() -> int:
    """Run nodes: nobody waits for a recorder, and the run ends when it is killed."""
    topic_node.Topics = UnrecordedTopics
    pace.MAX_UNRECORDED_STEPS = pace.MAX_UNRECORDED_NS = 1 << 62
    return composed.main()


if __name__ == "__main__":
    sys.exit(main())
