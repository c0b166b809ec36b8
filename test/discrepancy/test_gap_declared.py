# SPDX-License-Identifier: Apache-2.0
"""Candidates of machines of a file: the catalogue's sizes and places are a knee's."""

from pathlib import Path

import pytest

from pam_orthosis.discrepancy.systems.declared import declared_machine
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load


def system_of(name):
    machine = machine_named(Path(name))
    return declared_machine(machine, load(machine=machine))


def test_a_spring_of_the_ankle_rests_in_the_middle_of_its_range():
    (rest,) = (
        q.typical
        for q in system_of("ankle").catalogue["parallel_elasticity"].parameters
        if q.name == "rest_angle"
    )
    assert rest == pytest.approx(0.5 * (-0.6981317 + 0.3490659))


def test_friction_of_a_small_joint_is_looked_for_at_its_size_too():
    """A start at the knee's size alone holds a light foot still, and says nothing of less friction."""
    ankle, usual = system_of("ankle").catalogue["joint_friction"], knee(load()).catalogue["joint_friction"]
    assert min(start["coulomb"] for start in ankle.starts) == pytest.approx(0.2 * usual.parameters[0].typical)
    assert not usual.starts


def test_the_mass_of_the_shoe_may_be_wrong():
    """Else it is reported as two forces that are wrong by one factor."""
    assert "leg.shoe_mass" in system_of("ankle").wrong.values()


def test_a_hysteresis_that_slides_at_once_is_none():
    short = {q.name: q for q in knee(load()).catalogue["muscle_hysteresis"].parameters}["sliding_distance"]
    assert short.is_empty(5e-5)
    assert not short.is_empty(2e-4)
