# SPDX-License-Identifier: Apache-2.0
"""A small fixed share of the campaign of kills: faults at given instants of the run, in real runs.

How long the end takes depends on the machine, and is left to the campaign.
"""

import campaign_path  # noqa: F401
import pytest
from fault_campaign import kills
from fault_campaign.kills import OF_BOTH, WRITER, Kill

from pam_orthosis.bag.topics import POSITION, RECORDER, TRAJECTORY

pytest.importorskip("rclpy")


@pytest.mark.parametrize(
    "kill",
    [
        Kill("lockstep", TRAJECTORY, "SIGKILL", 400_000_000),
        Kill("lockstep", POSITION, "SIGSTOP", None),
        Kill("composed", POSITION, "exception", 400_000_000),
        Kill("lockstep", RECORDER, OF_BOTH, 700_000_000),
        Kill("composed", WRITER, "SIGSTOP", 700_000_000),
        Kill("composed", WRITER, "hang", 700_000_000),
        Kill("composed, real time", WRITER, "SIGSTOP, then SIGKILL", 700_000_000),
        Kill("two legs, composed", POSITION, "SIGKILL", 400_000_000, "left"),
        Kill("lockstep", POSITION, "entry script SIGHUP", 400_000_000),
        Kill("composed", POSITION, "entry script SIGINT, five times", 400_000_000),
    ],
    ids=lambda kill: f"{kill.mode} {kill.node} {kill.act}",
)
def test_a_run_with_a_fault_ends_well(kill, tmp_path):
    ending = kills.suffer(kill, tmp_path)
    assert ending.faults == []
    assert ending.recovered == (kill.act == OF_BOTH)
    assert ending.vented is (None if kill.after_ns is None or kill.act == OF_BOTH else True)
    if kill.node == WRITER:
        assert f"node composed ended with 3: {WRITER} " in ending.message
    if kill.act == "exception":  # several nodes share the process
        assert f"in {kill.node}: Faulty: injected" in ending.message
