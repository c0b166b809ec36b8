# SPDX-License-Identifier: Apache-2.0
"""The floor of the graph: nodes of bare rclpy that pass the same messages round, without any mathematics.

    python -m speed.relay GRAPH:PERIOD_NS[xEVERY] RECORDED_FOLDER|- [realtime] NODE... --ros-args ...

GRAPH is `knee` or a device, whose nodes have namespaces. Topics, types and peers come from the tables of
topics, the executor is the graph's. A relay answers when all inputs of a stamp are there, with messages
that it made once. With EVERY, in lockstep, those of trajectory and
position controller do so at each such step only, and the others wait for them only then. What there is
beside that is needed by any lockstep: a start barrier, a recorder that the plant does not run away from, a
heartbeat. In real time a timer paces the plant, and what stands for the valves writes how old each sample was
when its answer left.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from collections.abc import Callable, Sequence
from copy import deepcopy
from pathlib import Path
from typing import NamedTuple

import rclpy
from builtin_interfaces.msg import Time
from mcap.writer import CompressionType, Writer
from rclpy.experimental import EventsExecutor
from rclpy.node import Node
from rclpy.task import Future
from rclpy.utilities import remove_ros_args
from std_msgs.msg import String

from pam_orthosis.bag import topics
from pam_orthosis.bag.cdr import serialised_stamp_ns
from pam_orthosis.bag.record import CHUNK_BYTES, message_definition
from pam_orthosis.bag.topics import PLANT, RECORDER, SLOW, TRAJECTORY, VALVE, Topic
from pam_orthosis.control.reference import Motion
from pam_orthosis.model.machines import KNEE
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.pace import MAX_UNRECORDED_STEPS
from pam_orthosis.nodes.supervisor import HEARTBEAT_VARIABLE
from pam_orthosis.nodes.transport import message_class, qos
from speed.tables import nodes, step_topics

REALTIME, AGES, KEPT_AGES = "realtime", "_ages.json", 50
FLOW = "/mass_flow"
RECORDER_DEPTH, ACKNOWLEDGED_STEPS = 5000, 10


EXAMPLES = {
    topics.TRUTH: messages.joint_state(0, ["knee", "e", "f"], **dict.fromkeys(messages.NUMBERS, [1.0] * 3)),
    "estimate": messages.joint_state(0, ["knee"], position=[1.0], velocity=[1.0]),
    "controller_state": messages.controller_state(0, "knee"),
    topics.JOINT: messages.joint_state(0, ["knee"], position=[1.0]),
    topics.PRESSURE: messages.fluid_pressure(0, "extensor", 1.0),
    topics.VECTOR: messages.mass_flow(0, "extensor", 1.0),
    topics.MOTION: messages.trajectory(0, "knee", Motion(1.0, 1.0, 1.0)),
    topics.WRENCH: messages.wrench(0, "knee"),
}


def filled(topic: Topic):
    """Return a message with as many numbers as the graph's own has."""
    example = EXAMPLES.get(topic.name.rpartition("/")[2]) or EXAMPLES.get(topic.type)
    return deepcopy(example) if example else message_class(topic.type)()


class Rates(NamedTuple):
    """Whose relays these are, the period of a step, ns, and how many of them make one of the slow nodes."""

    graph: str
    period_ns: int
    every: int = 1

    @property
    def step(self) -> list[Topic]:
        """The topics of each step."""
        return step_topics(self.graph)

    def slow(self, stamp_ns: int) -> bool:
        """Whether the slow nodes work at an instant of lockstep."""
        return self.every == 1 or stamp_ns % (self.every * self.period_ns) == 0


