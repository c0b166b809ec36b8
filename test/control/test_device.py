# SPDX-License-Identifier: Apache-2.0
"""The whole device: two legs half a cycle apart, each with knee, ankle and shoe, as shipped."""

from pathlib import Path

import pytest

from pam_orthosis.control.legs import device_parameters
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.device import device_named

DEVICE = device_named(Path("device"))
JOINTS = ["knee", "ankle", "shoe"]
PERSON = {"leg.person.present": True}


@pytest.fixture(scope="module")
def parameters():
    return device_parameters(DEVICE, PERSON)


def test_each_joint_has_a_namespace_and_noise_of_its_own(parameters):
    assert list(parameters) == [f"{side}/{joint}" for side in ("left", "right") for joint in JOINTS]
    assert len({one.scenario.seed for one in parameters.values()}) == 6
    with_person = [one.leg.person.present for name, one in parameters.items() if not name.endswith("shoe")]
    assert with_person == [True] * 4


@pytest.mark.parametrize("joint", JOINTS)
def test_the_right_side_is_half_a_cycle_ahead_in_all_that_it_is_asked_for(parameters, joint):
    left, right = (make_trajectory(parameters[f"{side}/{joint}"]) for side in ("left", "right"))
    half = parameters[f"left/{joint}"].scenario.cycle_time / 2
    for time in (7.0, 7.3, 8.1, 8.9):
        now, later = right.sample(round(time * 1e9)), left.sample(round((time + half) * 1e9))
        assert now[:3] == pytest.approx(later[:3], rel=1e-9, abs=1e-12)
        assert now.mean_pressure == pytest.approx(later.mean_pressure)
        assert (now.beside is None) == (joint == "shoe")
        assert now.beside == pytest.approx(later.beside)
        if joint == "shoe":
            assert now.planned[:3] == pytest.approx(later.planned[:3], rel=1e-9, abs=1e-12)


def test_the_mean_pressure_of_the_shoe_is_no_constant(parameters):
    shoe = make_trajectory(parameters["right/shoe"])
    means = [shoe.sample(round(time * 1e8)).mean_pressure for time in range(60, 80)]
    assert max(means) - min(means) > 1e5
