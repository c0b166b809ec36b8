# SPDX-License-Identifier: Apache-2.0
"""Hardware that comes into a run that is on begins behind it, and says so."""

from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")
from pam_orthosis.bag.topics import ANEW
from pam_orthosis.nodes.pace import Lockstep
from pam_orthosis.nodes.silence import Silence

MS = 1_000_000


@pytest.mark.parametrize(("recorded_ns", "anew"), [(-1, ""), (2000 * MS, "at 2.255 s")])
def test_hardware_that_comes_into_a_run_that_is_on_says_when_it_begins(recorded_ns, anew):
    told, stamps = [], []
    pace = Lockstep.__new__(Lockstep)
    pace._plant = SimpleNamespace(
        every=1,
        period_ns=5 * MS,
        is_lockstep=lambda: True,
        publish_sample=stamps.append,
        get_logger=lambda: SimpleNamespace(warning=told.append),
    )
    pace._silence = Silence()
    pace._join, pace._anew, pace._early = SimpleNamespace(dropped=0), {}, ()
    pace._stamp_ns, pace._last_ns, pace._longest_lead_ns = 0, 10_000 * MS, 250 * MS
    pace._recorded_ns = recorded_ns
    pace.begin()
    assert pace.health().get(ANEW, "") == anew
    assert [line.endswith(f"begins anew, at rest, {anew}") for line in told] == [True] * bool(anew)
    assert stamps == [2255 * MS if anew else 0]
