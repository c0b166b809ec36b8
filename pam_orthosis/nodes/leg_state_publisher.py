# SPDX-License-Identifier: Apache-2.0
"""Node: shows a leg to rviz, Lichtblick and the like: `robot_description`, TF, joints, muscles as markers.

It listens to a running graph, a driver or a played bag, and nothing waits for it. TF needs `tf2_msgs`, which
every ROS installation has and PyPI has not; without it, `leg_joints` gives TF by a robot_state_publisher. The
leg is that of the parameters: give those of the run, e.g. `-p leg.person.present:=true`.
"""

from collections.abc import Callable

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import qos_profile_sensor_data

from pam_orthosis.bag.cdr import serialised_stamp_ns
from pam_orthosis.errors import OrthosisError
from pam_orthosis.nodes import process, transport
from pam_orthosis.nodes.layout import SHOWN, NodeSpec
from pam_orthosis.nodes.parameters import MACHINE, Setting, declare_rows, declare_settings, machine_of
from pam_orthosis.scene.messages import DESCRIPTION, LATCHED, TYPES, Scene
from pam_orthosis.scene.sampled import SampledScene

NAME = "leg_state_publisher"
SPEC = NodeSpec(NAME, NAME, SHOWN)


class LegStatePublisher(Node):
    """Publishes where the leg is at each sample that is due, and once what it is like."""

    def __init__(self) -> None:
        super().__init__(NAME)
        leg = Setting("", "namespace of the leg if it is one of several: the prefix of its frames")
        legs = Setting("", "namespaces of all legs, from left to right, comma between; none: one leg")
        self.settings = declare_settings(self, {**MACHINE, "leg": leg, "legs": legs})
        parameters = declare_rows(self, machine_of(self.settings), SPEC)
        names = self.settings["legs"].split(",") if self.settings["legs"] else [self.settings["leg"]]
        if self.settings["leg"] not in names:
            raise OrthosisError(f"{NAME}: leg {self.settings['leg']} is none of {', '.join(names)}")
        scene = Scene(parameters, self.settings["leg"], names)
        self._scene = SampledScene(scene, again=True)
        self._outputs = {topic: self._publisher(topic) for topic in TYPES}
        self.declare_parameter(DESCRIPTION, scene.description)
        for topic, name in self._scene.inputs.items():
            kind = transport.message_class(name)
            receive = self._receiver(topic)
            self.create_subscription(kind, topic, receive, qos_profile_sensor_data, raw=True)

    def _publisher(self, topic: str) -> Publisher | None:
        try:
            kind = transport.message_class(TYPES[topic])
        except ModuleNotFoundError as error:
            self.get_logger().warning(f"{topic} is not published: {error.name} is not installed")
            return None
        return self.create_publisher(kind, topic, transport.qos(latched=topic in LATCHED))

    def _receiver(self, topic: str) -> Callable[[bytes], None]:
        def receive(data: bytes) -> None:
            for said in self._scene.add(topic, serialised_stamp_ns(data), data):
                publisher = self._outputs[said.topic]
                if publisher:
                    publisher.publish(said.data)

        return receive


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    signals = process.caught_signals()
    return process.follow(lambda: process.spin_while(LegStatePublisher(), lambda: not signals))