class Relay(Node):
    """One node of the table."""

    def __init__(self, role: str, rates: Rates, recorded: bool):
        super().__init__(f"relay_{role}".replace("/", "_"))
        self.role, self.rates, self.recorded = role, rates, recorded
        self.base = role.rpartition("/")[2]
        self.period_ns = rates.period_ns
        self.now_ns, self._first_ns = 0, -1
        self.is_ready = False
        self._peers: list[Callable[[], bool]] = []
        self._ready = self.create_publisher(String, "ready", qos(latched=True))
        self._barrier = self.create_timer(0.02, self._wait)

    def publisher(self, topic: Topic):
        """Create a publisher of the table, to be matched before the start."""
        made = self.create_publisher(message_class(topic.type), topic.name, qos(topics.PUBLISHED_DEPTH))
        there = topic.subscribers if self.recorded else topic.consumers
        self._peers.append(lambda: made.get_subscription_count() >= len(there))
        return made

    def listen(self, topic: Topic, callback: Callable, depth: int = 10, raw: bool = False) -> None:
        """Create a subscription of the table, to be matched before the start."""
        made = self.create_subscription(message_class(topic.type), topic.name, callback, qos(depth), raw=raw)
        self._peers.append(lambda: made.get_publisher_count() >= 1)

    def outputs(self, under: str = "") -> Callable[[int], None]:
        """Return what publishes all that the node publishes, with names that begin with `under`."""
        mine = [t for t in self.rates.step if self.role in t.producers and t.name.startswith(under)]
        made = [(self.publisher(t), filled(t), t.slow) for t in mine]
        stamps = [m.clock if hasattr(m, "clock") else m.header.stamp for _, m, _ in made]

        def publish(stamp_ns: int) -> None:
            sec, nanosec = divmod(stamp_ns, topics.SECOND_NS)
            for stamp in stamps:
                stamp.sec, stamp.nanosec = sec, nanosec
            for publisher, message, slow in made:
                if not slow or self.rates.slow(stamp_ns):
                    publisher.publish(message)

        return publish

    def joined(self, under: str, act: Callable[[int], None]) -> None:
        """Call `act` with each stamp of which all inputs with names that begin with `under` are there."""
        inputs = [t for t in self.rates.step if self.role in t.consumers and t.name.startswith(under)]
        quick = 0 if self.base in SLOW else sum(not topic.slow for topic in inputs)
        counts: dict[int, int] = {}

        def receive(message) -> None:
            stamp_ns = messages.nanoseconds(message.header.stamp)
            due = len(inputs) if self.rates.slow(stamp_ns) else quick
            count = counts.get(stamp_ns, 0) + 1
            if not due:
                return
            if count < due:
                counts[stamp_ns] = count
            else:
                counts.pop(stamp_ns, None)
                act(stamp_ns)
                self.passed(stamp_ns)

        for topic in inputs:
            self.listen(topic, receive)

    def passed(self, stamp_ns: int) -> None:
        """Note how far the run is."""
        self._first_ns = stamp_ns if self._first_ns < 0 else self._first_ns
        self.now_ns = stamp_ns - self._first_ns

    def _wait(self) -> None:
        if all(there() for there in self._peers):
            self._barrier.cancel()
            self.is_ready = True
            self._ready.publish(String(data=self.role))


class Controller(Relay):
    """Position controller, pressure controller or, once for each muscle, inverse valve model."""

    def __init__(self, role: str, rates: Rates, recorded: bool):
        super().__init__(role, rates, recorded)
        for under in self._muscles() if self.base == VALVE else ("",):
            self.joined(under, self.outputs(under))

    def _muscles(self) -> list[str]:
        flows = [t.name for t in self.rates.step if self.role in t.consumers and t.name.endswith(FLOW)]
        return [name.removesuffix(FLOW) for name in flows]


class Trajectory(Relay):
    """Publishes a period ahead."""

    def __init__(self, role: str, rates: Rates, recorded: bool):
        super().__init__(role, rates, recorded)
        self._publish = self.outputs()
        clock = next(t for t in rates.step if role in t.consumers and t.name.endswith(topics.CLOCK))
        self.listen(clock, self._tick)

    def _tick(self, message) -> None:
        stamp_ns = messages.nanoseconds(message.clock)
        if self._first_ns < 0:
            self._publish(stamp_ns)
        self._publish(stamp_ns + self.period_ns * self.rates.every)
        self.passed(stamp_ns)


class Plant(Relay):
    """Takes the next step when both voltages of this one are there and the recorder is near."""

    def __init__(self, role: str, rates: Rates, recorded: bool):
        super().__init__(role, rates, recorded)
        self._publish = self.outputs()
        self._absent = set(nodes(rates.graph)) - (set() if recorded else {RECORDER})
        self._next_ns = 0
        self._recorded_ns = -1 if recorded else 1 << 62
        self._waits = True
        self.joined("", self._answered)
        self.create_subscription(String, "ready", self._on_ready, qos(topics.PUBLISHED_DEPTH, latched=True))
        if recorded:
            self.listen(topics.Topics(KNEE).by_name["recorded"], self._on_recorded)

    def _on_ready(self, message: String) -> None:
        self._absent.discard(message.data)
        self._go_on()

    def _on_recorded(self, message: Time) -> None:
        self._recorded_ns = messages.nanoseconds(message)
        self._go_on()

    def _answered(self, stamp_ns: int) -> None:
        self._next_ns = stamp_ns + self.period_ns
        self._waits = True
        self._go_on()

    def _go_on(self) -> None:
        near = self._next_ns - self._recorded_ns <= MAX_UNRECORDED_STEPS * self.period_ns
        if self._waits and near and not self._absent:
            self._waits = False
            self._publish(self._next_ns)


