# SPDX-License-Identifier: Apache-2.0
"""When the recorder of a run in real time has time to write."""

from types import SimpleNamespace

import pytest

from pam_orthosis.nodes.recorded_leg import RecordedLeg

SAMPLE, ANSWER, OTHER = (True, False), (False, True), (False, False)


@pytest.fixture
def leg():
    node = SimpleNamespace(realtime=True, run_ns=10**9, publish_to=lambda topic, leg: None)
    return RecordedLeg(node, "", None)


def test_nothing_is_written_while_the_controllers_work(leg):
    came = [SAMPLE, OTHER, OTHER, ANSWER] * 3
    assert [leg.unhurried(*one) for one in came] == [False, False, False, True] * 3


def test_what_finds_no_answer_is_written_too(leg):
    came = [SAMPLE, OTHER, SAMPLE, OTHER, SAMPLE, ANSWER, SAMPLE]
    assert [leg.unhurried(*one) for one in came] == [False, False, True, False, True, True, False]
