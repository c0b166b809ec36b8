# SPDX-License-Identifier: Apache-2.0
"""Machines of users' files in space: what slides or turns, actuators that move it as they are drawn."""

from dataclasses import replace

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import read_machine
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.scene.messages import JOINTS, MARKERS, TF, TYPES, Scene
from pam_orthosis.scene.sampled import SampledScene
from pam_orthosis.scene.shapes import shape_of

STORE = get_typestore(Stores.ROS2_JAZZY)
FULL = {"slide": (7.0e5, 1.013e5), "elbow": (1.013e5, 7.0e5)}


@pytest.fixture(scope="module", params=["slide", "elbow"])
def name(request):
    return request.param


@pytest.fixture(scope="module")
def parameters(machine_files, name):
    return load(machine=read_machine(machine_files[name]))


@pytest.fixture(scope="module")
def scene(parameters):
    return Scene(parameters)


def said(scene, coordinate, pressures):
    return {
        one.topic: STORE.deserialize_cdr(one.data, TYPES[one.topic])
        for one in scene.sample(7, coordinate, pressures)
    }


def test_the_load_slides_or_turns_between_its_stops(scene, name):
    urdf = pytest.importorskip("urdf_parser_py.urdf", reason="urdf-parser-py is not installed")
    robot = urdf.URDF.from_xml_string(scene.description.encode())
    load_joint = next(joint for joint in robot.joints if joint.name == name)
    kind, axis, ends = {
        "slide": ("prismatic", [1, 0, 0], (0.0, 0.3)),
        "elbow": ("revolute", [0, 1, 0], (-0.8, 0.8)),
    }[name]
    assert (load_joint.type, load_joint.axis) == (kind, axis)
    assert (load_joint.limit.lower, load_joint.limit.upper) == ends
    assert robot.get_root() == "base"
    assert {joint.name for joint in robot.joints if joint.type == "prismatic"} >= {"push", "pull"} or (
        name == "elbow"
    )


def test_tf_puts_the_load_where_it_is(scene, name):
    moved = next(one for one in said(scene, 0.2, (2e5, 2e5))[TF].transforms if one.child_frame_id == "load")
    place, turn = moved.transform.translation, moved.transform.rotation
    if name == "slide":
        assert (place.x, place.y, place.z, turn.w) == (0.2, 0.0, 0.0, 1.0)
    else:
        assert (place.x, turn.x, turn.z) == (0.0, 0.0, 0.0)
        assert 2 * np.arctan2(turn.y, turn.w) == pytest.approx(0.2)


def test_joints_and_markers_are_those_of_the_machine(scene, name):
    machine = scene.machine
    told = said(scene, 0.2, FULL[name])
    joints = dict(zip(told[JOINTS].name, told[JOINTS].position, strict=True))
    assert list(joints) == [name, *machine.names]
    assert joints[name] == 0.2
    arms = {"push": (1.0, 0.0), "pull": (-1.0, 0.3), "biceps": (0.03, 0.05), "triceps": (-0.03, 0.05)}
    for actuator in machine.names:
        arm, zero = arms[actuator]
        assert joints[actuator] == pytest.approx(zero + arm * 0.2)
    tubes = {one.ns: one for one in told[MARKERS].markers if one.type == 3}
    full, empty = (tubes[one] for one in (machine.names if name == "slide" else machine.names[::-1]))
    assert full.color.r > full.color.b
    assert empty.color.b > empty.color.r
    lengths = {"push": 0.025 + 0.2, "pull": 0.025 + 0.1, "biceps": 0.5 - 0.056, "triceps": 0.5 - 0.044}
    for actuator, tube in tubes.items():
        assert tube.scale.z == pytest.approx(lengths[actuator])
        assert tube.header.frame_id == f"{actuator}_muscle"


def test_a_cylinder_pushes_and_a_muscle_pulls_the_load_the_way_that_its_force_acts(parameters, name):
    """By virtual work: what the force along a bar does to the load has the sign of dL/dq."""
    shape = shape_of(parameters)
    sketch = shape.sketch(np.array([0.1, 0.12]))
    for actuator, side in zip(sketch.actuators, (1, -1), strict=True):
        line = sketch.actuators[actuator]
        pull = (line.upper - line.lower)[0] * (-1 if name == "slide" else 1)
        if name == "slide":
            assert np.sign(pull[0]) == side
            moved = np.diff(line.lower, axis=0)[0]
            assert moved == pytest.approx([0.02, 0.0]), "its end goes with the load"
        else:
            x, z = line.chain[0]
            assert np.sign(z * pull[0] - x * pull[1]) == side, "torque about y"


def test_the_load_hangs_down_where_the_file_says(machine_files):
    body = shape_of(load(machine=read_machine(machine_files["elbow"]))).sketch(np.array([-1.2])).body[0]
    along = body[1] - body[0]
    assert along[0] == pytest.approx(0.0, abs=1e-12)
    assert along[1] < 0


def test_samples_of_the_machine_make_its_messages(scene, name):
    types = STORE.types
    stamp = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](0, 5), "")
    joint = types["sensor_msgs/msg/JointState"](stamp, [name], np.array([0.2]), np.zeros(0), np.zeros(0))
    pressure = types["sensor_msgs/msg/FluidPressure"](stamp, 2e5, 0.0)
    sampled = SampledScene(scene)
    sampled.prepare()
    there = dict.fromkeys(sampled.inputs, pressure) | {"joint_states": joint}
    assert list(there)[1:] == [f"{one}/pressure" for one in scene.machine.names]
    made = [
        one
        for topic, message in there.items()
        for one in sampled.add(topic, 5, bytes(STORE.serialize_cdr(message, message.__msgtype__)))
    ]
    assert [one.topic for one in made] == ["robot_description", "/tf_static", "/tf", "leg_joints", "markers"]


def test_a_machine_without_a_picture_is_refused_in_one_line(parameters):
    other = replace(parameters.declared, kind="carriage")
    with pytest.raises(
        OrthosisError, match=r"^a carriage has no picture: knee, ankle, rotation, sole, translation have one$"
    ):
        shape_of(Parameters(other, {row.key: row for row in parameters.rows()}))
