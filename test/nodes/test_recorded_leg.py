# SPDX-License-Identifier: Apache-2.0
"""When the recorder of a run in real time has time to write, and when it waits no longer."""

import time
from types import SimpleNamespace

import pytest

from pam_orthosis.errors import RunFailed
from pam_orthosis.nodes.recorded_leg import RecordedLeg

SAMPLE, ANSWER, OTHER = (True, False), (False, True), (False, False)


@pytest.fixture
def leg():
    settings = {"with_plant": False, "sample_timeout": 5.0}
    node = SimpleNamespace(realtime=True, publish_to=lambda topic, leg: None, settings=settings)
    node.active, node.legs, node.supervised = False, [""], True
    return RecordedLeg(node, "", 10**9, None)


def test_nothing_is_written_while_the_controllers_work(leg):
    came = [SAMPLE, OTHER, OTHER, ANSWER] * 3
    assert [leg.unhurried(*one) for one in came] == [False, False, False, True] * 3


def test_what_finds_no_answer_is_written_too(leg):
    came = [SAMPLE, OTHER, SAMPLE, OTHER, SAMPLE, ANSWER, SAMPLE]
    assert [leg.unhurried(*one) for one in came] == [False, False, True, False, True, True, False]


def test_a_driver_that_never_sends_a_sample_fails_the_run(leg, monkeypatch):
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now)
    now += 100.0  # as long as it takes until all peers are there
    assert not leg.over()
    leg.begin()
    leg._node.active = True
    for _ in range(49):
        now += 0.1
        assert not leg.over()
    now += 0.3
    with pytest.raises(RunFailed, match="no sample on joint_states for 5 s: does the driver run"):
        leg.over()


def test_time_in_which_the_machine_stood_still_is_no_silence(leg, monkeypatch):
    now = time.monotonic()
    monkeypatch.setattr(time, "monotonic", lambda: now)
    leg.begin()
    leg._node.active = True
    for _ in range(4):
        now += 100.0
        assert not leg.over()


def test_the_plant_may_wait_for_the_others(leg, monkeypatch):
    leg._node.settings["with_plant"] = leg._node.active = True
    later = time.monotonic() + 50.0
    monkeypatch.setattr(time, "monotonic", lambda: later)
    assert not leg.over()
