# SPDX-License-Identifier: Apache-2.0
"""The one table of topics and of the signals on them.

Nodes take type and peers of a topic from here, the start barrier the number of its peers, the
recorder its list, readers the place of each signal. Topics stand in causal order: within a step a
message depends only on topics above it, so the first one missing names the node that is at fault.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

PLANT = "plant_simulator"
TRAJECTORY = "trajectory_publisher"
POSITION = "position_controller"
EXTENSOR = "extensor_pressure_controller"
FLEXOR = "flexor_pressure_controller"
VALVE = "inverse_valve_model"
RECORDER = "bag_recorder"
NODES = (PLANT, TRAJECTORY, POSITION, EXTENSOR, FLEXOR, VALVE, RECORDER)
SLOW = (TRAJECTORY, POSITION)  # these work at each `control.position.every`-th control period

CLOCK = "/clock"
SECOND_NS = 1_000_000_000
# a writer forgets what is older, read or not; the plant is never so many steps ahead of the recorder
PUBLISHED_DEPTH = 200


@dataclass(frozen=True)
class Topic:
    """One topic: relative name, ROS type, who publishes and who (beside the recorder) listens.

    `rate` is `step` (one message each period of its producer), `answer` (likewise, in real time only),
    `1 Hz` (one from each producer) or `event` (management of the graph, not recorded).
    """

    name: str
    type: str
    producers: tuple[str, ...]
    consumers: tuple[str, ...]
    meaning: str
    unit: str
    rate: str = "step"

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


def _topic(name: str, type_: str, producer: str, consumers: Iterable[str], *rest: str) -> Topic:
    return Topic(name, type_, (producer,), tuple(consumers), *rest)


JOINT, PRESSURE = "sensor_msgs/msg/JointState", "sensor_msgs/msg/FluidPressure"
_OTHERS = tuple(node for node in NODES if node != RECORDER)

TOPICS = (
    _topic(CLOCK, "rosgraph_msgs/msg/Clock", PLANT, [TRAJECTORY], "simulated time", "s"),
    _topic("joint_states", JOINT, PLANT, [POSITION], "measured knee angle", "rad"),
    _topic("extensor/pressure", PRESSURE, PLANT, [POSITION, EXTENSOR, VALVE], "measured pressure", "Pa"),
    _topic("flexor/pressure", PRESSURE, PLANT, [POSITION, FLEXOR, VALVE], "measured pressure", "Pa"),
    _topic("truth", JOINT, PLANT, [], "state of the emulated hardware", "SI"),
    _topic(
        "reference",
        "trajectory_msgs/msg/JointTrajectory",
        TRAJECTORY,
        [POSITION],
        "angle to follow, published one of its periods ahead",
        "rad, rad/s, rad/s^2",
    ),
    _topic("estimate", JOINT, POSITION, [EXTENSOR, FLEXOR], "observer: angle, velocity", "rad, rad/s"),
    _topic(
        "disturbance",
        "geometry_msgs/msg/WrenchStamped",
        POSITION,
        [],
        "observer: disturbance torque tau of Eq. (26), positive against flexion",
        "N m",
    ),
    _topic("extensor/pressure_reference", PRESSURE, POSITION, [EXTENSOR], "pressure to reach", "Pa"),
    _topic("flexor/pressure_reference", PRESSURE, POSITION, [FLEXOR], "pressure to reach", "Pa"),
    _topic("extensor/mass_flow", JOINT, EXTENSOR, [VALVE], "mass flow to reach (velocity)", "kg/s"),
    _topic("flexor/mass_flow", JOINT, FLEXOR, [VALVE], "mass flow to reach (velocity)", "kg/s"),
    _topic("extensor/valve_voltage", JOINT, VALVE, [PLANT], "valve voltage (effort)", "V"),
    _topic("flexor/valve_voltage", JOINT, VALVE, [PLANT], "valve voltage (effort)", "V"),
    _topic(
        "answered",
        "sensor_msgs/msg/TimeReference",
        VALVE,
        [],
        "when the voltages that answer a sample left, real time only",
        "s",
        "answer",
    ),
    Topic(
        "diagnostics",
        "diagnostic_msgs/msg/DiagnosticArray",
        NODES,
        (),
        "health of each node, once a second of its time",
        "-",
        "1 Hz",
    ),
    Topic(
        "configuration",
        "std_msgs/msg/String",
        NODES,
        NODES,
        "what the node was started with, as JSON",
        "-",
        "event",
    ),
    Topic("ready", "std_msgs/msg/String", NODES, (PLANT,), "the node's peers are there", "-", "event"),
    _topic("recorded", "builtin_interfaces/msg/Time", RECORDER, [PLANT], "recorded up to", "s", "event"),
    _topic("end", "builtin_interfaces/msg/Time", RECORDER, _OTHERS, "the run is over", "s", "event"),
)
BY_NAME = {topic.name: topic for topic in TOPICS}
ORDER = {topic.name: index for index, topic in enumerate(TOPICS)}
RECORDED = tuple(topic for topic in TOPICS if topic.recorded and topic.rate != "answer")


def table(realtime: bool = False, with_plant: bool = True, replay: bool = False) -> dict[str, Topic]:
    """Return the topics of a run by name.

    In lockstep `/clock` drives the trajectory, in real time the samples themselves do, and nobody waits
    for the recorder. Without the plant a driver publishes and takes what stands under the plant's name,
    but for the truth and the management of the graph. In a replay a player stands in for all peers,
    under the recorder's name.
    """
    if replay:
        return {name: _replayed(topic) for name, topic in table().items()}
    if not realtime:
        return {topic.name: topic for topic in TOPICS if topic.rate != "answer"}
    topics = {topic.name: topic for topic in TOPICS if topic.name != CLOCK}
    joint = topics["joint_states"]
    topics["joint_states"] = replace(joint, consumers=(*joint.consumers, TRAJECTORY))
    topics["recorded"] = replace(topics["recorded"], consumers=())
    if with_plant:
        return topics
    del topics["truth"]
    return {name: topic if topic.rate == "step" else _without_plant(topic) for name, topic in topics.items()}


def _replayed(topic: Topic) -> Topic:
    if topic.name in ("ready", "configuration"):
        return replace(topic, producers=(RECORDER,), consumers=(RECORDER,))
    return replace(topic, consumers=()) if topic.recorded else topic


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


class Signal(NamedTuple):
    """One number on a topic: its message field, and the joint where the field is a list.

    `point` is that of a trajectory, as an index; `type` that of the topic's messages.
    """

    name: str
    topic: str
    field: str
    joint: str
    unit: str
    point: int = 0
    type: str = ""


def typed(signals: Iterable[Signal], topics: Iterable[Topic]) -> dict[str, Signal]:
    """Return signals by name, each with the type of its topic."""
    types = {topic.name: topic.type for topic in topics}
    return {signal.name: signal._replace(type=types[signal.topic]) for signal in signals}


def _muscle_signals(muscle: str) -> list[Signal]:
    valve = f"{muscle}_valve"
    return [
        Signal(f"{muscle}_pressure", f"{muscle}/pressure", "fluid_pressure", "", "Pa"),
        Signal(
            f"{muscle}_pressure_reference",
            f"{muscle}/pressure_reference",
            "fluid_pressure",
            "",
            "Pa",
        ),
        Signal(f"{muscle}_mass_flow", f"{muscle}/mass_flow", "velocity", valve, "kg/s"),
        Signal(f"{muscle}_voltage", f"{muscle}/valve_voltage", "effort", valve, "V"),
        Signal(f"truth_{muscle}_contraction", "truth", "position", muscle, "m"),
        Signal(f"truth_{muscle}_rate", "truth", "velocity", muscle, "m/s"),
        Signal(f"truth_{muscle}_force", "truth", "effort", muscle, "N"),
        Signal(f"truth_{muscle}_pressure", "truth", "effort", f"{muscle}_gas", "Pa"),
        Signal(f"truth_{muscle}_flow", "truth", "velocity", f"{muscle}_gas", "kg/s"),
    ]


_SIGNALS = (
    Signal("angle", "joint_states", "position", "knee", "rad"),
    Signal("reference_angle", "reference", "positions", "knee", "rad"),
    Signal("reference_velocity", "reference", "velocities", "knee", "rad/s"),
    Signal("reference_acceleration", "reference", "accelerations", "knee", "rad/s^2"),
    Signal("followed_angle", "reference", "positions", "knee", "rad", -1),  # with a plan that of the plan
    Signal("estimate_angle", "estimate", "position", "knee", "rad"),
    Signal("estimate_velocity", "estimate", "velocity", "knee", "rad/s"),
    Signal("disturbance", "disturbance", "wrench.torque.y", "", "N m"),
    Signal("truth_angle", "truth", "position", "knee", "rad"),
    Signal("truth_velocity", "truth", "velocity", "knee", "rad/s"),
    Signal("truth_torque", "truth", "effort", "knee", "N m"),
    *_muscle_signals("extensor"),
    *_muscle_signals("flexor"),
)
SIGNALS = typed(_SIGNALS, TOPICS)
