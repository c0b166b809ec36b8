# SPDX-License-Identifier: Apache-2.0
"""The recorder's order is that of instants and table, whatever the arrival was."""

from hypothesis import given, settings
from hypothesis import strategies as st

from pam_orthosis.bag.steps import Message, StepCollector
from pam_orthosis.bag.topics import SLOW, Topics, is_health_instant
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)
ORDER = {topic.name: index for index, topic in enumerate(TABLE.all)}

PERIOD_NS = 250_000_000


def _run(steps):
    """Return all messages of a run, topic by topic."""
    return [
        Message(topic.name, k * PERIOD_NS, name.encode())
        for topic in TABLE.recorded
        for k in range(steps)
        if topic.rate == "step" or is_health_instant(k * PERIOD_NS, PERIOD_NS)
        for name in topic.producers
    ]


def _place(message):
    return message.stamp_ns, ORDER[message.topic], message.data


@settings(deadline=None)
@given(st.permutations(_run(5)), st.lists(st.integers(0, 60), max_size=10))
def test_any_arrival_gives_one_order_once(arrival, repeated):
    steps = StepCollector(PERIOD_NS, TABLE.of_run())
    out = []
    for message in [*arrival, *(arrival[index] for index in repeated)]:
        if steps.add(message):
            out += steps.complete()
    assert out == sorted(_run(5), key=_place)
    assert steps.duplicates == len(repeated)
    assert steps.done_ns == 4 * PERIOD_NS


def test_health_is_due_once_a_second_from_every_node():
    instants = [k for k in range(9) if is_health_instant(k * PERIOD_NS, PERIOD_NS)]
    assert instants == [0, 4, 8]
    steps = StepCollector(PERIOD_NS, TABLE.of_run())
    messages = _run(1)
    for message in messages[:-1]:
        steps.add(message)
    assert list(steps.complete()) == []
    steps.add(messages[-1])
    assert len(list(steps.complete())) == 19 + len(TABLE.nodes)


def test_the_first_missing_topic_is_the_cause():
    steps = StepCollector(PERIOD_NS, TABLE.of_run())
    for message in _run(1):
        if ORDER[message.topic] < ORDER["extensor/mass_flow"]:
            steps.add(message)
    assert next(iter(steps.missing())) == "extensor/mass_flow"
    assert next(steps.rest()).topic == "/clock"


def test_whatever_comes_for_later_instants_drops_nothing_of_this_one():
    steps, run, out = StepCollector(PERIOD_NS, TABLE.of_run()), _run(3), []
    for k in range(3, 5000):
        strange = Message("extensor/valve_command", k * PERIOD_NS, b"stranger")
        for message in (strange, *(m for m in run if k == 4999)):
            out += steps.complete() if steps.add(message) else []
    assert out == sorted(run, key=_place)
    assert steps.duplicates == 0
    assert len(list(steps.rest())) == 4997


def test_in_real_time_a_late_report_of_health_is_kept_and_holds_up_nothing():
    run = _run(8)
    late = next(m for m in run if m.topic == "/diagnostics")
    steps = StepCollector(PERIOD_NS, TABLE.of_run(), late_ns=PERIOD_NS)
    for message in [m for m in run if m is not late]:
        steps.add(message)
    assert late not in list(steps.complete())
    for message in (late, run[0]):
        steps.add(message)
    assert list(steps.complete()) == [late]
    assert steps.duplicates == 1


def test_in_real_time_an_incomplete_instant_leaves_when_it_is_old():
    steps = StepCollector(PERIOD_NS, TABLE.of_run(), late_ns=2 * PERIOD_NS)
    run = sorted(_run(8), key=_place)
    for message in [m for m in run if m.stamp_ns or m.topic not in ("truth", "estimate")]:
        steps.add(message)
        left = list(steps.complete())
        assert not left or message.stamp_ns >= 3 * PERIOD_NS
        if left:
            break
    assert {m.stamp_ns for m in left} == {0, PERIOD_NS, 2 * PERIOD_NS}
    afterwards = [m for m in run if not m.stamp_ns and m.topic in ("truth", "estimate")]
    for message in afterwards:
        steps.add(message)
    assert list(steps.complete()) == afterwards


