# SPDX-License-Identifier: Apache-2.0
"""When the emulated hardware takes its next step: in lockstep with the answers, or by the wall clock."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import partial
from typing import Any

from builtin_interfaces.msg import Time

from pam_orthosis.bag.topics import ANEW, PLANT, RECORDER, SECOND_NS, VALVE, Topics, in_leg
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.components.spool import VENT
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.barrier import Notice
from pam_orthosis.nodes.graph import GraphNode
from pam_orthosis.nodes.join import Join
from pam_orthosis.nodes.silence import Silence
from pam_orthosis.nodes.topic_node import Numbers

MAX_UNRECORDED_STEPS, MAX_UNRECORDED_NS = 50, 250_000_000  # and the recorder keeps a chunk in memory
SILENCE_SAMPLES = 20  # without an answer, after which valves vent
MAX_PERIODS_AT_ONCE = 100  # of the hardware's life in one callback: others must have their turn


class PacedNode(GraphNode, ABC):
    """A node of hardware that takes a step when its pace lets it, and none once it is `abandoned`."""

    abandoned = False

    @property
    def commands(self) -> dict[str, tuple[str, str]]:
        """The commands of all legs in the order of the valves, by their names here: leg, topic."""
        return {
            in_leg(topic, leg, self.legs): (leg, topic)
            for leg in self.legs
            for topic in Topics(self.parameters_of(leg).declared).commands
        }

    def peers(self) -> list[str]:
        """Return all nodes of the legs that it serves, itself and the recorder, which serve all of them."""
        own = [(node, leg) for leg in self.legs for node in self.entry("ready", leg).producers]
        return [node if node in (PLANT, RECORDER) else in_leg(node, leg, self.legs) for node, leg in own]

    @abstractmethod
    def publish_sample(self, stamp_ns: int) -> None:
        """Publish what the sensors say at an instant."""

    @abstractmethod
    def take(self, line: int, spool: float, at_ns: int) -> None:
        """Take a command for an actuator's valve (its number) that comes at an instant of the run."""

    @abstractmethod
    def advance(self, *spools: float) -> None:
        """Let one period pass that these commands answer, relative positions of the spools."""

    @abstractmethod
    def live_on(self) -> None:
        """Let one period pass under the commands that have come."""


