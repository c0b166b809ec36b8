# SPDX-License-Identifier: Apache-2.0
"""The shipped ankle walks behind the loop's delay, with and without a person."""

from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.machines import machine_named
from pam_orthosis.model.parameters import load


def largest_error(changes):
    """Return the largest error of the true angle within two strides, degrees."""
    loop = ClosedLoop(load(changes, machine_named(Path("ankle"))), seed=1)
    run = loop.run(1400)
    assert loop.health()["position"]["vented_samples"] == 0
    assert np.degrees(np.ptp(run["reference_angle"])) > 20, "it must walk"
    return np.degrees(np.abs(run["reference_angle"] - run["true_angle"])).max()


@pytest.mark.parametrize("present", [False, True])
def test_the_ankle_follows_a_measured_stride_within_one_degree(present):
    assert largest_error({"leg.person.present": present}) <= 1.0


def test_a_calf_as_stiff_as_twice_the_published_one_is_more_than_the_muscles_can_hold():
    assert largest_error({"leg.person.present": True, "plant.deviation.passive_moment": 2.0}) > 2.0
