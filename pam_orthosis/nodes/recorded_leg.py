# SPDX-License-Identifier: Apache-2.0
"""One leg as the recorder sees it: how far its run is, when it is over, what its plant has to know."""

from rclpy.duration import Duration

from pam_orthosis.bag.steps import StepCollector
from pam_orthosis.bag.topics import SECOND_NS, in_leg
from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes import messages
from pam_orthosis.nodes.barrier import Notice
from pam_orthosis.nodes.graph import GraphNode
from pam_orthosis.nodes.silence import Silence

GRACE_NS = SECOND_NS // 2


class RecordedLeg:
    """The state of one leg's recording; in lockstep all legs share the `steps` that gather messages."""

    def __init__(self, node: GraphNode, name: str, run_ns: int, steps: StepCollector):
        self.name = name
        self._run_ns = run_ns
        self.steps = steps
        self._node = node
        self.end_ns = None if node.realtime else run_ns
        self._silence = Silence()
        self._newest_ns: int | None = None
        self._acknowledged_ns = -1
        self._answered = True
        self.joined_late = False  # if its run begins at 0
        self._notice = Notice(node)
        self._recorded = node.publish_to("recorded", leg=name)
        self._end = node.publish_to("end", leg=name)

    def begin(self) -> None:
        """Note that all peers are there: from now on samples are due."""
        self._silence.broken = True

    def sampled(self, stamp_ns: int) -> None:
        """Note that the leg has taken a sample; in real time the run begins with its first."""
        self.joined_late = self.joined_late or (self._newest_ns is None and stamp_ns > 0)
        self._silence.broken = True
        self._newest_ns = stamp_ns
        if self.end_ns is None:
            self.end_ns = stamp_ns + self._run_ns

    def within(self, stamp_ns: int) -> bool:
        """Whether an instant is of the run: references are published ahead, drivers do not end with it."""
        return self.end_ns is None or stamp_ns < self.end_ns

    def is_near(self, stamp_ns: int) -> bool:
        """Whether an instant is not much later than the newest sample."""
        return self._newest_ns is None or stamp_ns <= self._newest_ns + SECOND_NS

    def unhurried(self, sampled: bool, answered: bool) -> bool:
        """Whether what has just come leaves time to write, in real time.

        While the controllers work on a sample the disk would delay their answer. So it has its turn behind
        an answer, or behind a sample if the one before found none.
        """
        late = sampled and not self._answered
        if sampled or answered:
            self._answered = answered
        return answered or late

    def acknowledge(self, steps: int = 1) -> None:
        """Tell the plant how far the bag reaches, if that is so many steps of news."""
        if self.steps.done_ns >= self._acknowledged_ns + steps * self._node.period_ns:
            self._acknowledged_ns = self.steps.done_ns
            self._recorded.publish(messages.time(self._acknowledged_ns))

    def over(self) -> bool:
        """Whether all is recorded, or in real time all that will ever come; RunFailed if no samples come."""
        end_ns = self.end_ns
        if end_ns is None:
            # the plant waits for all others, and its process is watched; a driver waits for nobody
            if self._node.active and not self._node.settings["with_plant"] and self.silence() > self._limit:
                self._report_silence()
            return False
        return self._complete(end_ns) or (self._node.realtime and self._nothing_more(end_ns))

    def report_end(self) -> None:
        """Tell the leg's nodes that the run is over, and wait until they know."""
        self._end.publish(messages.time(self.steps.done_ns))
        for _ in range(5):
            if self._end.wait_for_all_acked(Duration(seconds=0.2)):
                return
            self._node.pulse()

    def _complete(self, end_ns: int) -> bool:
        return self.steps.done_ns >= end_ns - self._node.period_ns

    def _nothing_more(self, end_ns: int) -> bool:
        """Whether something much later has come already.

        The clock is no proof: on a busy machine much may have arrived that nobody has looked at yet.
        """
        assert self._newest_ns is not None  # the first sample has set the end
        silent = self.silence() > self._limit
        if silent and self._newest_ns < end_ns - self._node.period_ns:
            self._report_silence()
            return False
        return self._newest_ns >= end_ns + GRACE_NS or silent

    @property
    def _limit(self) -> float:
        limit: float = self._node.settings["sample_timeout"]
        return limit

    def silence(self) -> float:
        """Return the wall time without a sample, s."""
        return self._silence.look()

    def _report_silence(self) -> None:
        """Raise RunFailed; where nobody would end the others, say it: what is gone may come again."""
        text = f"no sample on {in_leg('joint_states', self.name, self._node.legs)}"
        if self._node.supervised:
            raise RunFailed(f"{text} for {self._limit:g} s: does the driver run?")
        self._notice.say(text)
