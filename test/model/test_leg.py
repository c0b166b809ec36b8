# SPDX-License-Identifier: Apache-2.0
"""The mechanics against a derivation of its own: implicit differentiation by hand, no CasADi."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.model import parameters
from pam_orthosis.model.integrate import runge_kutta_4
from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.model.mechanisms.base import stop_effort

GRAVITY = 9.81


def mechanics_function(leg):
    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    terms = leg_model.mechanics(q, w, leg)
    return ca.Function("mechanics", [q, w], [terms.inertia, terms.coriolis, terms.gravity])


def by_hand(q, w, leg):
    """Return m, k, G by projecting each body's inertia force on its velocity per q-dot."""
    k1, h = leg.configuration, leg.bearing_height
    person = leg.person
    lt = person.thigh.length_fraction * person.height if person.present else leg.thigh.length
    ls = person.shank.length_fraction * person.height if person.present else leg.shank.length
    # solve the bearing constraint numerically instead of in closed form
    a = 0.5 * k1 * q
    for _ in range(60):
        s = a - k1 * q
        a -= (lt * np.sin(a) + ls * np.sin(s) - h) / (lt * np.cos(a) + ls * np.cos(s))
    s = a - k1 * q
    slope = lt * np.cos(a) + ls * np.cos(s)
    a1 = k1 * ls * np.cos(s) / slope
    s1 = a1 - k1
    a2 = (lt * np.sin(a) * a1**2 + ls * np.sin(s) * s1**2) / slope
    inertia = coriolis = gravity = 0.0

    def add(mass, moment, along_thigh, along_shank, turns_with_thigh):
        nonlocal inertia, coriolis, gravity
        v = np.array([
            -along_thigh * np.sin(a) * a1 - along_shank * np.sin(s) * s1,
            along_thigh * np.cos(a) * a1 + along_shank * np.cos(s) * s1,
        ])  # fmt: skip
        b = np.array([
            -along_thigh * (np.cos(a) * a1**2 + np.sin(a) * a2)
            - along_shank * (np.cos(s) * s1**2 + np.sin(s) * a2),
            along_thigh * (-np.sin(a) * a1**2 + np.cos(a) * a2)
            + along_shank * (-np.sin(s) * s1**2 + np.cos(s) * a2),
        ])  # fmt: skip
        turn = a1 if turns_with_thigh else s1
        inertia += mass * v @ v + moment * turn**2
        coriolis += (mass * v @ b + moment * turn * a2) * w**2
        gravity += mass * GRAVITY * v[1]

    thigh, shank = leg.thigh, leg.shank
    add(thigh.mass, thigh.mass * (lt**2 + thigh.width**2) / 12, lt / 2, 0, True)
    add(leg.knee_mass, 0, lt, 0, True)
    add(shank.mass, shank.mass * (ls**2 + shank.width**2) / 12, lt, ls / 2, False)
    add(leg.shoe_mass, 0, lt, ls, False)
    if person.present:
        for segment, start, length, on_thigh in (
            (person.thigh, 0, lt, True),
            (person.shank, lt, ls, False),
        ):
            mass = segment.mass_fraction * person.mass
            moment = mass * (segment.gyration_fraction * length) ** 2
            centre = segment.centre_fraction * length
            add(mass, moment, centre if on_thigh else start, 0 if on_thigh else centre, on_thigh)
        add(person.foot_mass_fraction * person.mass, 0, lt, ls, False)
    return inertia, coriolis, gravity


@pytest.mark.parametrize("present", [False, True])
@pytest.mark.parametrize("configuration", [1, -1])
@pytest.mark.parametrize("height", [0.0, 0.12, -0.2])
def test_lagrange_agrees_with_the_projected_equations(present, configuration, height):
    """Eqs. (25) and (26) against inertia forces that are projected on the motion."""
    leg = parameters.load(
        {"leg.person.present": present, "leg.configuration": configuration, "leg.bearing_height": height}
    ).leg
    function = mechanics_function(leg)
    random = np.random.default_rng(3)
    for q, w in zip(random.uniform(0.05, 1.6, 120), random.uniform(-8, 8, 120), strict=True):
        expected = np.array(by_hand(q, w, leg))
        found = np.array([float(term) for term in function(q, w)])
        assert np.abs(found - expected).max() <= 1e-9 * max(1.0, np.abs(expected).max())


def test_the_ankle_stays_on_its_bearing():
    """Eq. (24) is what holds it there."""
    leg = parameters.load({"leg.bearing_height": 0.1}).leg
    q = ca.SX.sym("q")
    foot = ca.Function("foot", [q], [leg_model.bodies(q, leg)[3].position])
    heights = [float(foot(angle)[1]) for angle in np.linspace(0, 1.6, 30)]
    assert np.allclose(heights, 0.1, atol=1e-12)


def test_a_free_leg_keeps_its_energy():
    leg = parameters.load({"leg.person.present": True}).leg
    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    terms = leg_model.mechanics(q, w, leg)
    kinetic, potential = leg_model.energies(q, w, leg_model.bodies(q, leg))
    energy = ca.Function("energy", [q, w], [kinetic + potential])
    state = ca.SX.sym("state", 2)
    rate = ca.Function("rate", [q, w], [w, -(terms.coriolis + terms.gravity) / terms.inertia])
    step = ca.Function("step", [state], [runge_kutta_4(lambda s: ca.vertcat(*rate(s[0], s[1])), state, 1e-4)])
    end = step.fold(4000)(ca.DM([1.2, 0.0]))
    start_energy, end_energy = float(energy(1.2, 0.0)), float(energy(end[0], end[1]))
    assert abs(float(end[0]) - 1.2) > 0.3, "the leg must have moved for the balance to mean anything"
    assert abs(end_energy - start_energy) < 1e-8 * abs(start_energy)


def test_a_stop_only_pushes():
    joint = parameters.load().leg.joint
    assert float(stop_effort(joint.minimum - 0.01, 0.0, joint)) > 0
    assert float(stop_effort(joint.maximum + 0.01, 0.0, joint)) < 0
    assert float(stop_effort(joint.maximum + 0.01, -50.0, joint)) == 0
    assert float(stop_effort(0.5, 3.0, joint)) == 0
