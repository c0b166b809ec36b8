# SPDX-License-Identifier: Apache-2.0
"""Laws by name in the graph: the same numbers as without ROS."""

import numpy as np
import pytest

from pam_orthosis.bag.read import read_bag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.peers import PEERS
from pam_orthosis.model.parameters import load

START = {"scenario.start_hold": 0.1, "scenario.start_ramp": 0.2}  # of `run_graph`


GAINS = {
    "pid": ("control.pid.integral", 1.0e4),
    "proxy_sliding_mode": ("control.proxy_sliding_mode.limit", 80.0),
    "adrc": ("control.adrc.bandwidth", 19.0),
}


@pytest.mark.parametrize("name", list(PEERS))
def test_each_law_runs_in_the_graph_with_its_gains_as_without_ros(run_graph, name):
    law, (gain, value) = "control.position.controller", GAINS[name]
    words = ("--param", f"{law}={name}", "--param", f"{gain}={value}")
    done, bag = run_graph("--duration", "2", "--composed", *words)
    assert done.returncode in (0, 1), done.stderr
    angle = read_bag(bag, ["angle"])["angle"].value
    parameters = load({**START, law: name, gain: value})
    expected = ClosedLoop(parameters, parameters.scenario.seed).run(len(angle))
    np.testing.assert_array_equal(angle, expected["angle"])
    assert np.degrees(np.abs(expected["reference_angle"] - angle)).max() < 6.0


def test_a_mode_in_which_a_law_makes_no_sense_is_refused(run_graph):
    refused, bag = run_graph(
        *("--param", "control.position.controller=pid"), *("--param", "control.cooperation.mode=assist")
    )
    assert refused.returncode == 2
    assert "is for control.cooperation.mode = position, not assist" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert not bag.exists()
