# SPDX-License-Identifier: Apache-2.0
"""The device moved by hand: with vented muscles friction is all that resists beside weight and inertia."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load
from pam_orthosis.report.paper import by_hand

ROUNDING = 0.03  # N m, of differences over a millisecond


def friction(moved):
    """Return what dry friction with its rise at low speed and viscous friction can resist at most, N m."""
    p = load(machine=machine_named(Path(moved.joint)))
    dry, viscous = p.plant.effects.joint_friction, p.plant.effects.viscous_friction
    tissue = p.plant.person.tissue.passive_moment.viscosity if moved.person and moved.joint == "knee" else 0.0
    viscosity = viscous.viscosity + tissue
    return dry.coulomb * (1 + dry.stribeck) + viscosity * np.abs(moved.velocity), dry.coulomb


@pytest.fixture(scope="module")
def slow():
    return by_hand.by_hand("knee", False, "slow")


@pytest.mark.parametrize(("joint", "person", "speed"), [("knee", True, "gait"), ("ankle", True, "gait")])
def test_vented_muscles_resist_by_friction_alone_at_gait_speed(joint, person, speed):
    moved = by_hand.by_hand(joint, person, speed)
    most, dry = friction(moved)
    assert (np.abs(moved.resistance) <= most + ROUNDING).all()
    fast = np.abs(moved.velocity) > 1.0
    assert (moved.resistance * np.sign(moved.velocity))[fast].min() > 0.9 * dry


def test_a_knee_goes_slowly_from_stop_to_stop_against_friction_alone(slow):
    p = load()
    most, dry = friction(slow)
    assert (np.abs(slow.resistance) <= most + ROUNDING).all()
    assert np.abs(slow.resistance).max() > dry
    assert slow.angle.min() == pytest.approx(p.leg.joint.minimum, abs=0.03)
    assert slow.angle.max() == pytest.approx(p.leg.joint.maximum, abs=0.03)


def test_filled_muscles_hold_the_knee_as_nobody_moves_it_by_chance(slow):
    filled = by_hand.by_hand("knee", False, "slow", filled=True)
    assert np.abs(filled.resistance).max() > 20 * np.abs(slow.resistance).max()


def test_more_friction_is_found():
    p = {"plant.effects.joint_friction.coulomb": 2.0, "plant.effects.joint_friction.stribeck": 0.0}
    moved = by_hand.by_hand("ankle", False, "gait", overrides=p)
    fast = np.abs(moved.velocity) > 1.0
    against = (moved.resistance * np.sign(moved.velocity))[fast]
    assert np.median(against) == pytest.approx(2.0, abs=0.15)
