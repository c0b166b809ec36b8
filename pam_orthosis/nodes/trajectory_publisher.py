# SPDX-License-Identifier: Apache-2.0
"""Node: the reference, published one of its periods before the instant that it is valid for."""

from collections.abc import Sequence

from pam_orthosis.bag.topics import BESIDE, CLOCK, MEAN_PRESSURE, PLANNED, REFERENCE, SAMPLE, TRAJECTORY
from pam_orthosis.control.reference import Motion, as_number
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.nodes import graph, messages, process
from pam_orthosis.nodes.topic_node import Numbers


class TrajectoryPublisher(graph.GraphNode):
    """On the clock of its step k, publishes the reference of step k + 1 (at first that of k too).

    Its steps are those of the position controller, which has them from the references' stamps. The clock is
    `/clock` in lockstep and the sample in real time, so that reference and sample carry the same stamps
    without two timers that drift apart. The services `~/start` and `~/stop` begin the motion anew and bring
    it to rest.
    """

    def __init__(self, place: Sequence[str] = ()) -> None:
        super().__init__(TRAJECTORY, place=place)

    def configure(self) -> None:
        """Make the motion, and what it hears and says."""
        super().configure()
        if self.parameters.control.cooperation.wait:
            raise OrthosisError(
                "control.cooperation.wait: no node waits for a person: leave it out, or use ClosedLoop"
            )
        self._trajectory = make_trajectory(self.parameters)
        self._first_ns = 0
        self._next_ns: int | None = None
        motion = messages.trajectory(0, self.machine.name, Motion(0.0, 0.0, 0.0))
        examples = {REFERENCE: motion, MEAN_PRESSURE: messages.fluid_pressure(0, "", 0.0), PLANNED: motion}
        examples[BESIDE] = messages.trajectory(0, self.machine.neighbour, Motion(0.0, 0.0, 0.0))
        self._send = {
            topic: self.publish_numbers(topic, example)
            for topic, example in examples.items()
            if topic in self.topics
        }
        self.offer("~/start", self._start)
        self.offer("~/stop", self._stop)
        if self.realtime:
            self.listen_to_numbers(SAMPLE, [], self._tick, depth=1)
        else:
            self.listen_to_numbers(CLOCK, [], self._tick)

    def retune(self, parameters: Parameters) -> None:
        """Pass smoothly to a new cycle time."""
        self._changeable().set_cycle_time(self._ahead_ns(), parameters.scenario.cycle_time)

    def _start(self) -> str:
        if not self._changeable().stopped:
            raise OrthosisError(f"the {self.machine.name} is moving already")
        self._changeable().go_on(self._ahead_ns())
        return f"moving within {self.parameters.scenario.start_ramp:g} s"

    def _stop(self) -> str:
        if self._changeable().stopped:
            raise OrthosisError(f"the {self.machine.name} has been stopped already")
        self._changeable().stop(self._ahead_ns())
        return f"at rest within {self.parameters.scenario.start_ramp:g} s"

    def _changeable(self) -> Trajectory:
        if not isinstance(self._trajectory, Trajectory):
            raise OrthosisError(
                f"{self.parameters.scenario.trajectory} is an experiment, which runs from start to end"
            )
        return self._trajectory

    def _ahead_ns(self) -> int:
        """Return the instant, since the start, of the reference that is published next."""
        return (self._next_ns or 0) - self._first_ns

    def _tick(self, now_ns: int, _numbers: Numbers = ()) -> None:
        if self._next_ns is None:
            self._next_ns = now_ns  # not the first if it was started again
            self._first_ns = 0 if self.is_lockstep() else now_ns
        if self._next_ns < now_ns:  # skipped samples need no reference
            since = (now_ns - self._next_ns) // self.control_ns
            self._next_ns = now_ns - since % self.every * self.control_ns
        if self._next_ns > now_ns + self.period_ns:
            return  # it works at its own steps only
        while self._next_ns <= now_ns + self.period_ns:
            self._publish(self._next_ns)
            self._next_ns += self.period_ns
        self.step_done(now_ns)

    def _publish(self, stamp_ns: int) -> None:
        reference = self._trajectory.sample(stamp_ns - self._first_ns)
        self._send[REFERENCE](stamp_ns, *reference[:3])
        if reference.mean_pressure is not None:
            self._send[MEAN_PRESSURE](stamp_ns, as_number(reference.mean_pressure), 0.0)
        if reference.planned is not None:
            self._send[PLANNED](stamp_ns, *reference.planned)
        if reference.beside is not None:
            self._send[BESIDE](stamp_ns, *reference.beside)


def main() -> int:
    """Run the node."""
    return process.run(lambda: [TrajectoryPublisher()])