class Clocked(Plant):
    """Takes a sample each period of the wall clock, on the grid of its first."""

    def _go_on(self) -> None:
        if self._waits and not self._absent:
            self._waits, self._began_ns = False, time.time_ns()
            self.create_timer(self.period_ns * 1e-9, self._sample)

    def _sample(self) -> None:
        due = (time.time_ns() - self._began_ns + self.period_ns // 2) // self.period_ns
        stamp_ns = self._began_ns + due * self.period_ns
        if stamp_ns > self._next_ns:
            self._next_ns = stamp_ns
            self._publish(stamp_ns)

    def _answered(self, stamp_ns: int) -> None:
        pass


class Valves(Controller):
    """Keeps how old samples are when both answers have left."""

    def __init__(self, role: str, rates: Rates, folder: Path):
        self._file, self._half, self._ages = folder / f"{role.replace('/', '_')}{AGES}", set(), []
        super().__init__(role, rates, True)

    def passed(self, stamp_ns: int) -> None:
        """Note the age of a sample at its second answer."""
        super().passed(stamp_ns)
        if stamp_ns not in self._half:
            self._half.add(stamp_ns)
            return
        self._ages.append(time.time_ns() - stamp_ns)
        if len(self._ages) % KEPT_AGES == 0:
            self._keep()

    def _keep(self) -> None:
        part = self._file.with_suffix(".part")
        part.write_text(json.dumps(self._ages))
        part.replace(self._file)


class Recorder(Relay):
    """Writes serialised messages as they come."""

    def __init__(self, role: str, rates: Rates, folder: Path):
        super().__init__(role, rates, True)
        folder.mkdir(parents=True, exist_ok=True)
        file = str(folder / "relayed.mcap")
        self._writer = Writer(file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2")
        self._acknowledge = self.create_publisher(Time, "recorded", qos())
        self._tick = next(t.name for t in rates.step if t.name.endswith(topics.SAMPLE))
        for topic in rates.step:
            self.listen(topic, self._receiver(topic), RECORDER_DEPTH, raw=True)

    def _receiver(self, topic: Topic) -> Callable[[bytes], None]:
        definition = message_definition(topic.type)[0].encode()
        schema = self._writer.register_schema(topic.type, "ros2msg", definition)
        channel = self._writer.register_channel(f"/{topic.name.lstrip('/')}", "cdr", schema)

        def receive(data: bytes) -> None:
            stamp_ns = serialised_stamp_ns(data)
            self._writer.add_message(channel, stamp_ns, bytes(data), stamp_ns)
            if topic.name == self._tick and stamp_ns % (ACKNOWLEDGED_STEPS * self.period_ns) == 0:
                self._acknowledge.publish(messages.time(stamp_ns))
                self.passed(stamp_ns)

        return receive


def make(role: str, realtime: bool, rates: Rates, folder: str) -> Relay:
    """Return the relay that stands for a node of the table; `folder` is `-` without a recorder."""
    if role == RECORDER:
        return Recorder(role, rates, Path(folder))
    base = role.rpartition("/")[2]
    if realtime and base == VALVE:
        return Valves(role, rates, Path(folder))
    if realtime and role == PLANT:
        return Clocked(role, rates, True)
    return {PLANT: Plant, TRAJECTORY: Trajectory}.get(base, Controller)(role, rates, folder != "-")


def spin(nodes: Sequence[Relay]) -> None:
    """Run relays until they are killed; tell the supervisor how far they are."""
    pipe = int(os.environ[HEARTBEAT_VARIABLE])

    def beat() -> None:
        while True:
            ready = all(node.is_ready for node in nodes)
            told = f"running {max(node.now_ns for node in nodes)}" if ready else "starting"
            os.write(pipe, f"{told}\n".encode())
            time.sleep(0.1)

    threading.Thread(target=beat, daemon=True).start()  # a timer would wait behind all that has arrived
    executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    executor.spin_until_future_complete(Future(), timeout_sec=3600.0)


def main() -> None:
    """Run the relays that the command line names."""
    rclpy.init(args=sys.argv)
    given, folder, *roles = remove_ros_args(sys.argv)[1:]
    graph, period = given.split(":")
    rates, realtime = Rates(graph, *map(int, period.split("x"))), REALTIME in roles
    spin([make(role, realtime, rates, folder) for role in roles if role != REALTIME])


if __name__ == "__main__":
    main()
