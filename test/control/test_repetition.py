# SPDX-License-Identifier: Apache-2.0
"""Learning from stride to stride: it lowers the error that repeats, stays bounded, and begins anew."""

import numpy as np
import pytest

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.repetition import Repetition
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import load, scenario_overrides

STEP_NS, STRIDE = 5_000_000, 400


@pytest.fixture
def learning():
    parameters = load()
    return Repetition(make_trajectory(parameters), parameters), make_trajectory(parameters)


def walk(learning, wrong, strides, start=0):
    """Let a joint miss the wanted motion by `wrong(phase)`; return the index after it."""
    reference, plain = learning
    for index in range(start, start + strides * STRIDE):
        wanted = reference.sample(index * STEP_NS)
        reference.heed(wanted.position - wrong(plain.phase(index * STEP_NS)[0]))
    return start + strides * STRIDE


def ripple(phase):
    return 0.01 * np.cos(2 * np.pi * 3 * phase) + 0.004


def test_what_repeats_is_taken_out_with_the_lead_of_the_loop(learning):
    reference, _ = learning
    walk(learning, ripple, 5)
    assert np.abs(reference.shift[[1, 2, 4, 5, 6]]).max() < 5e-4
    assert np.angle(reference.shift[3]) == pytest.approx(2 * np.pi * 3 * 0.5 * 0.02, abs=0.05)
    assert reference.shift[0].real > 0.004


def test_desired_and_followed_motion_stand_apart_and_agree_with_their_rates(learning):
    reference, plain = learning
    end = walk(learning, ripple, 4)
    samples = [reference.sample((end + k) * STEP_NS) for k in range(3)]
    wanted = plain.sample((end + 1) * STEP_NS)
    assert samples[1][:3] == wanted[:3]
    places = [one.planned.position for one in samples]
    assert samples[1].planned.velocity == pytest.approx((places[2] - places[0]) / 0.01, abs=2e-3)
    assert places[1] != wanted.position


def test_it_is_bounded(learning):
    reference, _ = learning
    walk(learning, lambda phase: 5 * ripple(phase), 12)
    assert np.abs(reference.shift).sum() <= 0.1 + 1e-12


def test_another_person_begins_anew(learning):
    reference, _ = learning
    end = walk(learning, ripple, 4)
    assert np.abs(reference.shift).sum() > 0.01
    left = []
    for _ in range(3):
        end = walk(learning, lambda phase: 8 * ripple(phase + 0.3), 1, end)
        left.append(np.abs(reference.shift).sum())
    assert min(left) == 0.0


def test_the_error_of_a_walk_halves():
    parameters = load(scenario_overrides("person"))
    plain = make_trajectory(parameters)

    def errors(trajectory):
        run = ClosedLoop(parameters, 1, trajectory=trajectory).run(2600)
        error = (run["reference_angle"] - run["true_angle"])[600:].reshape(5, STRIDE)
        return np.sqrt(np.mean(error**2, axis=1))

    without, with_it = errors(plain), errors(Repetition(plain, parameters))
    assert with_it[-1] < 0.5 * without[0]
    assert (with_it < 1.02 * without).all()
