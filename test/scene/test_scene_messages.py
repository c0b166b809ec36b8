# SPDX-License-Identifier: Apache-2.0
"""What is said of a leg to viewers: serialised messages of standard types."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.bag import messages as ros
from pam_orthosis.bag.read import recorded_parameters, run_record
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.scene.messages import MARKERS, PERIOD_NS, TF, TF_STATIC, TYPES, Scene
from pam_orthosis.scene.sampled import SampledScene, inputs

STORE = get_typestore(Stores.ROS2_JAZZY)
VENTED, FULL = 1.013e5, 7.0e5
INPUTS = tuple(inputs(KNEE))
BAGS = Path(__file__).resolve().parents[2] / "bags"


def read(said):
    return {one.topic: STORE.deserialize_cdr(one.data, TYPES[one.topic]) for one in said}


@pytest.fixture(scope="module")
def scene():
    return Scene(load())


def measured(stamp_ns, angle, *pressures):
    """Return serialised measurements, by topic."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](
        types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9), ""
    )
    joint = types["sensor_msgs/msg/JointState"](
        header, ["knee"], np.array([angle]), np.array([]), np.array([])
    )
    made = {INPUTS[0]: STORE.serialize_cdr(joint, joint.__msgtype__)}
    for topic, pressure in zip(INPUTS[1:], pressures, strict=True):
        message = types["sensor_msgs/msg/FluidPressure"](header, pressure, 0.0)
        made[topic] = STORE.serialize_cdr(message, message.__msgtype__)
    return made


def add(sampled, stamp_ns, angle=0.3, pressures=(2e5, 3e5)):
    return [
        said
        for topic, data in measured(stamp_ns, angle, *pressures).items()
        for said in sampled.add(topic, stamp_ns, bytes(data))
    ]


def test_a_muscle_is_drawn_as_long_as_it_is_and_red_when_full(scene):
    markers = read(scene.sample(0, 0.5, (VENTED, FULL)))[MARKERS].markers
    tubes = {one.ns: one for one in markers if one.type == 3}
    pose = scene.shape.pose(0.5)
    for name, tube in tubes.items():
        assert tube.header.frame_id == f"{name}_muscle"
        assert tube.scale.z == pytest.approx(0.5 - pose.positions[name])
        assert tube.pose.position.x == pytest.approx(tube.scale.z / 2)
        assert tube.scale.x == pytest.approx(pose.diameters[name])
    assert tubes["extensor"].color.b > tubes["extensor"].color.r
    assert tubes["flexor"].color.r > tubes["flexor"].color.b


def test_the_chain_goes_from_the_muscle_to_the_cogwheel(scene):
    markers = read(scene.sample(0, 0.5, (VENTED, FULL)))[MARKERS].markers
    tube, chain = (one for one in markers if one.ns == "extensor")
    start, end = chain.points
    assert start.x == pytest.approx(tube.scale.z)
    assert end.x - start.x == pytest.approx(0.06 + scene.shape.pose(0.5).positions["extensor"])


@pytest.mark.parametrize("leg", ["", "right"])
def test_what_is_filled_in_reads_as_a_serialiser_writes_it(leg):
    scene = Scene(load(), leg, ("left", "right") if leg else ("",))
    said = scene.sample(12_000_000_345, 0.7, (VENTED, 3e5))
    for topic, message in read(said).items():
        again = bytes(STORE.serialize_cdr(message, TYPES[topic]))
        assert again == dict(said)[topic]
        parts = getattr(message, "transforms", None) or getattr(message, "markers", None) or [message]
        stamps = {(part.header.stamp.sec, part.header.stamp.nanosec) for part in parts}
        assert stamps == {(12, 345)}
        assert all(part.header.frame_id.startswith(leg) for part in parts if topic != "leg_joints")


