# SPDX-License-Identifier: Apache-2.0
"""The ankle's mechanics against formulas of its own, and the machine as it is shipped."""

import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.mechanisms.ankle import passive_moment
from pam_orthosis.model.parameters import load

ANKLE = machine_named(Path("ankle"))
PERSON = {"leg.person.present": True}


def ankle(**changes):
    parameters = load(changes, ANKLE)
    return ANKLE.mechanism(parameters), parameters.leg


def values(mechanism, q, w):
    x, v = ca.SX.sym("x"), ca.SX.sym("v")
    terms = mechanism.terms(x, v)
    lengths = ca.vertcat(*mechanism.contractions(x))
    function = ca.Function(
        "ankle", [x, v], [terms.inertia, terms.coriolis, terms.gravity, lengths, ca.jacobian(lengths, x)]
    )
    return [np.array(one).squeeze() for one in function(q, w)]


def by_hand(q, leg):
    """Return inertia and gravity torque of a rigid foot about a fixed axis."""
    thigh, shank, knee = leg.thigh.length, leg.shank.length, leg.ankle.knee_angle
    parts = [(leg.shoe_mass, leg.ankle.shoe, leg.shoe_length)]
    if leg.person.present:
        thigh, shank = (
            getattr(leg.person, n).length_fraction * leg.person.height for n in ("thigh", "shank")
        )
        size = leg.ankle.foot.length_fraction * leg.person.height
        parts.append((leg.person.foot_mass_fraction * leg.person.mass, leg.ankle.foot, size))
    # hip and ankle at one height: the law of sines in the triangle hip, knee, ankle
    across = math.sqrt(thigh**2 + shank**2 + 2 * thigh * shank * math.cos(knee))
    below = math.asin(thigh * math.sin(knee) / across)
    inertia = gravity = 0.0
    for mass, part, size in parts:
        radius = size * math.hypot(part.forward, part.below)
        lead = math.atan2(part.below, part.forward)  # of the centre, below the toes' direction
        inertia += mass * ((size * part.gyration) ** 2 + radius**2)
        gravity += mass * 9.81 * radius * math.cos(math.pi / 2 - below + q - lead)
    return inertia, gravity


@pytest.mark.parametrize("changes", [{}, PERSON])
def test_inertia_and_gravity_are_those_of_a_rigid_foot(changes):
    mechanism, leg = ankle(**changes)
    for q, w in np.random.default_rng(1).uniform((-0.7, -4.0), (0.35, 4.0), (20, 2)):
        inertia, coriolis, gravity, _, _ = values(mechanism, q, w)
        if changes:
            gravity = gravity - float(passive_moment(q, leg.ankle.knee_angle))
        assert (inertia, gravity) == pytest.approx(by_hand(q, leg), rel=1e-9)
        assert coriolis == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize(
    ("dorsiflexion", "moment"), [(20, 42.4), (10, 17.2), (0, 6.4), (-10, 1.7), (-20, -0.3), (-30, -1.3)]
)
def test_the_passive_moment_is_the_published_one_with_dorsiflexion_positive(dorsiflexion, moment):
    assert float(passive_moment(math.radians(dorsiflexion), 0.0)) == pytest.approx(moment, abs=0.06)


def test_a_person_resists_dorsiflexion_less_with_a_bent_knee():
    straight, bent = (float(passive_moment(0.2, knee)) for knee in (0.1, 1.3))
    assert straight > 3 * bent > 0


def test_the_arm_of_a_rope_is_its_distance_from_the_axis():
    mechanism, leg = ankle()
    for q in np.linspace(-0.69, 0.34, 12):
        arms = values(mechanism, q, 0.0)[4]
        for one, arm in zip((leg.ankle.dorsiflexor, leg.ankle.plantarflexor), arms, strict=True):
            ground = np.array([0.0, one.ground])
            turned = one.angle + q
            end = one.lever * np.array([math.sin(turned), math.cos(turned)])
            rope = end - ground
            distance = (ground[0] * rope[1] - ground[1] * rope[0]) / np.linalg.norm(rope)
            assert arm == pytest.approx(distance, rel=1e-9)


def test_no_muscle_is_stretched_beyond_its_length_between_the_stops():
    mechanism, _ = ankle()
    box = load({}, ANKLE).muscle.dmsp_10
    most = box.box.maximum_contraction * box.length / box.map_length
    for q in np.linspace(*mechanism.limits, 20):
        lengths = values(mechanism, q, 0.0)[3]
        assert (lengths > 0).all()
        assert (lengths < most).all()