class Lockstep:
    """Step k is over when all its commands are there: the result does not depend on the machine's load.

    It stays at most `MAX_UNRECORDED_STEPS` and `MAX_UNRECORDED_NS` ahead of the recorder, which ends the run
    after the last, and with the setting `paced` is never ahead of the wall clock.
    """

    def __init__(self, plant: PacedNode):
        self._plant = plant
        steps = round(plant.parameters.scenario.duration * 1e9 / plant.period_ns)
        self._last_ns = (steps - 1) * plant.period_ns
        self._stamp_ns = 0
        self._recorded_ns = -1
        self._longest_lead_ns = min(MAX_UNRECORDED_STEPS * plant.period_ns, MAX_UNRECORDED_NS)
        self._waits = False
        self._begun, self._begun_ns = False, 0
        self._anew: dict[str, str] = {}  # when it began, if a run was on
        self._early: tuple[Any, ...] = ()
        self._silence = Silence()
        self._notice = Notice(plant)
        self._join = Join(plant.commands, self._answered)
        for name, (leg, topic) in plant.commands.items():
            plant.listen_to_numbers(topic, messages.SPOOL, partial(self._join.add, name), leg=leg)
        for leg in plant.legs:
            plant.listen_to("recorded", self._on_recorded, leg=leg)
        plant.wall_timer(0.25, self._watch)
        self._paced = plant.settings["paced"]
        if self._paced:
            plant.wall_timer(plant.period_ns / SECOND_NS, self._go_on)

    def begin(self) -> None:
        """Take the first step: behind all that anybody has taken if the run is on without this plant."""
        self._begun = True
        if (reached_ns := self._reached_ns()) > 0:
            slow_ns = self._plant.every * self._plant.period_ns  # a slow node may be new too
            self._stamp_ns = min((reached_ns // slow_ns + 1) * slow_ns, self._last_ns)
            self._early = ()
            self._anew = {ANEW: f"at {self._stamp_ns / SECOND_NS:.3f} s"}
            told = f"the run is on: the hardware begins anew, at rest, {self._anew[ANEW]}"
            self._plant.get_logger().warning(told)
        self._begun_ns = time.monotonic_ns() - self._stamp_ns
        self._publish()
        if self._early:
            self._answered(*self._early)

    def resume(self) -> None:
        """Go on: the plant is active again."""
        self._silence.broken = True
        self._go_on()

    def _reached_ns(self) -> int:
        """Return the last instant of the run before this plant came: answered, or else the last possible.

        Who answers may be new too; the recorder knows how far the run is, and no plant is farther ahead.
        """
        stamp_ns: int = self._early[0] if self._early else 0
        known = self._recorded_ns < 0 or stamp_ns >= self._recorded_ns or not self._plant.is_lockstep()
        return stamp_ns if known else self._recorded_ns + self._longest_lead_ns

    def health(self) -> dict[str, Any]:
        """Count lost inputs; say when it began if a run was on."""
        return {"dropped_inputs": self._join.dropped, **self._anew}

    def _publish(self) -> None:
        self._silence.broken = True
        self._plant.publish_sample(self._stamp_ns)

    def _answered(self, stamp_ns: int, *spools: Numbers) -> None:
        if not self._begun:  # in a replay the answer may overtake the word that all are ready
            self._early = (stamp_ns, *spools)
        if not self._begun or self._plant.abandoned:
            return
        self._plant.advance(*(spool for (spool,) in spools))
        self._plant.step_done(stamp_ns)
        self._silence.broken = True
        self._stamp_ns = stamp_ns + self._plant.period_ns
        self._waits = True
        self._go_on()

    def _on_recorded(self, message: Time) -> None:
        self._recorded_ns = messages.nanoseconds(message)
        self._go_on()

    def _go_on(self) -> None:
        """Take the next step, if there is one, when the recorder is near enough."""
        early = self._paced and time.monotonic_ns() - self._begun_ns < self._stamp_ns
        near = self._stamp_ns - self._recorded_ns <= self._longest_lead_ns and not early
        goes = self._plant.active and not self._plant.abandoned
        if self._waits and self._stamp_ns <= self._last_ns and near and goes:
            self._waits = False
            self._publish()

    def _watch(self) -> None:
        """Say what is missing when nothing has moved for too long; fail if somebody ends the others."""
        limit = self._plant.settings["answer_timeout"]
        steps = self._begun and self._plant.active and not self._plant.ended
        if not steps or self._silence.look() < limit:
            return
        at = f"at {self._stamp_ns / 1e9:.3f} s"
        if self._plant.supervised:
            self._plant.fail(RunFailed(f"plant_simulator waited {at} for {limit:g} s: {self._cause()}"))
        else:
            self._notice.say(f"waiting {at}: {self._cause()}")

    def _cause(self) -> str:
        """Return who is gone, or else what did not come: who sends that may wait for somebody himself."""
        fed = self._plant.settings["replay"]
        if absent := [] if fed else self._plant.ownership.absent(self._plant.peers()):
            return f"{' and '.join(absent)} {'is' if len(absent) == 1 else 'are'} gone"
        if self._waits:
            return "bag_recorder does not keep up"
        topics = self._join.missing(self._stamp_ns)
        own = (self._plant.commands[name] for name in topics)
        producers = {"/".join(filter(None, (leg, VALVE))) for leg, _ in own}
        return f"{' and '.join(topics)} did not come from {' and '.join(sorted(producers))}"


class RealTime:
    """A sample each period of the wall clock; a command counts from the instant at which it came.

    From then on it goes through converter, valve and hose, as in lockstep. What lies between a sample and its
    answer is the machine's own time: the row of the computing delay stands for it in lockstep only.
    Commands that do not come any more are replaced by those of the vent after `SILENCE_SAMPLES`.
    Time passes for the hardware whether anybody looks or not: a sample that is overdue by a period is
    skipped and counted, never made up for, so that a machine that is too slow answers fewer samples
    instead of ever older ones.
    """

    def __init__(self, plant: PacedNode):
        self._plant = plant
        self._first_ns = 0
        self._passed = 0  # periods that the hardware has lived through
        self._sampled = 0  # period of the last sample
        self._skipped = self._late = self._silent = 0
        self._answered_ns, self._unanswered = (dict.fromkeys(plant.commands, 0) for _ in range(2))
        for line, (name, (leg, topic)) in enumerate(plant.commands.items()):
            plant.listen_to_numbers(topic, messages.SPOOL, self._receiver(line, name), leg=leg)

    def begin(self) -> None:
        """Take the first sample; start the timer, whose ticks are then never before their stamps."""
        self._first_ns = self._plant.now_ns()
        self._plant.create_timer(self._plant.period_ns * 1e-9, self._tick)
        self._sample(0)

    def resume(self) -> None:
        """Go on: the plant is active again, and its timer never stood still."""

    def health(self) -> dict[str, int]:
        """Count samples answered too late, samples not taken, periods without commands."""
        return {
            "late_answers": self._late,
            "skipped_samples": self._skipped,
            "vented_without_commands": self._silent,
        }

    def _receiver(self, line: int, topic: str) -> Callable[[int, Numbers], None]:
        def receive(stamp_ns: int, spool: Numbers) -> None:
            (position,) = spool
            self._plant.take(line, position, self._plant.now_ns() - self._first_ns)
            if not any(self._answered_ns.values()):  # nobody was silent before there was anybody
                self._unanswered = dict.fromkeys(self._answered_ns, 0)
            self._unanswered[topic] = 0
            self._answered_ns[topic] = stamp_ns

        return receive

    def _tick(self) -> None:
        """Let the hardware live up to the nearest period, and if it is there take the sample."""
        period_ns = self._plant.period_ns
        due = (self._plant.now_ns() - self._first_ns + period_ns // 2) // period_ns  # timers jitter
        for _ in range(min(due - self._passed, MAX_PERIODS_AT_ONCE)):
            self._vent_in_silence()
            self._plant.live_on()
            self._passed += 1
        over = self._plant.ended or self._plant.abandoned or not self._plant.active
        if self._passed == due > self._sampled and not over:
            self._late += min(self._answered_ns.values()) < self._stamp_ns(self._sampled)
            self._skipped += due - self._sampled - 1
            self._sample(due)

    def _vent_in_silence(self) -> None:
        """Have all valves vent in the next period where any gets no commands any more, or none is taken."""
        silent = max(self._unanswered.values()) > SILENCE_SAMPLES
        if (silent or not self._plant.active) and any(self._answered_ns.values()):
            self._silent += 1
            for line in range(len(self._answered_ns)):
                self._plant.take(line, VENT, self._passed * self._plant.period_ns)

    def _sample(self, period: int) -> None:
        self._sampled = period
        self._unanswered = {topic: count + 1 for topic, count in self._unanswered.items()}
        self._plant.publish_sample(self._stamp_ns(period))
        self._plant.step_done(self._stamp_ns(period))

    def _stamp_ns(self, period: int) -> int:
        return self._first_ns + period * self._plant.period_ns
