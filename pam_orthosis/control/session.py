# SPDX-License-Identifier: Apache-2.0
"""A training session of both legs, each with a safety monitor: in one process, or what leads a graph.

The stages of a programme follow each other by the strides that were made. After a trip both legs stop; it
goes on when the monitor allows it, as if a therapist had looked.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control.cooperation import CooperativeController
from pam_orthosis.control.limits import SafetyMonitor, Trip
from pam_orthosis.control.loop import TOLD, ClosedLoop, Watched
from pam_orthosis.control.programme import Programme, Stage
from pam_orthosis.control.reference import Motion
from pam_orthosis.control.trajectory import Trajectory, make_trajectory
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, Section
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


class Follower:
    """A person who is told a cadence, or to rest, while they walk, and intends that from then on.

    Args:
        parameters: those with which they began.
    """

    def __init__(self, parameters: Parameters):
        self._will = parameters.plant.person.volition
        trajectory = make_trajectory(parameters.changed({"scenario.cycle_time": self._will.cycle_time}))
        if not isinstance(trajectory, Trajectory):
            raise OrthosisError("in an experiment nobody is told how to walk")
        self._trajectory = trajectory

    def hear(self, will: Section, time_ns: int) -> None:
        """Take `plant.person.volition` at an instant."""
        if will.cycle_time != self._will.cycle_time:
            self._trajectory.set_cycle_time(time_ns, will.cycle_time)
        if will.resting and not self._trajectory.stopped:
            self._trajectory.stop(time_ns)
        elif self._trajectory.stopped and not will.resting:
            self._trajectory.go_on(time_ns)
        self._will = will

    def aim(self, time: float) -> Motion:
        """Return the motion that they intend at a time, s."""
        return Motion(*self._trajectory.sample(round(time * 1e9))[:3])


class Leg:
    """What a programme changes of one leg: here its reference alone, without hardware."""

    def __init__(self, parameters: Parameters):
        self.parameters = parameters
        trajectory = make_trajectory(parameters)
        assert isinstance(trajectory, Trajectory)  # the programme's scenario is a gait
        self.trajectory = trajectory

    def enter(self, stage: Stage, time_ns: int) -> None:
        """Take mode and cadence of a stage; rest or go on."""
        before, self.parameters = self.parameters, self.parameters.changed(stage.changes)
        if self.parameters.scenario.cycle_time != before.scenario.cycle_time:
            self.trajectory.set_cycle_time(time_ns, self.parameters.scenario.cycle_time)
        if stage.pause:
            self.stop(time_ns)
        elif self.trajectory.stopped:
            self.go_on(time_ns)

    def stop(self, time_ns: int) -> None:
        """Come to rest."""
        self.trajectory.stop(time_ns)

    def go_on(self, time_ns: int) -> None:
        """Walk on."""
        self.trajectory.go_on(time_ns)

    def trips(self) -> Sequence[Trip]:
        """Return the limits that were exceeded, until it is resumed."""
        return ()

    def resume(self) -> str:
        """Have the monitor let it go on; return why it does not, or nothing."""
        return ""


class SimulatedLeg(Leg):
    """A leg as the closed loop emulates it, with its safety monitor."""

    def __init__(self, parameters: Parameters):
        super().__init__(parameters)
        plant = Plant(parameters, parameters.scenario.seed)
        self._monitor, self._controller = SafetyMonitor(parameters), CooperativeController(parameters)
        watched = Watched(plant, self._monitor)
        self.loop = ClosedLoop(parameters, 0, watched, self.trajectory, self._controller)
        plant.intend(lambda time: self.trajectory.sample(round(time * 1e9))[:3])
        self.rows: list[tuple[float, ...]] = []

    def enter(self, stage: Stage, time_ns: int) -> None:
        """Take mode and cadence of a stage; rest or go on."""
        super().enter(stage, time_ns)
        self._controller.retune(self.parameters)

    def trips(self) -> Sequence[Trip]:
        """Return the limits that were exceeded, until it is resumed."""
        return self._monitor.trips

    def resume(self) -> str:
        """Have the monitor let it go on; return why it does not, or nothing."""
        return self._monitor.resume()


class Course:
    """How a programme goes on: call `begin`, then `after` each step, until it is `over`.

    Args:
        programme: stages, and when it goes on after a trip.
        legs: by namespace; all have the reference of the first at heart.

    Attributes:
        strides, trips: what was done, and what was exceeded.
        ended: why it ended early, if so.
    """

    def __init__(self, programme: Programme, legs: Mapping[str, Leg]):
        self._programme, self._legs = programme, legs
        first = next(iter(legs.values()))
        s = first.parameters.scenario
        self.period_ns: int = round(s.control_period * 1e9)
        self._phase = first.trajectory.phase
        self._stage, self._begun, self._made = -1, 0, 0  # number of the stage, its first sample, its strides
        self._from, self._last = 0.0, 0  # phase at its beginning, sample at which the last stride ended
        self._tripped: int | None = None
        self._stops = 0  # by trips in this stage
        self._slowing: float = s.start_ramp  # time until it rests, s
        self.strides: list[Done] = []
        self.trips: list[Event] = []
        self.ended = ""

    @property
    def over(self) -> bool:
        """Whether all stages are done, or it has ended early."""
        return self._stage >= len(self._programme.stages) or bool(self.ended)

    def begin(self) -> None:
        """Enter the first stage."""
        self._enter(0)

    def after(self, index: int) -> None:
        """Look at what so many steps have brought."""
        self._watch(index)
        self._count(index)

    def give_up(self, index: int, why: str) -> None:
        """Bring all legs to rest after so many steps, and end early."""
        self._each(lambda leg: leg.stop(index * self.period_ns))
        self.ended = why

    def _each(self, do: Callable[[Leg], Any]) -> None:
        for leg in self._legs.values():
            do(leg)

    def _enter(self, index: int) -> None:
        """Begin the next stage, if there is one."""
        self._stage += 1
        self._begun, self._made, self._last, self._stops = index, 0, index, 0
        if self._stage < len(self._programme.stages):
            stage, time_ns = self._programme.stages[self._stage], index * self.period_ns
            self._from = self._phase(time_ns)[0]
            self._each(lambda leg: leg.enter(stage, time_ns))

    def _count(self, index: int) -> None:
        """Note a stride that has ended, and a stage."""
        stage = self._programme.stages[self._stage]
        if self._tripped is not None:
            return
        if stage.pause:
            if (index - self._begun) * self.period_ns * 1e-9 >= self._slowing + stage.pause:
                self._enter(index)
            return
        if self._phase(index * self.period_ns)[0] - self._from >= self._made + 1:
            self.strides.append(Done(self._stage, self._last, index))
            self._made, self._last = self._made + 1, index
            if self._made == stage.strides:
                self._enter(index)

    def _watch(self, index: int) -> None:
        """Stop both legs when a limit of one is exceeded; go on when the monitors allow it."""
        tripped = {name: leg for name, leg in self._legs.items() if leg.trips()}
        time_ns = index * self.period_ns
        if self._tripped is None:
            if tripped:
                self._stop(tripped, index)
            return
        waited = (index - self._tripped) * self.period_ns * 1e-9
        if waited < self._programme.resume:
            return
        refusals = [refusal for leg in tripped.values() if (refusal := leg.resume())]
        if refusals and waited > self._programme.resume + PATIENCE_S:
            self.ended = f"the safety monitor does not let it go on: {refusals[0]}"
        if not refusals:
            self._tripped = None
            if self._programme.stages[self._stage].strides:
                self._each(lambda leg: leg.go_on(time_ns))

    def _stop(self, tripped: dict[str, Leg], index: int) -> None:
        """Stop both legs and note the trips; after too many in a stage the session ends."""
        for name, leg in tripped.items():
            trip = leg.trips()[0]
            self.trips.append(Event(name, trip.limit, trip.time_ns * 1e-9, trip.value, trip.allowed))
        self._tripped, self._stops = index, self._stops + 1
        self._each(lambda leg: leg.stop(index * self.period_ns))
        if self._stops >= STOPS_MOST:
            name = self._programme.stages[self._stage].name
            self.ended = f"{self._stops} stops by the safety monitor in the stage {name}"


class Session(Course):
    """Both legs through a programme, in simulation."""

    def __init__(self, programme: Programme):
        self._simulated = {name: SimulatedLeg(one) for name, one in programme.legs.items()}
        super().__init__(programme, self._simulated)

    def run(self, progress: Progress = silent) -> Trained:
        """Train to the end."""
        total = sum(stage.strides or 1 for stage in self._programme.stages)
        self.begin()
        index = 0
        while not self.over:
            if not index % TOLD:
                progress("training", len(self.strides), total)
            self.step(index)
            index += 1
            self.after(index)
        signals = {
            name: dict(zip(leg.loop.signals, np.array(leg.rows).T, strict=True))
            for name, leg in self._simulated.items()
        }
        return Trained(signals, self.strides, self.trips, self.ended)

    def step(self, index: int) -> None:
        """Let both legs do a step."""
        for leg in self._simulated.values():
            leg.rows.append(leg.loop.step(index))


def planned_seconds(programme: Programme) -> float:
    """Return how long a programme takes if nothing trips, s."""
    course, index = Course(programme, {name: Leg(one) for name, one in programme.legs.items()}), 0
    course.begin()
    while not course.over:
        index += 1
        course.after(index)
    return index * course.period_ns * 1e-9


def as_led(parameters: Parameters, programme: Programme, seconds: float) -> Parameters:
    """Return with what a graph begins that is led through a programme, for so long, in its first stage.

    Raises:
        OrthosisError: it begins with a pause.
    """
    stage = programme.stages[0]
    if stage.pause:
        raise OrthosisError("stages: in the graph the first one must have strides")
    begun = parameters.changed(
        {**stage.changes, "scenario.duration": seconds, "control.limits.enabled": True}
    )
    return begun.changed({"plant.person.volition.cycle_time": begun.scenario.cycle_time})


def trained_in(kept: Mapping[str, Any]) -> Trained:
    """Return a session, without signals, of a record of it."""
    strides, trips = [Done(*one) for one in kept["strides"]], [Event(*one) for one in kept["trips"]]
    return Trained({}, strides, trips, kept["ended"])
