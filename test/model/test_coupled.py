# SPDX-License-Identifier: Apache-2.0
"""Knee and ankle as one mechanism, against a derivation of its own: bodies' inertia forces, no CasADi."""

import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from coupled_loop import CoupledLoop

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import coupled
from pam_orthosis.model.coupled import Coupled, Plants
from pam_orthosis.model.device import device_named, entry_of, legs_from, parameters_of
from pam_orthosis.model.integrate import runge_kutta_4
from pam_orthosis.model.mechanisms.coupled import Leg, accelerations
from pam_orthosis.model.mechanisms.leg import energies
from pam_orthosis.model.parameters import load

STEP = 1e-30  # of the complex step, exact to the last digits
STENCIL = {1: 3 / 4, 2: -3 / 20, 3: 1 / 60}  # of a derivative, to sixth order


def joints(**changes):
    return device_parameters(
        device_named(Path("leg")), {key.replace("__", "."): v for key, v in changes.items()}
    )


def terms_function(leg):
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    terms = Leg(leg).terms(q, v)
    return ca.Function("leg", [q, v], [terms.inertia, terms.coriolis, terms.gravity])


def places(q, leg):
    """Return mass, moment of inertia, and place with orientation (x, z, angle) of all bodies; q complex."""
    person, k1, (knee, ankle) = leg.person, leg.configuration, q
    there = person.present
    lt, ls = (
        getattr(person, n).length_fraction * person.height if there else getattr(leg, n).length
        for n in ("thigh", "shank")
    )
    # the line from hip to ankle closes the triangle with both segments, and points down by the bearing
    reach = np.sqrt(lt**2 + ls**2 + 2 * lt * ls * np.cos(knee))
    hip = k1 * np.arcsin(ls * np.sin(knee) / reach) + np.arcsin(leg.bearing_height / reach)
    shank = hip - k1 * knee
    at = {"hip": np.zeros(2), "knee": lt * unit(hip)}
    at["ankle"] = at["knee"] + ls * unit(shank)
    toes = shank + k1 * (math.pi / 2 + ankle)
    found = [
        (leg.thigh.mass, leg.thigh.mass * (lt**2 + leg.thigh.width**2) / 12, at["knee"] / 2, hip),
        (leg.knee_mass, 0.0, at["knee"], hip),
        (
            leg.shank.mass,
            leg.shank.mass * (ls**2 + leg.shank.width**2) / 12,
            (at["knee"] + at["ankle"]) / 2,
            shank,
        ),
    ]
    feet = [(leg.shoe_mass, leg.ankle.shoe, leg.shoe_length)]
    if there:
        for part, start, length, angle in ((person.thigh, "hip", lt, hip), (person.shank, "knee", ls, shank)):
            mass = part.mass_fraction * person.mass
            centre = at[start] + part.centre_fraction * length * unit(angle)
            found.append((mass, mass * (part.gyration_fraction * length) ** 2, centre, angle))
        size = leg.ankle.foot.length_fraction * person.height
        feet.append((person.foot_mass_fraction * person.mass, leg.ankle.foot, size))
    for mass, part, size in feet:
        ahead, sole = unit(toes), unit(toes - k1 * math.pi / 2)
        centre = at["ankle"] + size * (part.forward * ahead + part.below * sole)
        found.append((mass, mass * (part.gyration * size) ** 2, centre, toes))
    return [(mass, moment, np.array([*place, angle])) for mass, moment, place, angle in found]