@pytest.mark.parametrize("name", ["walk", "person"])
def test_what_a_shipped_bag_holds_for_viewers_is_made_of_its_measurements(name):
    known = recorded_parameters(BAGS / name, run_record(BAGS / name))
    shipped = load().only("leg", "muscle", "valve").flat()
    parameters = load({key: value for key, value in known.items() if key in shipped})
    sampled, made, there = SampledScene(Scene(parameters)), [], []
    with AnyReader([BAGS / name], default_typestore=STORE) as reader:
        for connection, stamp_ns, data in reader.messages():
            topic = connection.topic.lstrip("/")
            if topic in INPUTS:
                made += [
                    (one.topic.lstrip("/"), stamp_ns, one.data) for one in sampled.add(topic, stamp_ns, data)
                ]
            elif topic in {of_viewers.lstrip("/") for of_viewers in TYPES}:
                there.append((topic, stamp_ns, data))
    assert len(there) > 500
    assert sorted(made) == sorted(there)


def test_a_sample_makes_no_message_objects(scene, monkeypatch):
    monkeypatch.setattr(ros, "new", None)
    assert len(scene.sample(0, 0.3, (2e5, 3e5))) == 3


def test_two_legs_stand_side_by_side_in_one_world():
    p = load()
    for leg, side in (("left", 1), ("right", -1)):
        said = read(Scene(p, leg, ("left", "right")).once(0))[TF_STATIC].transforms
        assert (said[0].header.frame_id, said[0].child_frame_id) == ("world", f"{leg}/hip")
        assert said[0].transform.translation.y == pytest.approx(side * p.leg.hip_distance / 2)
        assert all(one.child_frame_id.startswith(f"{leg}/") for one in said)


def test_all_frames_of_the_description_are_in_tf_once(scene):
    said = read([*scene.once(0), *scene.sample(0, 0.2, (2e5, 2e5))])
    children = [one.child_frame_id for topic in (TF, TF_STATIC) for one in said[topic].transforms]
    assert sorted(children) == sorted(scene.shape.links[1:])


def test_it_speaks_once_a_period_and_describes_the_leg_once(scene):
    sampled = SampledScene(scene)
    step = PERIOD_NS // 8
    said = [add(sampled, k * step) for k in range(20)]
    assert [k for k, one in enumerate(said) if one] == [0, 8, 16]
    assert [len(said[k]) for k in (0, 8, 16)] == [5, 3, 3]


@pytest.mark.parametrize("again", [True, False])
def test_when_time_goes_back_it_begins_anew_if_it_is_to(scene, again):
    """A second run, or a bag in a loop; a recorder's run has one time."""
    sampled = SampledScene(scene, again)
    assert len(add(sampled, 100 * PERIOD_NS)) == 5
    assert add(sampled, 90 * PERIOD_NS) == []  # late, but of the same run
    assert len(add(sampled, 2 * PERIOD_NS)) == (5 if again else 0)
    assert len(add(sampled, 3 * PERIOD_NS)) == (3 if again else 0)


@pytest.mark.parametrize("angle", [np.nan, np.inf, 4.0])
def test_what_no_leg_can_be_at_is_not_shown(scene, angle):
    assert add(SampledScene(scene), 0, angle) == []
    assert add(SampledScene(scene), 0, 0.3, (np.nan, 2e5)) == []


def test_an_instant_that_lacks_a_measurement_is_passed_over(scene):
    sampled = SampledScene(scene)
    first = measured(0, 0.1, 2e5, 2e5)
    assert sampled.add(INPUTS[0], 0, bytes(first[INPUTS[0]])) == []
    (joints,) = [read([one]) for one in add(sampled, 5, 0.2) if one.topic == "leg_joints"]
    assert joints["leg_joints"].position[1] == 0.2


def test_code_for_messages_is_made_before_the_first_sample(scene, monkeypatch):
    store = get_typestore(Stores.ROS2_JAZZY)
    monkeypatch.setattr(ros, "store", lambda: store)
    sampled = SampledScene(scene)
    sampled.prepare()
    made = set(store.cache)
    assert add(sampled, 0)
    assert set(store.cache) == made
