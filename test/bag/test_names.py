# SPDX-License-Identifier: Apache-2.0
"""Names of topics inside a namespace."""

import pytest

from pam_orthosis.bag.topics import resolve


@pytest.mark.parametrize("namespace", ["left", "/left", "left/", "/left/"])
def test_a_leg_is_found_with_and_without_slashes(namespace):
    assert resolve("joint_states", namespace) == "/left/joint_states"


@pytest.mark.parametrize("namespace", ["", "/"])
def test_no_leg_is_no_namespace(namespace):
    assert resolve("joint_states", namespace) == "/joint_states"
    assert resolve("/clock", "left") == "/clock"
