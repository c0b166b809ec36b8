# SPDX-License-Identifier: Apache-2.0
"""A small share of the campaign of strangers: whatever they forge, the run ends, names them and vents.

How soon it ends depends on the machine, and is left to the campaign.
"""

import campaign_path  # noqa: F401
import pytest
from fault_campaign import strangers
from fault_campaign.strangers import Forgery

from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

pytest.importorskip("rclpy")


@pytest.mark.parametrize(
    "forgery",
    [
        Forgery("lockstep", "publish", "end"),
        Forgery("lockstep", "publish", "ready", early=True),
        Forgery("lockstep", "serve", "trajectory_publisher/start"),
        Forgery("composed", "publish", "recorded"),
        Forgery("real time", "publish", "end"),
        Forgery("real time", "publish", "truth"),
        Forgery("two legs", "publish", "end"),
        Forgery("composed", "call", "position_controller"),
    ],
    ids=lambda forgery: f"{forgery.mode} {forgery.kind} {forgery.name}",
)
def test_a_run_with_a_stranger_ends_well(forgery, tmp_path):
    ending = strangers.suffer(forgery, tmp_path)
    assert ending.faults == []


def test_the_campaign_forges_every_topic_that_is_not_everybodys():
    forged = {each.name for each in strangers.forgeries() if each.kind == "publish"}
    there = [*TABLE.of_run().values(), *TABLE.of_run(realtime=True).values()]
    assert forged == {topic.name for topic in there if not topic.shared}
