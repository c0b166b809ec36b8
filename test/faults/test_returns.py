# SPDX-License-Identifier: Apache-2.0
"""A small share of the campaign of returns, and how it is told who came again."""

import campaign_path  # noqa: F401
import pytest

pytest.importorskip("rclpy")
from fault_campaign import returns
from fault_campaign.returns import DRIVER, Leaving

from pam_orthosis.bag.topics import POSITION
from pam_orthosis.nodes import ownership


@pytest.mark.parametrize(
    "leaving",
    [
        Leaving(POSITION, "SIGTERM", 4.0),
        Leaving(POSITION, "SIGKILL", 0.5),
        Leaving(DRIVER, "SIGKILL", 0.5),
        Leaving(POSITION, "SIGKILL", 0.5, lockstep=True),
    ],
    ids=lambda leaving: (
        f"{leaving.who} {leaving.signal} {leaving.seconds:g} s{' in lockstep' * leaving.lockstep}"
    ),
)
def test_who_comes_again_takes_its_place_and_the_knee_follows(leaving, tmp_path):
    assert returns.suffer(leaving, tmp_path / "graph").faults == []


@pytest.fixture
def clock(monkeypatch):
    """Return a list with the time that the module sees."""
    now = [100.0]
    monkeypatch.setattr(ownership.time, "monotonic", lambda: now[0])
    return now


def test_who_comes_again_is_waited_for_until_its_name_is_known(clock):
    names = ["/position_controller"]
    place = ownership._Place(1, {"position_controller"}.issuperset, lambda: names)
    assert place.is_right(1)
    assert place.is_right(2) is None
    clock[0] += 0.9 * ownership.PATIENCE_SECONDS
    assert place.is_right(2) is None
    names.append("/position_controller")
    assert place.is_right(2) is True
    assert place.is_right(3) is None


@pytest.mark.parametrize("known", [[], ["/stranger"]], ids=["without a name", "with another"])
def test_who_has_never_been_there_is_refused_in_the_end(clock, known):
    place = ownership._Place(1, {"position_controller"}.issuperset, lambda: ["/position_controller", *known])
    assert place.is_right(2) is (False if known else None)
    clock[0] += 1.1 * ownership.PATIENCE_SECONDS
    assert place.is_right(2) is False


def test_who_speaks_beside_another_is_refused_at_once(clock):
    place = ownership._Place(1, {"position_controller"}.issuperset, lambda: ["/position_controller"] * 2)
    place.heard = clock[0] - 0.1
    assert place.is_right(2) is False


NAMES = [f"/{name}" for name in ("one", "two", "three")]


@pytest.mark.parametrize(
    ("there", "right"),
    [
        ([*NAMES, "/one", "/two", "/two"], True),
        ([*NAMES, "/one", "/stranger"], False),
        (["/one", "/one", "/two", "/stranger"], False),
    ],
    ids=["three of two names", "a stranger too", "a stranger for one who left"],
)
def test_where_several_speak_their_names_tell_who_belongs_there(clock, there, right):
    place = ownership._Place(len(NAMES), {"one", "two", "three"}.issuperset, lambda: there)
    place.heard = clock[0]  # what is latched is heard again whenever one comes
    assert place.is_right(len(there)) is right
    clock[0] += 1.1 * ownership.LEASE_SECONDS  # some have been forgotten, others came again
    assert place.is_right(len(there)) is right