def unit(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def slopes(q, way, leg):
    """Return the derivative along a way of place and orientation of each body."""
    return [body[2].imag / STEP for body in places(q + 1j * STEP * way, leg)]


def by_hand(q, v, leg):
    """Return M, k, G by projecting each body's inertia force and weight on its velocity per q-dot."""
    h = 5e-3 / np.linalg.norm(v)
    # what accelerates each body while q-dot is constant
    bend = sum(
        sign * weight / h * np.array(slopes(q + sign * number * h * v, v, leg))
        for number, weight in STENCIL.items()
        for sign in (-1, 1)
    )
    jacobians = [
        np.column_stack(pair) for pair in zip(*(slopes(q, way, leg) for way in np.eye(2)), strict=True)
    ]
    inertia, coriolis, gravity = np.zeros((2, 2)), np.zeros(2), np.zeros(2)
    for (mass, moment, _), jacobian, bias in zip(places(q, leg), jacobians, bend, strict=True):
        weights = np.diag([mass, mass, moment])
        inertia += jacobian.T @ weights @ jacobian
        coriolis += jacobian.T @ weights @ bias
        gravity += 9.81 * mass * jacobian[1]
    if leg.person.present:
        a, k = -math.degrees(q[1]), math.degrees(q[0])
        moment = (
            math.exp(2.1016 - 0.0843 * a - 0.0176 * k) - math.exp(-7.9763 + 0.1949 * a + 0.0008 * k) - 1.792
        )
        gravity[1] += leg.ankle.passive_share * moment
    return inertia, coriolis, gravity


@pytest.mark.parametrize(
    "changes",
    [{}, {"leg__person__present": True}, {"leg__configuration": -1, "leg__bearing_height": 0.1}],
    ids=["apparatus", "person", "knee down"],
)
def test_lagrange_agrees_with_the_projected_equations(changes):
    leg = joints(**changes)["ankle"].leg
    function, random = terms_function(leg), np.random.default_rng(5)
    for _ in range(100):
        q, v = random.uniform((0.05, -0.65), (1.6, 0.33)), random.uniform(-8, 8, 2)
        for found, expected in zip(function(q, v), by_hand(q, v, leg), strict=True):
            error = np.abs(np.array(found).reshape(expected.shape) - expected).max()
            assert error <= 1e-9 * max(1.0, np.abs(expected).max())


def test_a_free_leg_keeps_its_energy_and_its_joints_exchange_it():
    mechanism = Leg(joints()["ankle"].leg)
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    energy = ca.Function("energy", [q, v], [sum(energies(q, v, mechanism.bodies(q)))])
    moved = accelerations(ca.SX.zeros(2), mechanism.terms(q, v), [0, 1])
    rate = ca.Function("rate", [q, v], [ca.vertcat(v, moved)])
    x = ca.SX.sym("x", 4)
    after = runge_kutta_4(lambda state: rate(state[:2], state[2:]), x, 1e-4)
    end = ca.Function("step", [x], [after]).fold(3000)(ca.DM([1.2, 0.0, 0.0, 0.0]))
    first, last = float(energy([1.2, 0.0], [0.0, 0.0])), float(energy(end[:2], end[2:]))
    assert np.abs(np.array(end)[:2, 0] - [1.2, 0.0]).min() > 0.3, "both must have moved"
    assert abs(last - first) < 1e-8 * abs(first)


def test_with_the_ankle_locked_and_a_lumped_foot_the_knee_runs_as_alone():
    """The paper lumps foot and shoe at the ankle; their size is zero then."""
    brief = {"scenario.start_hold": 0.1, "scenario.start_ramp": 0.3}
    sizes = {
        f"leg.ankle.{part}.{n}": 0.0 for part in ("shoe", "foot") for n in ("forward", "below", "gyration")
    }
    own = device_parameters(device_named(Path("leg")), brief | {"leg.ankle.joint.locked": True})
    run = CoupledLoop({name: one.substituted(sizes) for name, one in own.items()}).run(150)
    alone = ClosedLoop(load(brief), own["knee"].scenario.seed).run(150)
    assert np.ptp(alone["true_angle"]) > 0.1
    assert np.abs(run["knee"]["true_angle"] - alone["true_angle"]).max() <= 1e-9
    assert np.abs(run["knee"]["flexor_voltage"] - alone["flexor_voltage"]).max() <= 1e-6
    assert np.ptp(run["ankle"]["true_angle"]) == 0


def test_joints_of_one_leg_share_its_parameters():
    own = joints()
    other = own["ankle"].changed({"leg.shank.mass": 2.0})
    with pytest.raises(OrthosisError, match=r"leg\.shank\.mass"):
        Coupled([own["knee"], other])


def test_joints_of_one_side_are_coupled_and_shoes_move_alone(monkeypatch):
    class Two:
        def __init__(self, given):
            self.given = given
            self.joints = [type("Joint", (), {"lines": ()})() for _ in given]
            made.append(self)

    made = []
    monkeypatch.setattr(coupled, "Coupled", Two)
    own = device_parameters(device_named(Path("device")), {})
    plants = Plants(own)
    assert [one.given for one in made] == [
        [own[f"{side}/{n}"] for n in ("knee", "ankle")] for side in ("left", "right")
    ]
    assert plants.of["right/ankle"] is made[1].joints[1]
    assert plants.of["left/shoe"].machine.name == "shoe"
    assert plants.of.keys() == own.keys()


def test_each_joint_knows_the_others_gait():
    own = joints(scenario__cycle_time=1.7)
    for name, other in (("knee", "ankle"), ("ankle", "knee")):
        beside, gait = own[name].scenario.beside, own[other].scenario.gait
        assert (beside.cosine, beside.sine) == (gait.cosine, gait.sine)
        assert own[name].scenario.cycle_time == 1.7


def test_a_value_may_be_of_one_joint():
    own = device_parameters(device_named(Path("leg")), {"ankle/control.position.c1": 50.0})
    assert own["ankle"].control.position.c1 == 50.0 != own["knee"].control.position.c1
    with pytest.raises(OrthosisError, match="no joint of the leg has a parameter leg"):
        device_parameters(device_named(Path("leg")), {"leg.wing": 1.0})


def test_a_run_tells_its_joints_whole():
    own = joints()["ankle"]
    made = parameters_of(entry_of(own), load())
    assert made.flat() == own.flat()
    assert made.declared == own.declared
    with pytest.raises(OrthosisError, match="legs must be like"):
        legs_from("[]", "plant_simulator")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("joints: {knee: {machine: knee, wing: 1}}", "joint knee has no 'wing'"),
        ("joints: {truth: {machine: knee}}", "a joint cannot be called 'truth'; give one of small letters"),
        ("joints: {sole: {machine: shoe, coupled: leg}}", "a sole is no joint of a leg"),
        ("joints: {knee: {machine: knee}}\nsides: left", "sides is a list of names"),
        ("joints: {knee: {machine: nowhere}}", "nowhere"),
    ],
)
def test_an_unusable_device_is_refused_in_one_line(tmp_path, text, words):
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(OrthosisError, match=words) as refused:
        device_named(file)
    assert "\n" not in str(refused.value)
