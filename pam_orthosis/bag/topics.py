# SPDX-License-Identifier: Apache-2.0
"""The one table of topics and of the signals on them, as a machine has them.

Nodes take type and peers of a topic from here, the start barrier the number of its peers, the
recorder its list, readers the place of each signal. Topics stand in causal order: within a step a
message depends only on topics above it, so the first one missing names the node that is at fault.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from pam_orthosis.model.parameters import Parameters

if TYPE_CHECKING:
    from pam_orthosis.model.machine import Machine


PLANT = "plant_simulator"
TRAJECTORY = "trajectory_publisher"
POSITION = "position_controller"
VALVE = "inverse_valve_model"
SAFETY = "safety_monitor"  # of runs that have one
RECORDER = "bag_recorder"
CONTROLLER = "{}_pressure_controller"
SLOW = (TRAJECTORY, POSITION)  # these work at each `control.position.every`-th control period

VALVE_COMMAND = "/valve_command"  # behind the actuator's name
CLOCK = "/clock"
JOINT, PRESSURE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/FluidPressure"
WRENCH, MOTION = "geometry_msgs/msg/WrenchStamped", "trajectory_msgs/msg/JointTrajectory"
VECTOR = "geometry_msgs/msg/Vector3Stamped"
SAMPLE, REFERENCE, ANSWERED, TRUTH = "joint_states", "reference", "answered", "truth"
ANEW = "begun_anew"  # in the reports of hardware that began while a run was on: when
DIAGNOSTICS = "/diagnostics"  # common to all legs, as is the custom
EMERGENCY_STOP = "emergency_stop"
# what is asked for beside the motion, in runs that ask for it
MEAN_PRESSURE, PLANNED = "reference_pressure", "planned_reference"
ALLOWED = "allowed_pressure"  # of the safety monitor
BESIDE = "beside_reference"
TIME_REFERENCE = "sensor_msgs/msg/TimeReference"
DISTURBANCE = {"rotation": "wrench.torque.y", "translation": "wrench.force.x"}  # along REP-103's axes
SECOND_NS = 1_000_000_000
# a writer forgets what is older, read or not; the plant is never so many steps ahead of the recorder
PUBLISHED_DEPTH = 200


@dataclass(frozen=True)
class Topic:
    """One topic: relative name, ROS type, who publishes and who (beside the recorder) listens.

    `rate` is `step` (one message each period of its producer), `answer` (likewise, in real time only),
    `1 Hz` (one from each producer) or `event` (management of the graph, not recorded). An `optional` one is
    there if the run's references ask for it.
    """

    name: str
    type: str
    producers: tuple[str, ...]
    consumers: tuple[str, ...]
    meaning: str
    unit: str
    rate: str = "step"
    optional: bool = False

    @property
    def recorded(self) -> bool:
        """Whether the recorder listens."""
        return self.rate != "event"

    @property
    def shared(self) -> bool:
        """Whether nodes of other programs may publish there too, as is the custom in ROS."""
        return self.rate == "1 Hz"

    @property
    def slow(self) -> bool:
        """Whether there is a message at each step of the position controller only.

        The clock ticks for the trajectory, which is as slow.
        """
        return self.rate == "step" and (self.producers[0] in SLOW or self.name == CLOCK)

    @property
    def subscribers(self) -> tuple[str, ...]:
        """All nodes that listen, the recorder included."""
        return (*self.consumers, RECORDER) if self.recorded else self.consumers


class Signal(NamedTuple):
    """One number on a topic: its message field, and the joint where the field is a list.

    `type` is that of the topic's messages. A `spool` position is read as the voltage that asks for it. Where
    there is no such topic the signal is read from that of the name `instead`.
    """

    name: str
    topic: str
    field: str
    joint: str
    unit: str
    type: str = ""
    spool: bool = False
    instead: str = ""


def typed(signals: Iterable[Signal], topics: Iterable[Topic]) -> dict[str, Signal]:
    """Return signals by name, each with the type of its topic."""
    types = {topic.name: topic.type for topic in topics}
    return {signal.name: signal._replace(type=types[signal.topic]) for signal in signals}


class Topics:
    """Nodes, topics and signals of a machine's graph."""

    def __init__(self, machine: Machine):
        self.machine = machine
        self.controllers = {CONTROLLER.format(name): name for name in machine.names}
        self.nodes = (PLANT, TRAJECTORY, POSITION, *self.controllers, VALVE, RECORDER)
        self.sensors = (SAMPLE, *(f"{name}/pressure" for name in machine.names))
        self.commands = tuple(f"{name}{VALVE_COMMAND}" for name in machine.names)

    @cached_property
    def all(self) -> tuple[Topic, ...]:
        """All topics."""
        return (*self._measured(), *self._computed(), *self._managing())

    @cached_property
    def by_name(self) -> dict[str, Topic]:
        """All topics by name."""
        return {topic.name: topic for topic in self.all}

    @property
    def recorded(self) -> tuple[Topic, ...]:
        """What a bag holds of each run in lockstep."""
        return tuple(topic for topic in self.of_run().values() if topic.recorded)

    def of_run(
        self,
        realtime: bool = False,
        with_plant: bool = True,
        replay: bool = False,
        beside: Collection[str] = (),
    ) -> dict[str, Topic]:
        """Return the topics of a run by name; `beside` names the optional ones among them.

        In lockstep `/clock` drives the trajectory, in real time the samples themselves do, and nobody waits
        for the recorder. Without the plant a driver publishes and takes what stands under the plant's name,
        but for the truth and most management of the graph. In a replay a player stands in for all peers,
        under the recorder's name.
        """
        if replay:
            return {name: _replayed(topic) for name, topic in self.of_run(beside=beside).items()}
        some = [topic for topic in self.all if not topic.optional or topic.name in beside]
        some = list(map(self._watched, some)) if ALLOWED in beside else some
        if not realtime:
            return {topic.name: topic for topic in some if topic.rate != "answer"}
        topics = _by_wall_clock({topic.name: topic for topic in some if topic.name != CLOCK})
        return topics if with_plant else _driven(topics)

    @cached_property
    def signals(self) -> dict[str, Signal]:
        """Signals by name, each with the type of its topic."""
        return typed([*self._of_the_coordinate(), *self._of_actuators()], self.all)

    def _measured(self) -> Iterator[Topic]:
        coordinate, plant = self.machine.coordinate, (PLANT,)
        yield Topic(CLOCK, "rosgraph_msgs/msg/Clock", plant, (TRAJECTORY,), "simulated time", "s")
        what = f"measured {self.machine.name} {coordinate.name}"
        yield Topic(SAMPLE, JOINT, plant, (POSITION,), what, coordinate.unit)
        for node, name in self.controllers.items():
            listeners = (POSITION, node, VALVE)
            yield Topic(f"{name}/pressure", PRESSURE, plant, listeners, "measured pressure", "Pa")
        what = f"true {coordinate.name} and {coordinate.effort}; contraction, rate, force of each actuator"
        yield Topic(TRUTH, JOINT, plant, (), what, "SI")
        for name in self.machine.names:
            yield Topic(f"{TRUTH}/{name}/pressure", PRESSURE, plant, (), "true pressure", "Pa")
            yield Topic(f"{TRUTH}/{name}/mass_flow", VECTOR, plant, (), "true mass flow, x into it", "kg/s")

    def _computed(self) -> Iterator[Topic]:
        c, controllers = self.machine.coordinate, self.controllers
        reference, position, valve = (TRAJECTORY,), (POSITION,), (VALVE,)
        place, motion = f"{c.unit}, {c.unit}/s", f"{c.unit}, {c.unit}/s, {c.unit}/s^2"
        what = f"{c.name} to follow, published one of its periods ahead"
        yield Topic(REFERENCE, MOTION, reference, position, what, motion)
        what = "mean pressure to hold meanwhile, in runs that ask for one"
        yield Topic(MEAN_PRESSURE, PRESSURE, reference, position, what, "Pa", optional=True)
        what = "motion that is followed instead, in runs by a plan"
        yield Topic(PLANNED, MOTION, reference, position, what, motion, optional=True)
        if self.machine.coupled:
            what = f"motion that the {self.machine.neighbour} is to follow"
            yield Topic(BESIDE, MOTION, reference, position, what, motion)
        yield Topic("estimate", JOINT, position, tuple(controllers), f"observer: {c.name}, velocity", place)
        what = f"observer: disturbance {c.effort} tau of Eq. (26), positive against a rising {c.name}"
        yield Topic("disturbance", WRENCH, position, (), what, c.effort_unit)
        what = f"reference, feedback, error; output: {c.effort} that is asked of the actuators"
        yield Topic("controller_state", JOINT, position, (), what, f"{place}, {c.effort_unit}")
        for node, name in controllers.items():
            yield Topic(f"{name}/pressure_reference", PRESSURE, position, (node,), "pressure to reach", "Pa")
        what = "pressure above which no valve fills, in runs with a safety monitor"
        yield Topic(ALLOWED, PRESSURE, (SAFETY,), valve, what, "Pa", optional=True)
        for node, name in controllers.items():
            yield Topic(f"{name}/mass_flow", VECTOR, (node,), valve, "mass flow to reach, x into it", "kg/s")
        for name in self.commands:
            what = "position of the valve's spool, -1 vent, 0 closed, 1 fill"
            yield Topic(name, JOINT, valve, (PLANT,), what, "1")
        what = "when the commands that answer a sample left, real time only"
        yield Topic(ANSWERED, TIME_REFERENCE, valve, (), what, "s", "answer")

    def _watched(self, topic: Topic) -> Topic:
        """Return a topic as it is with a safety monitor: it hears sensors and commands, and may stop all."""
        watched = (*self.sensors, *self.commands, "end")
        shared = (EMERGENCY_STOP, "configuration")
        hears = topic.name in watched + shared
        says = topic.name in (*shared, DIAGNOSTICS, "ready")
        return replace(
            topic,
            producers=topic.producers + (SAFETY,) * says,
            consumers=topic.consumers + (SAFETY,) * hears,
        )

    def _managing(self) -> Iterator[Topic]:
        nodes, text, instant = self.nodes, "std_msgs/msg/String", "builtin_interfaces/msg/Time"
        what = "health of each node, once a second of its time"
        yield Topic(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray", nodes, (), what, "-", "1 Hz")
        ends = (VALVE, PLANT)
        what = "whether there is an emergency stop: kept at both ends of the commands"
        told = (*ends, POSITION, *self.controllers)
        yield Topic(EMERGENCY_STOP, "diagnostic_msgs/msg/DiagnosticArray", ends, told, what, "-", "event")
        what = "what the node was started with, as JSON"
        yield Topic("configuration", text, nodes, nodes, what, "-", "event")
        yield Topic("ready", text, nodes, (PLANT,), "the node's peers are there", "-", "event")
        yield Topic("recorded", instant, (RECORDER,), (PLANT,), "recorded up to", "s", "event")
        yield Topic("end", instant, (RECORDER,), nodes[:-1], "the run is over", "s", "event")

    def _of_the_coordinate(self) -> Iterator[Signal]:
        c, joint = self.machine.coordinate, self.machine.name
        velocity = f"{c.unit}/s"
        yield Signal(c.name, SAMPLE, "position", joint, c.unit)
        yield Signal(f"reference_{c.name}", REFERENCE, "positions", joint, c.unit)
        yield Signal("reference_velocity", REFERENCE, "velocities", joint, velocity)
        yield Signal("reference_acceleration", REFERENCE, "accelerations", joint, f"{velocity}^2")
        yield Signal(f"followed_{c.name}", PLANNED, "positions", joint, c.unit, instead=REFERENCE)
        yield Signal(f"estimate_{c.name}", "estimate", "position", joint, c.unit)
        yield Signal("estimate_velocity", "estimate", "velocity", joint, velocity)
        yield Signal("disturbance", "disturbance", DISTURBANCE[c.kind], "", c.effort_unit)
        yield Signal(f"truth_{c.name}", TRUTH, "position", joint, c.unit)
        yield Signal("truth_velocity", TRUTH, "velocity", joint, velocity)
        yield Signal(f"truth_{c.effort}", TRUTH, "effort", joint, c.effort_unit)

    def _of_actuators(self) -> Iterator[Signal]:
        for name in self.machine.names:
            valve, asked = f"{name}_valve", f"{name}/pressure_reference"
            yield Signal(f"{name}_pressure", f"{name}/pressure", "fluid_pressure", "", "Pa")
            yield Signal(f"{name}_pressure_reference", asked, "fluid_pressure", "", "Pa")
            yield Signal(f"{name}_mass_flow", f"{name}/mass_flow", "vector.x", "", "kg/s")
            yield Signal(f"{name}_voltage", f"{name}/valve_command", "position", valve, "V", spool=True)
            yield Signal(f"truth_{name}_contraction", TRUTH, "position", name, "m")
            yield Signal(f"truth_{name}_rate", TRUTH, "velocity", name, "m/s")
            yield Signal(f"truth_{name}_force", TRUTH, "effort", name, "N")
            yield Signal(f"truth_{name}_pressure", f"{TRUTH}/{name}/pressure", "fluid_pressure", "", "Pa")
            yield Signal(f"truth_{name}_flow", f"{TRUTH}/{name}/mass_flow", "vector.x", "", "kg/s")


def _replayed(topic: Topic) -> Topic:
    if topic.name in ("ready", "configuration"):
        return replace(topic, producers=(RECORDER,), consumers=(RECORDER,))
    return replace(topic, consumers=()) if topic.recorded else topic


def _by_wall_clock(topics: Mapping[str, Topic]) -> dict[str, Topic]:
    joint = topics[SAMPLE]
    heard = replace(joint, consumers=(*joint.consumers, TRAJECTORY))
    return {**topics, SAMPLE: heard, "recorded": replace(topics["recorded"], consumers=())}


def _driven(topics: Mapping[str, Topic]) -> dict[str, Topic]:
    """Return topics with a hardware driver in place of the plant."""
    there = {name: topic for name, topic in topics.items() if name.split("/")[0] != TRUTH}
    by_driver = {name for name, one in there.items() if one.rate == "step" or name == EMERGENCY_STOP}
    return {name: one if name in by_driver else _without_plant(one) for name, one in there.items()}


def _without_plant(topic: Topic) -> Topic:
    return replace(
        topic,
        producers=tuple(node for node in topic.producers if node != PLANT),
        consumers=tuple(node for node in topic.consumers if node != PLANT),
    )


def in_leg(name: str, leg: str, legs: Sequence[str]) -> str:
    """Return the name that a leg's topic has for what serves several legs, relative to all of them.

    A leg is the namespace of its nodes, none if there is one leg only. The first leg's clock is that
    of the run; the others keep theirs to themselves.
    """
    if not leg or (name.startswith("/") and leg == legs[0]):
        return name
    return f"/{leg}{name}" if name.startswith("/") else f"{leg}/{name}"


def resolve(name: str, namespace: str = "") -> str:
    """Return the absolute name of a topic of the table inside a namespace, `left` or `/left`."""
    if name.startswith("/"):
        return name
    leg = namespace.strip("/")
    return f"/{leg}/{name}" if leg else f"/{name}"


def is_health_instant(stamp_ns: int, period_ns: int) -> bool:
    """Whether the step at `stamp_ns` is the first of its second, when nodes report their health."""
    return stamp_ns // SECOND_NS != (stamp_ns - period_ns) // SECOND_NS


def asked_beside(parameters: Parameters) -> tuple[str, ...]:
    """Return the optional topics of a run: experiments ask for a mean pressure, plans for a motion too."""
    from pam_orthosis.control.diagnostic import EXPERIMENTS  # names of topics alone need no controllers

    scenario = parameters.scenario
    watched = (ALLOWED,) if parameters.control.limits.enabled else ()
    if scenario.trajectory in EXPERIMENTS:
        return (MEAN_PRESSURE, *watched)
    return (MEAN_PRESSURE, PLANNED, *watched) if scenario.plan.enabled else watched
