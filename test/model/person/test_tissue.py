# SPDX-License-Identifier: Apache-2.0
"""What a person's tissue does at the knee, against published values and its own claims."""

import numpy as np
import pytest

from pam_orthosis.model.machines import KNEE, RIG
from pam_orthosis.model.mechanisms.passive import knee_moment
from pam_orthosis.model.parameters import load
from pam_orthosis.model.person.tissue import TISSUE
from pam_orthosis.model.plant import Plant

# hip 0 and 70 degrees, ankle at a right angle: knee in degrees -> N m in the direction of flexion
STRAIGHT = {0: 10.4, 10: 1.5, 20: -1.4, 45: -3.7, 60: -4.5, 90: -6.2, 120: -11.9}
SITTING = {0: 32.0, 30: 4.9, 60: -1.6, 90: -4.3}


@pytest.mark.parametrize(("hip", "values"), [(0, STRAIGHT), (70, SITTING)])
def test_the_passive_moment_is_the_published_one(hip, values):
    found = [float(knee_moment(angle, hip)) for angle in values]
    assert found == pytest.approx(list(values.values()), abs=0.051)


def test_controllers_and_gap_workflow_know_no_tissue():
    names = set(KNEE.tissue)
    assert names == {"clonus", "ligaments", "passive_moment"} == {effect.name for effect in TISSUE}
    assert not names & set(KNEE.catalogue)
    assert not RIG.tissue
    assert not any("person" in key and not key.startswith("leg.") for key in load().nominal().flat())


def swung(**tissue):
    """Return the angles of a knee that is bent and then straightened to its stop."""
    settings = {f"plant.person.tissue.{name}.enabled": True for name in tissue}
    parameters = load({"scenario.start_angle": 0.6, **settings})
    plant, angles = Plant(parameters, 1), []
    for index in range(60):
        angles.append(plant.truth().angle)
        plant.advance(*((5.0, 6.5) if index < 20 else (8.0, 2.0)))
    return np.array(angles)


def test_each_changes_a_fast_swing():
    free = swung()
    for name in KNEE.tissue:
        assert np.abs(swung(**{name: True}) - free).max() > np.radians(0.1), name
