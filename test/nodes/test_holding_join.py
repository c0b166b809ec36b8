# SPDX-License-Identifier: Apache-2.0
"""Slow inputs are held between their instants: those of the right one by stamp, whatever came when."""

from hypothesis import given
from hypothesis import strategies as st

from pam_orthosis.nodes.join import HoldingJoin

QUICK, SLOW = ("pressure",), ("reference", "estimate")
INPUTS = ("pressure", "reference", "estimate")
PERIOD_NS, EVERY, STEPS = 2_000_000, 3, 11
STAMPS = [k * PERIOD_NS for k in range(STEPS)]
SENT = {name: STAMPS if name in QUICK else STAMPS[::EVERY] for name in INPUTS}


def _join(**options):
    calls = []
    join = HoldingJoin(INPUTS, SLOW, lambda *step: calls.append(step), EVERY * PERIOD_NS, **options)
    return calls, join


def _expected(k):
    slow = k // EVERY * EVERY * PERIOD_NS
    now = k * PERIOD_NS
    return now, ("pressure", now), ("reference", slow), ("estimate", slow), (now - slow) * 1e-9


@given(st.permutations([name for name, stamps in SENT.items() for _ in stamps]))
def test_each_sample_goes_with_the_slow_instant_that_is_its_own(interleaving):
    """DDS keeps each topic in order; how the topics interleave is free."""
    calls, join = _join()
    left = {name: iter(stamps) for name, stamps in SENT.items()}
    for name in interleaving:
        stamp = next(left[name])
        join.add(name, stamp, (name, stamp))
    assert calls == [_expected(k) for k in range(STEPS)]
    assert join.dropped == 0


def test_what_comes_in_the_order_of_lockstep_is_computed_completely_and_at_once():
    calls, join = _join()
    for k, stamp in enumerate(STAMPS):
        for name in INPUTS if k % EVERY == 0 else QUICK:
            join.add(name, stamp, (name, stamp))
        assert calls[-1] == _expected(k)
    assert len(calls) == STEPS
    assert join.dropped == 0


def test_an_older_slow_instant_never_stands_in_for_one_that_is_missing():
    calls, join = _join()
    for stamp in STAMPS:
        for name, stamps in SENT.items():
            if stamp in stamps and (name, stamp) != ("estimate", STAMPS[3]):
                join.add(name, stamp, (name, stamp))
    assert [call[0] for call in calls] == [*STAMPS[:3], *STAMPS[6:]]
    assert join.dropped == EVERY


def test_samples_before_the_first_slow_instant_are_no_fault():
    calls, join = _join()
    for stamp in STAMPS[:4]:
        join.add("pressure", stamp, ("pressure", stamp))
    for name in SLOW:
        join.add(name, STAMPS[3], (name, STAMPS[3]))
    assert calls == [_expected(3)]
    assert join.dropped == 0


def test_repetitions_are_counted_and_never_used():
    calls, join = _join()
    for name in (*INPUTS, *INPUTS):
        join.add(name, 0, (name, 0))
    assert calls == [_expected(0)]
    assert join.dropped == len(INPUTS)


def test_inputs_that_never_meet_cost_no_memory():
    for alone in (QUICK, SLOW):
        calls, join = _join(horizon=10)
        for k in range(1000):
            for name in alone:
                join.add(name, k * PERIOD_NS, (name, k))
        assert calls == []
        assert len(join._samples) <= 10
        assert len(join._commands) <= 10
