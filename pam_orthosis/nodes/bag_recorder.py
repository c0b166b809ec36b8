# SPDX-License-Identifier: Apache-2.0
"""Node: records all topics of the table into a bag, in one order whatever the arrival was."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from pam_orthosis.bag.record import BagWriter, canonical, run_metadata
from pam_orthosis.bag.steps import Message, StepCollector
from pam_orthosis.bag.topics import RECORDED, RECORDER, SECOND_NS, Topic
from pam_orthosis.nodes import graph, messages
from pam_orthosis.nodes.parameters import Setting
from pam_orthosis.nodes.supervisor import NOTE_PREFIX

QUEUE_DEPTH = 5000
ACKNOWLEDGE_SECONDS = 0.05
_STAMP = struct.Struct("<iI")


class BagRecorder(graph.GraphNode):
    """Writes each step when it is complete, and tells the plant how far the bag reaches.

    Serialised messages are written as they arrive. Each recorded type begins with its stamp, right
    behind the four bytes of encapsulation.
    """

    def __init__(self) -> None:
        folder = Setting("recording", "folder of the new bag")
        scenario = Setting("default", "name of the scenario, for the bag's metadata")
        super().__init__(RECORDER, {"directory": folder, "scenario_name": scenario})
        self._steps = StepCollector(self.period_ns)
        self._writer = BagWriter(
            Path(self.settings["directory"]),
            run_metadata(self.parameters, self.settings["scenario_name"]),
        )
        self._names: dict[str, str] = {}
        for topic in RECORDED:
            subscription = self.listen_to(topic.name, self._receiver(topic), depth=QUEUE_DEPTH, raw=True)
            self._names[topic.name] = subscription.topic_name
            self._writer.add_topic(subscription.topic_name, topic.type)
        self._acknowledged_ns = -1
        self._recorded = self.publish_to("recorded")
        self.create_timer(ACKNOWLEDGE_SECONDS, self._acknowledge)

    def health(self) -> dict[str, int]:
        """Count messages that came twice."""
        return {"duplicates": self._steps.duplicates}

    def close(self) -> None:
        """Close the bag; a run that was cut short leaves its incomplete last step in it too."""
        if not self.ended:
            self._report_missing()
            self._write(self._steps.rest())
        self._writer.close()

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        def receive(data: bytes) -> None:
            if self.ended:  # published ahead, for an instant after the end
                return
            seconds, nanoseconds = _STAMP.unpack_from(data, 4)
            stamp_ns = seconds * SECOND_NS + nanoseconds
            self._steps.add(Message(topic.name, stamp_ns, canonical(data, topic.type)))
            self._write(self._steps.complete())
            if topic.name == "/clock":
                self.step_done(stamp_ns)

        return receive

    def _write(self, recorded: Iterable[Message]) -> None:
        for message in recorded:
            self._writer.write(self._names[message.topic], message.stamp_ns, message.data)

    def _acknowledge(self) -> None:
        if self._steps.done_ns > self._acknowledged_ns:
            self._acknowledged_ns = self._steps.done_ns
            self._recorded.publish(messages.time(self._acknowledged_ns))

    def _report_missing(self) -> None:
        """Say which message broke the chain: the first that the last step lacks, causes first."""
        if missing := self._steps.missing():
            print(
                f"{NOTE_PREFIX}the last step lacks {missing[0].name} of {missing[0].producers[0]}",
                file=sys.stderr,
            )


def main() -> int:
    """Run the node."""
    return graph.run(lambda: [BagRecorder()])


if __name__ == "__main__":
    sys.exit(main())
