# SPDX-License-Identifier: Apache-2.0
"""The node that shows a leg: it describes it, follows its measurements, and says what it cannot publish."""

from importlib.util import find_spec

import numpy as np
import pytest
from live_runs import wait_for
from rosbags.typesys import Stores, get_typestore

pytest.importorskip("rclpy")
import rclpy
from own_domain import own_domain
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.model.parameters import load
from pam_orthosis.nodes import messages, transport
from pam_orthosis.nodes.leg_state_publisher import LegStatePublisher
from pam_orthosis.scene.messages import PERIOD_NS

PERSON = "leg.person.present:=true"


class Stage:
    """The node, somebody who measures and somebody who looks, in one domain and one executor."""

    def __init__(self, *settings):
        words = [word for setting in settings for word in ("-p", setting)]
        rclpy.init(args=["--ros-args", *words], domain_id=own_domain())
        self.node = LegStatePublisher()
        self.other = rclpy.create_node("other")
        self.executor = rclpy.executors.SingleThreadedExecutor()
        for node in (self.node, self.other):
            self.executor.add_node(node)
        self.seen = {"leg_joints": [], "markers": [], "robot_description": []}
        for topic, kind in zip(self.seen, (JointState, MarkerArray, String), strict=True):
            quality = transport.qos(latched=topic == "robot_description")
            self.other.create_subscription(kind, topic, self.seen[topic].append, quality)
        self.sent = 0
        self._joint = self.other.create_publisher(JointState, "joint_states", 10)
        pressure = transport.message_class("sensor_msgs/msg/FluidPressure")
        self._pressures = {
            name: self.other.create_publisher(pressure, name, 10)
            for name in ("extensor/pressure", "flexor/pressure")
        }

    def measure(self, angle):
        """Send one measurement, of the next instant that is to be shown."""
        self.sent += PERIOD_NS
        self._joint.publish(messages.joint_state(self.sent, ["knee"], position=[angle]))
        for name, publisher in self._pressures.items():
            publisher.publish(messages.fluid_pressure(self.sent, name.split("/")[0], 3e5))

    def wait_until_seen(self, angle):
        """Measure again and again, since nothing is delivered before all have found each other."""

        def looked():
            self.measure(angle)
            self.executor.spin_once(timeout_sec=0.1)
            return all(self.seen.values())

        wait_for(looked)


@pytest.fixture
def stage(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path))
    made = []

    def make(*settings):
        made.append(Stage(*settings))
        return made[0]

    yield make
    for one in made:
        one.node.destroy_node()
        one.other.destroy_node()
    rclpy.try_shutdown()


def test_a_leg_is_described_and_shown_where_it_is_measured(stage):
    there = stage(PERSON)
    there.wait_until_seen(0.4)
    description = there.seen["robot_description"][0].data
    assert there.node.get_parameter("robot_description").value == description
    length = leg_model.segment_lengths(load({"leg.person.present": True}).leg)[0]
    assert f'xyz="{length:.9g} 0 0"' in description
    joints = there.seen["leg_joints"][-1]
    position = dict(zip(joints.name, joints.position, strict=True))
    assert position["knee"] == 0.4
    contraction = leg_model.contractions(0.4, load().leg)[0]
    np.testing.assert_allclose(position["extensor"], contraction)
    assert {one.ns for one in there.seen["markers"][-1].markers} == {"extensor", "flexor"}


def test_a_second_run_is_shown_too(stage):
    there = stage()
    there.sent = 1000 * PERIOD_NS
    there.wait_until_seen(0.4)
    there.sent = 0
    there.measure(0.5)
    wait_for(
        lambda: there.executor.spin_once(timeout_sec=0.1) or 0.5 in there.seen["leg_joints"][-1].position
    )


def test_tf_is_published_where_its_type_is_installed(stage):
    there = stage()
    names = {name for name, _ in there.node.get_publisher_names_and_types_by_node("leg_state_publisher", "/")}
    assert ("/tf" in names) == (find_spec("tf2_msgs") is not None)


def test_tf_goes_out_as_it_is_serialised(stage, monkeypatch):
    """PyPI has no tf2_msgs: another type stands in for it, and the bytes are looked at."""
    real = transport.message_class
    monkeypatch.setattr(transport, "message_class", lambda name: String if "tf2_msgs" in name else real(name))
    there = stage()
    there.seen["/tf"] = []
    there.other.create_subscription(String, "/tf", there.seen["/tf"].append, transport.qos(), raw=True)
    there.wait_until_seen(0.4)
    store = get_typestore(Stores.ROS2_JAZZY)
    transforms = store.deserialize_cdr(there.seen["/tf"][-1], "tf2_msgs/msg/TFMessage").transforms
    (shank,) = [one.transform.rotation for one in transforms if one.child_frame_id == "shank"]
    assert 2 * np.arctan2(shank.y, shank.w) == pytest.approx(0.4)


def test_a_leg_that_is_none_of_the_legs_is_refused(stage):
    with pytest.raises(OrthosisError, match="leg middle is none of left, right"):
        stage("leg:=middle", "legs:=left,right")
