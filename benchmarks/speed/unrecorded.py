# SPDX-License-Identifier: Apache-2.0
"""The graph's own nodes without a recorder, to see what recording costs; for measurements only.

python -m speed.unrecorded NODE... --ros-args ...
"""

from __future__ import annotations

import sys
from dataclasses import replace

from pam_orthosis.bag import topics
from pam_orthosis.bag.topics import RECORDER, Topic
from pam_orthosis.nodes import composed, graph, pace, plant_simulator


class Unrecorded(Topic):
    """A topic to which no recorder listens."""

    @property
    def subscribers(self) -> tuple[str, ...]:
        """The nodes that listen."""
        return self.consumers


def table(*_mode: bool) -> dict[str, Topic]:
    """Return the table of lockstep without the recorder."""
    made = {}
    for name, topic in topics.table().items():
        others = tuple(node for node in topic.producers if node != RECORDER)
        made[name] = Unrecorded(**vars(replace(topic, producers=others)))
    return made


def main() -> int:
    """Run nodes: nobody waits for a recorder, and the run ends when it is killed."""
    graph.table = table
    plant_simulator.NODES = tuple(node for node in topics.NODES if node != RECORDER)
    pace.MAX_UNRECORDED_STEPS = pace.MAX_UNRECORDED_NS = 1 << 62
    return composed.main()


if __name__ == "__main__":
    sys.exit(main())
