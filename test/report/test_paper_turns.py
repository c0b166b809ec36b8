# SPDX-License-Identifier: Apache-2.0
"""Which samples follow a change in direction."""

import numpy as np

from pam_orthosis.identification.samples import Samples
from pam_orthosis.report.paper.table import WAY, after_turns


def test_samples_after_a_change_in_direction_are_found_in_each_run():
    up = np.linspace(0.0, 0.04, 41)
    contraction = np.concatenate([up, up[::-1], up])
    rate = np.repeat([0.03, -0.03, 0.03], 41)
    serial = np.repeat([0, 0, 1], 41)
    zero = np.zeros(len(rate))
    s = Samples(zero, contraction, rate, zero, zero + 1, zero, serial)
    found = after_turns(s)
    assert found.sum() == len(up[up <= WAY + 1e-12])
    assert found[41:47].all()
    assert not found[82:].any()  # another run begins: no change in direction
