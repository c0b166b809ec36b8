# SPDX-License-Identifier: Apache-2.0
"""Node: records all topics of the table into a bag, in one order whatever the arrival was."""

from __future__ import annotations

import struct
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path

from rclpy.duration import Duration

from pam_orthosis.bag.record import BagWriter, canonical, run_metadata
from pam_orthosis.bag.steps import Message, StepCollector
from pam_orthosis.bag.topics import RECORDER, SECOND_NS, Topic
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes import graph, messages
from pam_orthosis.nodes.parameters import Setting
from pam_orthosis.nodes.supervisor import NOTE_PREFIX

QUEUE_DEPTH = 5000
LOCKSTEP_HORIZON = 1000
GRACE_NS = SECOND_NS // 2
LOOK_SECONDS = 0.05
ACK_SECONDS, ACK_WAITS = 0.2, 5
_STAMP = struct.Struct("<iI")


class BagRecorder(graph.GraphNode):
    """Writes each step when it is complete, and tells the plant how far the bag reaches.

    Serialised messages are written as they arrive. Each recorded type begins with its stamp, right
    behind the four bytes of encapsulation.
    """

    def __init__(self) -> None:
        folder = Setting("recording", "folder of the new bag")
        scenario = Setting("default", "name of the scenario, for the bag's metadata")
        silence = Setting(5.0, "wall time without a sample after which a run in real time fails [s]")
        settings = {"directory": folder, "scenario_name": scenario, "sample_timeout": silence}
        super().__init__(RECORDER, settings)
        horizon = SECOND_NS // self.period_ns if self.realtime else LOCKSTEP_HORIZON
        self._steps = StepCollector(self.period_ns, horizon, self.topics, self.realtime)
        self._run_ns = round(self.parameters.scenario.duration * 1e9 / self.period_ns) * self.period_ns
        self._end_ns = None if self.realtime else self._run_ns
        self._writer = BagWriter(
            Path(self.settings["directory"]),
            run_metadata(self.parameters, self.settings["scenario_name"]),
        )
        self._names: dict[str, str] = {}
        for topic in filter(lambda topic: topic.recorded, self.topics.values()):
            subscription = self.listen_to(topic.name, self._receiver(topic), depth=QUEUE_DEPTH, raw=True)
            self._names[topic.name] = subscription.topic_name
            self._writer.add_topic(subscription.topic_name, topic.type)
        self._acknowledged_ns = -1
        self._recorded = self.publish_to("recorded")
        self._end = self.publish_to("end")
        self._sampled, self._newest_ns = time.monotonic(), 0
        self.create_timer(LOOK_SECONDS, self._look)

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
        tick = topic.name == ("joint_states" if self.realtime else "/clock")

        def receive(data: bytes) -> None:
            self.pulse()
            seconds, nanoseconds = _STAMP.unpack_from(data, 4)
            stamp_ns = seconds * SECOND_NS + nanoseconds
            if tick:
                self._sampled, self._newest_ns = time.monotonic(), stamp_ns
            if self.ended or (self._end_ns is not None and stamp_ns >= self._end_ns):
                return  # a reference is published ahead, and a driver does not end with the run
            # in real time no two runs are alike, and there is better use for the time
            data = bytes(data) if self.realtime else canonical(data, topic.type)
            self._steps.add(Message(topic.name, stamp_ns, data))
            self._write(self._steps.complete())
            if tick:
                self._end_ns = self._end_ns or stamp_ns + self._run_ns
                self.step_done(stamp_ns)

        return receive

    def _write(self, recorded: Iterable[Message]) -> None:
        for message in recorded:
            self._writer.write(self._names[message.topic], message.stamp_ns, message.data)

    def _look(self) -> None:
        """Acknowledge what is recorded; end the run when all of it is."""
        if self._steps.done_ns > self._acknowledged_ns:
            self._acknowledged_ns = self._steps.done_ns
            self._recorded.publish(messages.time(self._acknowledged_ns))
        if self._end_ns is None or self.ended:
            return
        if self._steps.done_ns >= self._end_ns - self.period_ns or (self.realtime and self._late()):
            self._finish()

    def _late(self) -> bool:
        """Whether, in real time, there is nothing more to wait for: what is later has come already.

        The clock does not tell: on a busy machine much may have arrived that nobody has looked at yet.
        """
        silence, limit = time.monotonic() - self._sampled, self.settings["sample_timeout"]
        if silence > limit and self._newest_ns < self._end_ns - self.period_ns:
            raise RunFailed(f"no sample on joint_states for {limit:g} s: does the driver run?")
        return self._newest_ns >= self._end_ns + GRACE_NS or silence > limit

    def _finish(self) -> None:
        for message in self._steps.rest():
            self._write([message])
            self.pulse()
        self._end.publish(messages.time(self._steps.done_ns))
        for _ in range(ACK_WAITS):
            if self._end.wait_for_all_acked(Duration(seconds=ACK_SECONDS)):
                break
            self.pulse()
        self.ended = True

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
