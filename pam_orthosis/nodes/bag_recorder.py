# SPDX-License-Identifier: Apache-2.0
"""Node: records all topics of the table into a bag, in one order whatever the arrival was."""

import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from functools import partial
from pathlib import Path

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from pam_orthosis.bag.cdr import Reader, Unreadable, canonical, serialised_stamp_ns
from pam_orthosis.bag.record import BagWriter, run_metadata
from pam_orthosis.bag.steps import Message, StepCollector
from pam_orthosis.bag.topics import DIAGNOSTICS, PLANT, RECORDER, SAMPLE, VALVE_COMMAND, Topic, in_leg
from pam_orthosis.bag.writer_process import BagWriterProcess
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.parameters import LEGS, Setting
from pam_orthosis.nodes.recorded_leg import RecordedLeg
from pam_orthosis.nodes.supervisor import ERROR_PREFIX, NOTE_PREFIX
from pam_orthosis.scene.messages import LATCHED, TYPES, Scene, in_scene
from pam_orthosis.scene.sampled import SampledScene

QUEUE_DEPTH = 5000


class BagRecorder(graph.GraphNode):
    """Writes each step when it is complete, and reports to the plants how far the bag reaches.

    Serialised messages are written as they arrive. Each recorded type begins with its stamp, right
    behind the four bytes of encapsulation. Beside them stands what viewers need: the leg's
    description, TF, joints and markers.
    """

    def __init__(self, place: Sequence[str] = ()) -> None:
        folder = Setting("recording", "folder of the new bag")
        scenario = Setting("default", "name of the scenario, for the bag's metadata")
        silence = Setting(5.0, "wall time without a sample after which a run in real time fails [s]")
        aside = Setting(False, "another process packs, compresses and writes the bag")
        settings = {"directory": folder, "scenario_name": scenario, "sample_timeout": silence, "legs": LEGS}
        settings |= {"aside": aside}
        super().__init__(RECORDER, settings, place=place)

    def configure(self) -> None:
        """Begin the bag, and listen."""
        super().configure()
        self._run_ns = round(self.parameters.scenario.duration * 1e9 / self.period_ns) * self.period_ns
        run = run_metadata(self.parameters, self.settings["scenario_name"], self.settings["legs"])
        self._writer = self._made_writer(Path(self.settings["directory"]), run)
        self._heard = False
        self._waiting: deque[Callable[[], None]] = deque(maxlen=QUEUE_DEPTH)  # what came before it was active
        self._doubted: set[str] = set()
        self._names: dict[str, str] = {}
        self._viewed: dict[str, tuple[SampledScene, str, dict[str, str]]] = {}
        self._legs = self._make_legs()
        for leg in self._legs:
            for topic in filter(lambda topic: topic.recorded, self.topics_of(leg.name).values()):
                self._record(topic, leg)
            self._view(leg)
        if len(self.legs) > 1:
            self._await_all_legs()
        if self.settings["aside"]:
            self.barrier.await_peer("the process that writes the bag", self._begun)
        self.wall_timer(0.05, self._look)

    def started(self) -> None:
        """Expect samples from now on."""
        for leg in self._legs:
            leg.begin()
        while self._waiting:
            self._waiting.popleft()()

    def health(self) -> dict[str, int]:
        """Count messages that came twice."""
        return {"duplicates": sum(steps.duplicates for steps in self._collectors())}

    def refuse(self, failure: Callable[[], OrthosisError]) -> None:
        """Have the others ended first, so that the bag shows how they left the hardware."""
        if self.ended or self.stranger:
            return
        self.stranger = True
        if self.supervised:  # else its process says it in the end
            print(f"{ERROR_PREFIX}{failure()}", file=sys.stderr, flush=True)
        self.wall_timer(3.0, lambda: super(BagRecorder, self).refuse(failure))

    def fail(self, error: OrthosisError) -> None:
        """End the run: nothing can be written any more, or nothing comes."""
        super().refuse(lambda: error)

    def met_stranger(self, topic: str, leg: str) -> None:
        """Record no more of a topic on which somebody else speaks too, but that the valves vent."""
        self._doubted.add(in_leg(topic, leg, self.legs))

    def abandon(self) -> bool:
        """Stay to record the last words of the others."""
        self._heard = False
        return True

    def hears(self) -> bool:
        """Whether a message has come since this was last asked."""
        heard, self._heard = self._heard, False
        return heard

    def close(self) -> None:
        """Close the bag; a run that was cut short leaves its incomplete last step in it too."""
        if not self.ended:
            self._report_missing()
            for steps in self._collectors():
                self._write(steps.rest())
        with suppress(OrthosisError) if self.failure else nullcontext():  # that one is reported
            self._writer.close()

    def _made_writer(self, folder: Path, run: Mapping[str, str]) -> BagWriter | BagWriterProcess:
        if not self.settings["aside"]:
            return BagWriter(folder, run)
        return BagWriterProcess(folder, run, self._beat)

    def _beat(self) -> None:
        self.pulse()

    def _await_all_legs(self) -> None:
        """Be ready after all others: a leg that is up would soon wait for the record of one that is not."""
        for leg in self.legs:
            others = set(self.entry("ready", leg).producers) - {RECORDER}
            there: set[str] = set()
            self.listen_to("ready", partial(_note, there), leg=leg, latched=True)
            self.barrier.await_peer(f"the nodes of {leg}", partial(others.issubset, there))

    def _make_legs(self) -> list[RecordedLeg]:
        """In lockstep the legs share their instants, and the bag has one order; by the wall clock not."""
        if self.realtime:
            return [RecordedLeg(self, leg, self._run_ns, self._collector([leg])) for leg in self.legs]
        shared = self._collector(self.legs)
        return [RecordedLeg(self, leg, self._run_ns, shared) for leg in self.legs]

    def _collector(self, legs: Sequence[str]) -> StepCollector:
        topics = {
            in_leg(name, leg, self.legs): topic for leg in legs for name, topic in self.topics_of(leg).items()
        }
        late_ns = 150_000_000 if self.realtime else None
        return StepCollector(self.period_ns, topics, late_ns, self.every)

    def _collectors(self) -> list[StepCollector]:
        return list(dict.fromkeys(leg.steps for leg in self._legs))

    def _record(self, topic: Topic, leg: RecordedLeg) -> None:
        options = {"near": self._receiver(topic, leg, True), "depth": QUEUE_DEPTH, "raw": True}
        subscription = self.listen_to(topic.name, self._receiver(topic, leg), leg=leg.name, **options)
        self._names[in_leg(topic.name, leg.name, self.legs)] = subscription.topic_name
        self._writer.add_topic(subscription.topic_name, topic.type)

    def _view(self, leg: RecordedLeg) -> None:
        """Have what viewers need of a leg written beside its measurements."""
        names = {topic: self.resolve_topic_name(in_scene(topic, leg.name)) for topic in TYPES}
        own, all_legs = (self.leg, [self.leg]) if len(self.legs) == 1 else (leg.name, self.legs)
        scene = Scene(self.parameters_of(leg.name), own, all_legs)
        viewed = SampledScene(scene)
        viewed.prepare()
        for topic, name in names.items():
            self._writer.add_topic(name, TYPES[topic], topic in LATCHED)
        self._viewed |= {
            in_leg(topic, leg.name, self.legs): (viewed, topic, names) for topic in viewed.inputs
        }

    def _receiver(self, topic: Topic, leg: RecordedLeg, clean: bool = False) -> Callable[[bytes], None]:
        """Return what takes the messages of a topic; they are `clean` if their padding is zero."""
        clean = clean or self.realtime  # there no two runs are alike, and there is better use for the time
        name = in_leg(topic.name, leg.name, self.legs)
        tick = topic.name == SAMPLE
        answer, shared = topic.rate == "answer", topic.shared
        first = leg.name == self.legs[0]
        # in real time what waited for a late instant must not hold up the graph
        most = 3 if self.realtime else None

        def receive(data: bytes) -> None:  # all in one: each call would be one for each message
            if not self.acts:
                if not self.realtime:
                    self._waiting.append(partial(receive, data))
                return
            if name in self._doubted and not self._vents(topic, data):
                return
            self._heard = True
            stamp_ns = serialised_stamp_ns(data)
            if shared and not self._of_the_run(leg, stamp_ns, data):
                return
            if tick:
                leg.sampled(stamp_ns)
            if self.ended or not leg.within(stamp_ns):
                self.pulse()  # no step is done here, and a timer would queue behind all that has come
                return
            data = bytes(data) if clean else canonical(data, topic.type)
            whole = leg.steps.add(Message(name, stamp_ns, data))
            if leg.unhurried(tick, answer) if self.realtime else whole:
                self._write(leg.steps.complete(most))
            if tick:
                leg.acknowledge(steps=10)
                if first:
                    self.step_done(stamp_ns)

        return receive

    def _vents(self, topic: Topic, data: bytes) -> bool:
        """Whether a message lets a valve vent: who says so does no harm."""
        if not topic.name.endswith(VALVE_COMMAND):
            return False
        with suppress(Unreadable):
            return Reader(topic.type, messages.SPOOL)(data)[1] == (VENT,)
        return False

    def _of_the_run(self, leg: RecordedLeg, stamp_ns: int, data: bytes) -> bool:
        """Whether a health report is of a node of the run: others publish theirs on the same topic."""
        reported = deserialize_message(data, DiagnosticArray).status
        group = self.full_role(leg.name).removesuffix(self.role)
        known = {f"{group}{node}: loop" for node in self.entry(DIAGNOSTICS, leg.name).producers}
        return {one.name for one in reported} <= known and leg.is_near(stamp_ns)

    def _begun(self) -> bool:
        """Whether the other process has begun the bag."""
        assert isinstance(self._writer, BagWriterProcess)  # there is no other process otherwise
        try:
            return self._writer.ready()
        except OrthosisError as error:
            self.fail(error)
            return False

    def _write(self, recorded: Iterable[Message]) -> None:
        try:
            self._writer.write_all(self._with_scenes(recorded))
        except OrthosisError as error:
            self.fail(error)  # the writer is given the last words nevertheless, and takes them if it can

    def _with_scenes(self, recorded: Iterable[Message]) -> Iterator[tuple[str, int, bytes]]:
        """Hand messages on under their absolute names, behind each what viewers need of it."""
        for topic, stamp_ns, data in recorded:
            yield self._names[topic], stamp_ns, data
            if topic in self._viewed:
                scene, measured, names = self._viewed[topic]
                for said in scene.add(measured, stamp_ns, data):
                    yield names[said.topic], stamp_ns, said.data

    def _look(self) -> None:
        """Look after the writer; acknowledge what is recorded; end the run when all of it is."""
        if self.settings["aside"]:
            self._begun()
        for leg in self._legs:
            if self._has_gaps(leg):
                self._write(leg.steps.overtaken())
            leg.acknowledge()
        if self.ended or self.stranger:  # who may have said what looks like the last step
            return
        try:
            over = [leg.over() for leg in self._legs]  # each is asked: one without samples fails the run
        except OrthosisError as error:
            self.fail(error)
        else:
            if all(over):
                self._finish()

    def _has_gaps(self, leg: RecordedLeg) -> bool:
        """Whether in lockstep all wait for this node, and it for what somebody who left did not say."""
        lost = leg.joined_late or self.barrier.anew()
        return lost and not self.realtime and leg.silence() > 1.0

    def _finish(self) -> None:
        for steps in self._collectors():
            for message in steps.rest():
                self._write([message])
                self.pulse()
        for leg in self._legs:
            leg.report_end()
        self.ended = True
        self.alarm()

    def _report_missing(self) -> None:
        """Say which message broke the chain: the first that the last step lacks, causes first."""
        missing = {name: topic for steps in self._collectors() for name, topic in steps.missing().items()}
        for name, topic in list(missing.items())[:1]:
            driven = not self.settings["with_plant"] and PLANT in topic.producers
            owner = "the hardware driver" if driven else topic.producers[0]
            print(f"{NOTE_PREFIX}the last step lacks {name} of {owner}", file=sys.stderr)


def _note(there: set[str], said: String) -> None:
    there.add(said.data)


def let_others_first() -> None:
    """Have this process woken without interrupting those that it listens to: nobody waits for it.

    Each of them would be interrupted by each of its messages.
    """
    with suppress(OSError):
        if os.sched_getscheduler(0) == os.SCHED_OTHER:  # what somebody has chosen stays
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def main() -> int:
    """Run the node."""
    let_others_first()  # before the middleware has threads, which take it over
    return process.run(lambda: [BagRecorder()])
