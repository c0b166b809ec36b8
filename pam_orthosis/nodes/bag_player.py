# SPDX-License-Identifier: Apache-2.0
"""Node: feeds a recorded bag to other nodes, instant by instant, and records what they answer.

It takes the place of all peers of these nodes: what they hear comes from the bag, what they say goes
to topics under `replayed/`. The next instant is fed when all that is due for this one has come, so
that the answers depend on the bag and on the nodes alone.
"""

from collections.abc import Callable
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from pam_orthosis.bag.cdr import serialised_stamp_ns
from pam_orthosis.bag.record import BagWriter
from pam_orthosis.bag.script import Instant, Script, held_ns
from pam_orthosis.bag.topics import CLOCK, DIAGNOSTICS, RECORDER, SECOND_NS
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes import graph, messages, process, transport
from pam_orthosis.nodes.launch import PLAYER, REPLAYED
from pam_orthosis.nodes.pace import MAX_UNRECORDED_NS
from pam_orthosis.nodes.parameters import Setting
from pam_orthosis.nodes.silence import Silence


class BagPlayer(graph.GraphNode):
    """Feeds, listens, compares nothing: that is left to who reads both bags."""

    def __init__(self) -> None:
        settings = {
            "bag": Setting("", "bag to feed"),
            "namespace": Setting("", "of the leg in the bag"),
            "nodes": Setting("", "names of the nodes that are fed, separated by commas"),
            "directory": Setting("answers", "folder of the new bag with the answers"),
            "answer_timeout": Setting(5.0, "wall time without an answer after which the replay fails [s]"),
        }
        super().__init__(PLAYER, settings, role=RECORDER)

    def configure(self) -> None:
        """Open both bags, feed and listen."""
        super().configure()
        chosen = self.settings["nodes"].split(",")
        bag, leg = Path(self.settings["bag"]), self.settings["namespace"]
        self._script = Script(bag, leg, chosen, held_ns(self.parameters), self.beside)
        self._instants = self._script.instants()
        self._now: Instant | None = None
        self._count = 0
        # instants at once: half of what the plant may be ahead
        self._acknowledged = max(1, min(20, MAX_UNRECORDED_NS // self.period_ns // 2))
        self._answers: dict[tuple[str, int], bytes] = {}
        self._writer = BagWriter(Path(self.settings["directory"]))
        self._feeds = {topic: self._feed_to(topic, n) for topic, n in self._script.fed_topics().items()}
        for node in self._script.nodes:
            for topic in self._script.outputs(node):
                self._hear(topic)
            for topic in self._script.outputs(node, recorded=False):  # the node waits for a listener
                self._listen_aside(topic, lambda _answer: None)
        self._recorded, self._end = self._publisher_of("recorded"), self._publisher_of("end")
        self._absent = set(self._script.nodes)
        self.listen_to("ready", self._on_ready, latched=True)
        # the nodes wait for a listener; the player waits for none of them, since it may feed a few only
        self.create_subscription(DiagnosticArray, DIAGNOSTICS, lambda _report: None, transport.qos())
        self._silence = Silence()
        self.wall_timer(0.25, self._watch)

    def started(self) -> None:
        """Speak for all the nodes that are not there: the plant waits for them."""
        for name in set(self.table.nodes) - set(self._script.nodes):
            self.say_ready(name)
        self._begin()

    def close(self) -> None:
        """Close the bag of answers."""
        self._writer.close()

    def _feed_to(self, topic: str, listeners: int) -> Publisher:
        kind = transport.message_class(self.topics[topic].type)
        publisher = self.create_publisher(kind, topic, transport.qos())
        there = lambda: publisher.get_subscription_count() >= listeners  # noqa: E731
        self.barrier.await_peer(f"a listener on {topic}", there)
        return publisher

    def _publisher_of(self, topic: str) -> Publisher:
        return self.create_publisher(transport.message_class(self.topics[topic].type), topic, transport.qos())

    def _hear(self, topic: str) -> None:
        self._listen_aside(topic, self._receiver(topic))
        self._writer.add_topic(f"/{topic.lstrip('/')}", self.topics[topic].type)

    def _listen_aside(self, topic: str, receive: Callable[[bytes], None]) -> None:
        kind = transport.message_class(self.topics[topic].type)
        name = f"{REPLAYED}/{topic.lstrip('/')}"
        self.create_subscription(kind, name, receive, transport.qos(), raw=True)

    def _receiver(self, topic: str) -> Callable[[bytes], None]:
        def receive(data: bytes) -> None:
            self._answers[topic, serialised_stamp_ns(data)] = bytes(data)
            if self._now:
                self._go_on(self._now)

        return receive

    def _on_ready(self, message: String) -> None:
        self._absent.discard(message.data)
        self._begin()

    def _begin(self) -> None:
        """Feed the first instant once all are there, this player too."""
        if self.active and not self._absent and self._now is None:
            self._go_on(self._feed(next(self._instants)))

    def _go_on(self, now: Instant) -> None:
        """Feed on from an instant for as long as nothing is missing."""
        while not self.ended and not self._missing(now):
            for topic in now.due:
                data = self._answers.pop((topic, now.stamp_ns))
                self._writer.write(f"/{topic.lstrip('/')}", now.stamp_ns, data)
            self.step_done(now.stamp_ns)
            now = self._feed(next(self._instants, None) or self._over(now))

    def _missing(self, now: Instant) -> list[str]:
        return [topic for topic in now.due if (topic, now.stamp_ns) not in self._answers]

    def _feed(self, now: Instant) -> Instant:
        """Feed an instant, which is the present one from now on."""
        self._silence.broken = True
        self._now = now
        if self._count % self._acknowledged == 0:
            self._recorded.publish(messages.time(now.stamp_ns))
        self._count += 1
        for topic, data in now.fed:
            own = topic == CLOCK
            self._feeds[topic].publish(Clock(clock=messages.time(now.stamp_ns)) if own else data)
        return now

    def _over(self, last: Instant) -> Instant:
        """Keep answers that were not waited for, references of samples that were skipped; say the end."""
        for (topic, stamp_ns), data in sorted(self._answers.items()):
            if stamp_ns in self._script.messages[topic]:
                self._writer.write(f"/{topic.lstrip('/')}", stamp_ns, data)
        self._end.publish(messages.time(last.stamp_ns))
        self._end.wait_for_all_acked(Duration(seconds=1.0))
        self.ended = True
        return Instant(last.stamp_ns, [], [])

    def _watch(self) -> None:
        limit = self.settings["answer_timeout"]
        if self._now and not self.ended and self._silence.look() > limit:
            topics = self._missing(self._now)
            producers = sorted({self.topics[topic].producers[0] for topic in topics})
            who, what = " and ".join(producers), " and ".join(topics)
            at = f"at {self._now.stamp_ns / SECOND_NS:.3f} s for {limit:g} s"
            self.fail(RunFailed(f"{who} did not answer on {what} {at}"))


def main() -> int:
    """Run the node."""
    return process.run(lambda: [BagPlayer()])
