# SPDX-License-Identifier: Apache-2.0
"""A training session of both legs without ROS: the cores of the nodes, a safety monitor for each leg.

The stages of a programme follow each other by the strides that were made. After a trip both legs stop; it
goes on when the monitor allows it, as if a therapist had looked.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.limits import SafetyMonitor
from pam_orthosis.control.loop import TOLD, ClosedLoop, Watched
from pam_orthosis.control.programme import Programme, Stage
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant
from pam_orthosis.progress import Progress, silent

PATIENCE_S = 60.0  # for a monitor that does not let the training go on, after which it ends
STOPS_MOST = 3  # in one stage: its limits and its mode do not suit the person


class Event(NamedTuple):
    """A trip: which leg, which limit, when, s, what was measured and what is allowed, SI."""

    leg: str
    limit: str
    time: float
    value: float
    allowed: float


class Done(NamedTuple):
    """A stride as the reference went through it: number of its stage, samples from and to (not included)."""

    stage: int
    first: int
    end: int


class Trained(NamedTuple):
    """A session: signals of `ClosedLoop.run` of each leg, strides, trips, and why it ended early, if so."""

    signals: dict[str, dict[str, NDArray[np.float64]]]
    strides: list[Done]
    trips: list[Event]
    ended: str


class Leg:
    """One leg: closed loop, its monitor, and what the programme changes."""

    def __init__(self, parameters: Parameters):
        plant = Plant(parameters, parameters.scenario.seed)
        self._parameters = parameters
        trajectory = make_trajectory(parameters)
        assert isinstance(trajectory, Trajectory)  # the programme's scenario is a gait
        self.trajectory = trajectory
        self.monitor, self._controller = SafetyMonitor(parameters), CooperativeController(parameters)
        watched = Watched(plant, self.monitor)
        self.loop = ClosedLoop(parameters, 0, watched, trajectory, self._controller)
        plant.intend(lambda time: trajectory.sample(round(time * 1e9))[:3])
        self.slowing: float = parameters.scenario.start_ramp  # time until it rests, s
        self.rows: list[tuple[float, ...]] = []

    def enter(self, stage: Stage, time_ns: int) -> None:
        """Take mode and cadence of a stage; rest or go on."""
        parameters = self._parameters.changed(stage.changes)
        self._controller.retune(parameters)
        if parameters.scenario.cycle_time != self._parameters.scenario.cycle_time:
            self.trajectory.set_cycle_time(time_ns, parameters.scenario.cycle_time)
        self._parameters = parameters
        if stage.pause:
            self.trajectory.stop(time_ns)
        elif self.trajectory.stopped:
            self.trajectory.go_on(time_ns)


class Session:
    """Both legs through a programme."""

    def __init__(self, programme: Programme):
        self._programme = programme
        self._legs = {name: Leg(one) for name, one in programme.legs.items()}
        first = next(iter(self._legs.values()))
        self._period_ns, self._phase = first.loop.plant.period_ns, first.trajectory.phase
        self._stage, self._begun, self._made = -1, 0, 0  # number of the stage, its first sample, its strides
        self._from, self._last = 0.0, 0  # phase at its beginning, sample at which the last stride ended
        self._tripped: int | None = None
        self._stops = 0  # by trips in this stage
        self._slowing = first.slowing
        self.strides: list[Done] = []
        self.trips: list[Event] = []
        self.ended = ""

    def run(self, progress: Progress = silent) -> Trained:
        """Train to the end."""
        total = sum(stage.strides or 1 for stage in self._programme.stages)
        self._enter(0)
        index = 0
        while self._stage < len(self._programme.stages) and not self.ended:
            if not index % TOLD:
                progress("training", len(self.strides), total)
            for leg in self._legs.values():
                leg.rows.append(leg.loop.step(index))
            index += 1
            self._watch(index)
            self._count(index)
        names = next(iter(self._legs.values())).loop.signals
        signals = {
            name: dict(zip(names, np.array(leg.rows).T, strict=True)) for name, leg in self._legs.items()
        }
        return Trained(signals, self.strides, self.trips, self.ended)

    def _each(self, do: Callable[[Leg], Any]) -> None:
        for leg in self._legs.values():
            do(leg)

    def _enter(self, index: int) -> None:
        """Begin the next stage, if there is one."""
        self._stage += 1
        self._begun, self._made, self._last, self._stops = index, 0, index, 0
        if self._stage < len(self._programme.stages):
            stage, time_ns = self._programme.stages[self._stage], index * self._period_ns
            self._from = self._phase(time_ns)[0]
            self._each(lambda leg: leg.enter(stage, time_ns))

    def _count(self, index: int) -> None:
        """Note a stride that has ended, and a stage."""
        stage = self._programme.stages[self._stage]
        if self._tripped is not None:
            return
        if stage.pause:
            if (index - self._begun) * self._period_ns * 1e-9 >= self._slowing + stage.pause:
                self._enter(index)
            return
        if self._phase(index * self._period_ns)[0] - self._from >= self._made + 1:
            self.strides.append(Done(self._stage, self._last, index))
            self._made, self._last = self._made + 1, index
            if self._made == stage.strides:
                self._enter(index)

    def _watch(self, index: int) -> None:
        """Stop both legs when a limit of one is exceeded; go on when the monitors allow it."""
        tripped = {name: leg for name, leg in self._legs.items() if leg.monitor.trips}
        time_ns = index * self._period_ns
        if self._tripped is None:
            if tripped:
                self._stop(tripped, index)
            return
        waited = (index - self._tripped) * self._period_ns * 1e-9
        if waited < self._programme.resume:
            return
        refusals = [refusal for leg in tripped.values() if (refusal := leg.monitor.resume())]
        if refusals and waited > self._programme.resume + PATIENCE_S:
            self.ended = f"the safety monitor does not let it go on: {refusals[0]}"
        if not refusals:
            self._tripped = None
            if self._programme.stages[self._stage].strides:
                self._each(lambda leg: leg.trajectory.go_on(time_ns))

    def _stop(self, tripped: dict[str, Leg], index: int) -> None:
        """Stop both legs and note the trips; after too many in a stage the session ends."""
        for name, leg in tripped.items():
            trip = leg.monitor.trips[0]
            self.trips.append(Event(name, trip.limit, trip.time_ns * 1e-9, trip.value, trip.allowed))
        self._tripped, self._stops = index, self._stops + 1
        self._each(lambda leg: leg.trajectory.stop(index * self._period_ns))
        if self._stops >= STOPS_MOST:
            name = self._programme.stages[self._stage].name
            self.ended = f"{self._stops} stops by the safety monitor in the stage {name}"
