# SPDX-License-Identifier: Apache-2.0
"""The run of a node of the graph: its start, its steps, live parameters, health reports, its end."""

import gc
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.duration import Duration
from std_msgs.msg import String

from pam_orthosis.bag.topics import DIAGNOSTICS, RECORDER, SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.agreement import ALIKE, Agreement
from pam_orthosis.nodes.parameters import Setting, take_changes
from pam_orthosis.nodes.topic_node import TopicNode

MOST_PERIODS = 20  # of missed samples that controllers make up for


class GraphNode(TopicNode):
    """A node that takes part in a run: waits for its peers, counts its steps, reports its health.

    A subclass makes its publishers and subscriptions with `publish_to`, `listen_to` and, for what comes
    with each step, `publish_numbers`, `listen_to_numbers` and `join_inputs`, calls `step_done` at the end
    of each step, and overrides what it has to of `started`, `retune`, `health`, `figures`, `on_end` and
    `close`.
    """

    def __init__(
        self,
        name: str,
        settings: Mapping[str, Setting] | None = None,
        role: str | None = None,
        place: Sequence[str] = (),
    ):
        # `spin` looks around now and then at each step
        self.pulse: Callable[[], None] = lambda: None
        self.supervised = False  # else who has left may come again
        super().__init__(name, settings, role, place)

    def forget(self) -> None:
        """Be as before the first run."""
        super().forget()
        self._origin_ns: int | None = None
        self.time_ns = 0
        self.ended = False

    def configure(self) -> None:
        """Make what all nodes of a run have."""
        super().configure()
        self._changed: dict[str, Any] = {}
        take_changes(self, self.spec.live, self._take_changes)
        self._reported_second = -1
        self._ages = Ages(self.control_ns)  # a slow node holds up the others
        self._reported: dict[str, Any] = {}
        self._stepped_at = time.monotonic()
        self._diagnostics = {leg: self.publish_to(DIAGNOSTICS, leg=leg) for leg in self.legs}
        if self.realtime:
            self.wall_timer(1.0, self._report_standstill)
        self._ready = [self.publish_to("ready", latched=True, leg=leg) for leg in self.legs]
        for leg in self.legs:
            self.barrier.await_agreement(self._agree(leg))
            if self.role in self.topics["end"].consumers:
                self.listen_to("end", self.on_end, leg=leg)

    def refuse(self, failure: Callable[[], OrthosisError]) -> None:
        """End the run, but for one that is over."""
        if not self.ended and not self.failure:
            self.failure = failure
            self.acts = self.active and self.role == RECORDER  # it records what comes until all have ended
            self.alarm()

    def wait_until_delivered(self, seconds: float) -> None:
        """Wait until all listeners have what was published, for so long at most: one may be dead."""
        until = time.monotonic() + seconds
        for publisher in self.publishers:
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, until - time.monotonic())))

    def begin(self) -> None:
        """Say that all peers are there, and start."""
        if self.realtime:  # what is there now stays: the collector need not look through it in each pause
            gc.collect()
            gc.freeze()
        self._stepped_at = time.monotonic()
        self.get_logger().info(self._described())
        self.say_ready(self.role)
        self.started()

    def say_ready(self, role: str) -> None:
        """Say that the peers of a role are there."""
        for publisher in self._ready:
            publisher.publish(String(data=role))

    def step_done(self, stamp_ns: int) -> None:
        """Note that the step of an instant is computed; report health once a second."""
        self._origin_ns = stamp_ns if self._origin_ns is None else self._origin_ns
        self.time_ns = stamp_ns - self._origin_ns
        if self.realtime:
            self._stepped_at = time.monotonic()
            self._ages.add(self.now_ns() - stamp_ns)
        if stamp_ns // SECOND_NS > self._reported_second:
            self._reported_second = stamp_ns // SECOND_NS
            self._report_health(stamp_ns)
        self.pulse()

    @property
    def stepped(self) -> bool:
        """Whether the node has done a step."""
        return self._origin_ns is not None

    def periods_since(self, stamp_ns: int) -> int:
        """Return how many of the node's periods an instant is later than the step that was done last.

        More than one if samples were missed; after a long silence no more than `MOST_PERIODS`.
        """
        if self._origin_ns is None:
            return 1
        passed = stamp_ns - self._origin_ns - self.time_ns
        return min(max(1, round(passed / self.period_ns)), MOST_PERIODS)

    def now_ns(self) -> int:
        """Return the present time of the node's clock."""
        return self.get_clock().now().nanoseconds

    def started(self) -> None:
        """Do what is due when all peers are there."""

    def health(self) -> dict[str, Any]:
        """Return counters, and states that are false or empty while all is well.

        They depend on the run alone.
        """
        return {}

    def latched(self) -> str:
        """Return why the node vents until somebody acts, if it does."""
        return ""

    def figures(self) -> dict[str, Any]:
        """Return the figures of the health report; called once a second of the run's time."""
        return {}

    def retune(self, parameters: Parameters) -> None:
        """Take parameters of which the live ones are new; raise OrthosisError to refuse them."""

    def on_end(self, _stamp: Time) -> None:
        """Stop spinning: the plant says that the run is over."""
        self.ended = True
        self.alarm()

    def abandon(self) -> bool:
        """Leave the hardware safe when the run is cut short; return whether that takes last messages.

        Called before `close`.
        """
        return False

    def hears(self) -> bool:
        """Whether something has come since this was last asked: last words may stand behind it."""
        return False

    def _take_changes(self, changes: dict[str, Any]) -> None:
        idle = self.machine.mechanism(self.parameters).idle
        for key in idle.keys() & changes.keys():
            raise OrthosisError(f"{key}: {idle[key]}")
        changed = self.parameters.changed(changes)
        self.retune(changed)
        self.parameters = changed
        self._changed |= changes
        self.get_logger().info(f"from now on {_as_text(changes)}")

    def _report_health(self, stamp_ns: int) -> None:
        changed = {"set_while_running": _as_text(self._changed)} if self._changed else {}
        health, figures = self.health(), {**self.figures(), **changed}
        if self.unreadable:
            health["unreadable_inputs"] = self.unreadable
        if self.realtime:
            health["missed_deadlines"] = self._ages.missed
            figures |= self._ages.figures()
        warned = [name for name, value in health.items() if _warns(value, self._reported.get(name, 0))]
        self._reported, latched = health, self.latched()
        level = (
            DiagnosticStatus.ERROR if latched else DiagnosticStatus.WARN if warned else DiagnosticStatus.OK
        )
        self._report(stamp_ns, level, latched or ", ".join(warned) or "ok", {**health, **figures})

    def _report_standstill(self) -> None:
        """Report, in real time, that no step was done for long."""
        since = time.monotonic() - self._stepped_at
        if self.active and not self.ended and since > 2.0:
            self._report(self.now_ns(), DiagnosticStatus.STALE, f"no step for {since:.0f} s", self._reported)

    def _report(self, stamp_ns: int, level: bytes, message: str, values: Mapping[str, Any]) -> None:
        for leg, publisher in self._diagnostics.items():
            name = f"{self.full_role(leg)}: loop"
            publisher.publish(messages.diagnostics(stamp_ns, name, level, message, values))

    def _described(self) -> str:
        how = "in real time" if self.realtime else "in lockstep"
        rate = SECOND_NS / self.period_ns
        return f"ready: ROS domain {self.context.get_domain_id()}, {rate:g} Hz {how}"

    def _agree(self, leg: str) -> Agreement:
        """Say what the node was started with, and hear it of the others: all have to before the start."""
        alike = {name: self.settings[name] for name in ALIKE}
        parameters = self.parameters_of(leg)
        values = {"machine_file": parameters.declared.identity} | alike | parameters.flat()
        others = self.entry("configuration", leg).producers
        agreement = Agreement(self.get_fully_qualified_name(), self.role, values, others)
        self.listen_to("configuration", agreement.add, leg=leg, latched=True)
        self.publish_to("configuration", latched=True, leg=leg).publish(agreement.message)
        return agreement


class Ages:
    """How old samples are when a node is done with them, since the last report, and how many were too old."""

    def __init__(self, deadline_ns: int):
        self._deadline_ns = deadline_ns
        self._ages: list[int] = []
        self.missed = 0

    def add(self, age_ns: int) -> None:
        """Count a sample."""
        self._ages.append(age_ns)
        self.missed += age_ns > self._deadline_ns

    def figures(self) -> dict[str, float]:
        """Return mean and largest age, ms, and begin anew."""
        ages, self._ages = self._ages, []
        if not ages:
            return {}
        return {"latency_mean_ms": sum(ages) / len(ages) / 1e6, "latency_max_ms": max(ages) / 1e6}


def _warns(value: Any, before: Any) -> bool:
    """Whether a counter has grown, or a state is not that of a healthy node."""
    return value > before if type(value) is int else bool(value)


def _as_text(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value}" for name, value in values.items())