def test_what_waited_can_be_handed_out_in_parts():
    steps = StepCollector(PERIOD_NS, TABLE.of_run())
    for message in _run(5):
        steps.add(message)
    parts = [list(steps.complete(2)) for _ in range(4)]
    assert [sorted({m.stamp_ns // PERIOD_NS for m in part}) for part in parts] == [[0, 1], [2, 3], [4], []]
    assert [m for part in parts for m in part] == sorted(_run(5), key=_place)


def _slow_run(steps, every, first=0):
    """Return all messages of a run whose slow nodes take each `every`-th step."""
    messages = []
    for message in _run(first + steps):
        k = message.stamp_ns // PERIOD_NS - first
        if message.topic != "/diagnostics" and k >= 0 and (k % every == 0 or not _is_slow(message.topic)):
            messages.append(message)
    for name in TABLE.nodes:
        period_ns = PERIOD_NS * (every if name in SLOW else 1)
        for k in range(0, steps, every if name in SLOW else 1):
            if is_health_instant((first + k) * PERIOD_NS, period_ns):
                messages.append(Message("/diagnostics", (first + k) * PERIOD_NS, name.encode()))
    return sorted(messages, key=_place)


def _is_slow(topic):
    return next(one for one in TABLE.recorded if one.name == topic).slow


@settings(deadline=None)
@given(st.permutations(_slow_run(7, 3)))
def test_slow_topics_are_due_at_their_own_instants_only(arrival):
    steps, out = StepCollector(PERIOD_NS, TABLE.of_run(), every=3), []
    for message in arrival:
        if steps.add(message):
            out += steps.complete()
    assert out == _slow_run(7, 3)
    assert not list(steps.rest())


def test_an_instant_of_slow_nodes_waits_for_them_and_names_what_is_missing():
    steps = StepCollector(PERIOD_NS, TABLE.of_run(), every=3)
    run = _slow_run(5, 3)
    for message in run:
        if (message.topic, message.stamp_ns) != ("estimate", 3 * PERIOD_NS):
            steps.add(message)
    assert [m.stamp_ns // PERIOD_NS for m in steps.complete()][-1] == 2
    assert list(steps.missing()) == ["estimate"]
    quick = StepCollector(PERIOD_NS, TABLE.of_run(), every=3)
    for message in run:
        if message.stamp_ns == PERIOD_NS and message.topic != "truth":
            quick.add(message)
    assert list(quick.missing()) == ["truth"]


def test_in_real_time_the_messages_tell_which_instants_are_slow():
    first = 2
    steps, out = StepCollector(PERIOD_NS, TABLE.of_run(), late_ns=100 * PERIOD_NS, every=3), []
    run = _slow_run(7, 3, first)
    for message in run:
        if message.topic == "truth" and message.stamp_ns == (first + 3) * PERIOD_NS:
            continue
        steps.add(message)
        out += steps.complete()
    assert out == [m for m in run if m.stamp_ns < (first + 3) * PERIOD_NS]


def test_what_a_whole_later_instant_has_overtaken_leaves_though_it_is_not_whole():
    messages = [message for message in _run(4) if message.topic != "reference"]
    references = [message for message in _run(4) if message.topic == "reference"]
    steps = StepCollector(PERIOD_NS, TABLE.of_run())
    for message in [*messages, references[0]]:
        steps.add(message)
    assert {message.stamp_ns for message in steps.complete()} == {0}
    assert list(steps.overtaken()) == []  # no later one is whole
    steps.add(references[2])
    out = list(steps.overtaken())
    there = [message for message in (*messages, references[2]) if 0 < message.stamp_ns <= 2 * PERIOD_NS]
    assert out == sorted(there, key=_place)
    assert steps.done_ns == 2 * PERIOD_NS
    steps.add(references[3])
    assert {message.stamp_ns for message in steps.complete()} == {3 * PERIOD_NS}
