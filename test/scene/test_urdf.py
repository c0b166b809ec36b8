# SPDX-License-Identifier: Apache-2.0
"""The leg's description and TF against the model's own kinematics and mechanics."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.model.parameters import load
from pam_orthosis.scene.shapes import shape_of
from pam_orthosis.scene.urdf import robot_description

urdf = pytest.importorskip("urdf_parser_py.urdf", reason="urdf-parser-py is not installed")

LEGS = {
    "plain": {},
    "person": {"leg.person.present": True},
    "knee down": {"leg.configuration": -1, "leg.bearing_height": 0.1, "leg.cogwheel_diameter": 0.08},
}
PARTS = {"thigh", "shank", "foot", "cogwheel", "extensor_muscle", "flexor_muscle"}
ANGLES = (-0.05, 0.0, 0.4, 1.3)


@pytest.fixture(scope="module", params=LEGS.values(), ids=LEGS)
def parameters(request):
    return load(request.param)


@pytest.fixture(scope="module")
def robot(parameters):
    return urdf.URDF.from_xml_string(robot_description(shape_of(parameters)).encode())


def rotation(axis, angle):
    """Return the matrix of a turn, by Rodrigues' formula."""
    k = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def by_description(robot, positions):
    """Return the pose (4, 4) of each link in the root's frame, from what the URDF says alone."""
    poses = {robot.get_root(): np.eye(4)}
    for joint in robot.joints:
        step = np.eye(4)
        assert joint.origin.rpy == [0, 0, 0]
        step[:3, 3] = joint.origin.xyz
        if joint.type == "revolute":
            step[:3, :3] = rotation(joint.axis, positions[joint.name])
        elif joint.type == "prismatic":
            step[:3, 3] += positions[joint.name] * np.array(joint.axis)
        poses[joint.child] = poses[joint.parent] @ step
    return poses


def by_tf(frames, angle):
    """Return the pose (4, 4) of each frame in the root's, from the transforms that are published."""
    positions = frames.pose(angle).positions
    waiting = [*frames.moving(positions), *frames.fixed()]
    poses = {"hip": np.eye(4)}
    while waiting:
        one = next(t for t in waiting if t.parent in poses)
        waiting.remove(one)
        x, y, z, w = one.rotation
        assert x == z == 0.0
        step = np.eye(4)
        step[:3, :3] = rotation((0.0, 1.0, 0.0), 2 * np.arctan2(y, w))
        step[:3, 3] = one.translation
        poses[one.child] = poses[one.parent] @ step
    return poses


def model_function(parameters, make):
    q = ca.SX.sym("q")
    return ca.Function("f", [q], make(q, parameters.leg))


def test_the_description_has_the_parts_of_a_leg(robot):
    assert {link.name for link in robot.links} >= PARTS
    assert robot.get_root() == "hip"
    assert {joint.name: joint.type for joint in robot.joints if joint.type != "fixed"} == {
        "hip": "revolute", "knee": "revolute", "extensor": "prismatic", "flexor": "prismatic"
    }  # fmt: skip
    drawn = {link.name for link in robot.links if link.visual}
    assert drawn >= PARTS


@pytest.mark.parametrize("angle", ANGLES)
def test_tf_and_description_put_knee_and_ankle_where_the_model_has_them(parameters, robot, angle):
    frames = shape_of(parameters)
    bodies = model_function(parameters, lambda q, leg: [leg_model.bodies(q, leg)[i].position for i in (1, 3)])
    knee, ankle = (point.full()[:, 0] for point in bodies(angle))
    hip = float(model_function(parameters, lambda q, leg: [leg_model.hip_angle(q, leg)])(angle))
    tf = by_tf(frames, angle)
    described = by_description(robot, frames.pose(angle).positions)
    for poses in (tf, described):
        np.testing.assert_allclose(poses["shank"][[0, 2], 3], knee, atol=1e-8)
        np.testing.assert_allclose(poses["foot"][[0, 2], 3], ankle, atol=1e-8)
        along = poses["shank"][:3, 0]
        shank = hip - parameters.leg.configuration * angle
        np.testing.assert_allclose(along, [np.cos(shank), 0.0, np.sin(shank)], atol=1e-8)
    for name, pose in described.items():
        np.testing.assert_allclose(tf[name], pose, atol=1e-8, err_msg=name)


@pytest.mark.parametrize("angle", ANGLES)
def test_a_flexed_knee_turns_the_shank_about_y_and_pulls_the_muscles_as_the_model_says(parameters, angle):
    frames = shape_of(parameters)
    poses = by_tf(frames, angle)
    turned = np.linalg.inv(poses["thigh"]) @ poses["shank"]
    flexion = rotation((0.0, parameters.leg.configuration, 0.0), angle)
    np.testing.assert_allclose(turned[:3, :3], flexion, atol=1e-12)
    contractions = model_function(parameters, lambda q, leg: list(leg_model.contractions(q, leg)))(angle)
    for name, contraction in zip(("extensor", "flexor"), contractions, strict=True):
        length = np.linalg.norm(poses[f"{name}_chain"][:3, 3] - poses[f"{name}_muscle"][:3, 3])
        assert length == pytest.approx(parameters.muscle.dmsp_20.length - float(contraction), abs=1e-12)


def test_joint_ranges_are_what_the_joints_go_through(parameters, robot):
    frames = shape_of(parameters)
    ranges = {joint.name: joint.limit for joint in robot.joints if joint.limit}
    knee = ranges["knee"]
    assert [knee.lower, knee.upper] == [parameters.leg.joint.minimum, parameters.leg.joint.maximum]
    for angle in np.linspace(knee.lower, knee.upper, 7):
        for name, position in frames.pose(angle).positions.items():
            assert ranges[name].lower - 1e-6 <= position <= ranges[name].upper + 1e-6, name


@pytest.mark.parametrize("angle", ANGLES)
def test_the_masses_of_the_description_give_the_model_its_gravity_and_inertia(parameters, robot, angle):
    frames = shape_of(parameters)

    def state(q):
        """Return potential energy (J), and of each link with a mass: mass, centre, heading, moment."""
        poses = by_description(robot, frames.pose(q).positions)
        heavy = [link for link in robot.links if link.inertial]
        centres = [(poses[one.name] @ [*one.inertial.origin.xyz, 1.0])[:3] for one in heavy]
        headings = [np.arctan2(poses[one.name][2, 0], poses[one.name][0, 0]) for one in heavy]
        masses = [one.inertial.mass for one in heavy]
        potential = sum(m * 9.81 * c[2] for m, c in zip(masses, centres, strict=True))
        return (
            potential,
            masses,
            np.array(centres),
            np.array(headings),
            [o.inertial.inertia.iyy for o in heavy],
        )

    step = 1e-4
    below, masses, centres_0, headings_0, moments = state(angle - step)
    above, _, centres_1, headings_1, _ = state(angle + step)
    speeds, spins = (centres_1 - centres_0) / (2 * step), (headings_1 - headings_0) / (2 * step)
    inertia = np.sum(masses * np.sum(speeds**2, axis=1) + moments * spins**2)
    v = ca.SX.sym("v")
    q = ca.SX.sym("q")
    terms = leg_model.mechanics(q, v, parameters.leg)
    expected = ca.Function("m", [q, v], [terms.inertia, terms.gravity])(angle, 0.0)
    assert inertia == pytest.approx(float(expected[0]), rel=1e-5)
    assert (above - below) / (2 * step) == pytest.approx(float(expected[1]), rel=1e-5, abs=1e-5)
