# SPDX-License-Identifier: Apache-2.0
"""Join by stamp: right values, each instant once, in order, whatever the arrival was."""

from hypothesis import given
from hypothesis import strategies as st

from pam_orthosis.nodes.join import Join

INPUTS = ("angle", "pressure", "reference")
STEPS = 6


def _join(**options):
    calls = []
    return calls, Join(INPUTS, lambda stamp, *values: calls.append((stamp, values)), **options)


def _complete(stamp):
    return stamp, tuple((name, stamp) for name in INPUTS)


@given(st.permutations([name for name in INPUTS for _ in range(STEPS)]), st.data())
def test_topics_in_order_among_themselves_give_every_instant_once(interleaving, data):
    """DDS keeps each topic in order; how the topics interleave is free, and so are repetitions."""
    calls, join = _join()
    stamps = {name: iter(range(STEPS)) for name in INPUTS}
    sent = []
    for name in interleaving:
        stamp = next(stamps[name])
        sent.append((name, stamp))
        join.add(name, stamp, (name, stamp))
        again = data.draw(st.sampled_from(sent))
        join.add(*again, "a repetition must never be used")
    assert calls == [_complete(stamp) for stamp in range(STEPS)]
    assert join.dropped == len(sent)


@given(st.permutations([(name, stamp) for name in INPUTS for stamp in range(STEPS)]))
def test_any_arrival_gives_rising_stamps_with_their_own_values(arrival):
    calls, join = _join()
    for name, stamp in arrival:
        join.add(name, stamp, (name, stamp))
    stamps = [stamp for stamp, _ in calls]
    assert stamps == sorted(set(stamps))
    assert stamps[-1] == STEPS - 1
    assert calls == [_complete(stamp) for stamp in stamps]


def test_an_input_that_never_comes_is_named_and_costs_no_memory():
    calls, join = _join(horizon=10)
    for stamp in range(1000):
        join.add("angle", stamp, 0.0)
    assert calls == []
    assert join.missing(999) == ["pressure", "reference"]
    assert join.dropped == 990
