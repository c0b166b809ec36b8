# SPDX-License-Identifier: Apache-2.0
"""Places of numbers in serialised messages, against another implementation of the same format."""

import math
import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pam_orthosis.bag import messages
from pam_orthosis.bag.cdr import LITTLE_ENDIAN, Reader, Shape, Template, Unreadable, canonical, store
from pam_orthosis.bag.definitions import FIELDS
from pam_orthosis.bag.topics import Topics
from pam_orthosis.model.machines import KNEE

TABLE = Topics(KNEE)

JOINT = "sensor_msgs/msg/JointState"
TYPES = sorted({topic.type for topic in TABLE.recorded})
TEXTS = st.text(st.characters(codec="ascii", min_codepoint=32), max_size=9)
NUMBERS = st.floats(width=32)


def built(draw, name):
    """Draw a message of a type."""
    values = {field: drawn(draw, *definition) for field, definition in store().fielddefs[name][1]}
    return store().types[name](**values)


def drawn(draw, kind, what):
    if kind.name == "NAME":
        return built(draw, what)
    if kind.name == "BASE":
        if what[0] == "string":
            return draw(TEXTS)
        return draw(NUMBERS) if what[0].startswith("float") else draw(st.integers(0, 127))
    inner, _ = what
    values = [drawn(draw, *inner) for _ in range(draw(st.integers(0, 3)))]
    numeric = inner[0].name == "BASE" and inner[1][0] != "string"
    return np.array(values, dtype=inner[1][0]) if numeric else values


@pytest.mark.parametrize("name", TYPES)
@settings(max_examples=12, deadline=None)
@given(data=st.data())
def test_what_memory_held_in_the_padding_goes(name, data):
    whole = bytes(store().serialize_cdr(built(data.draw, name), name))
    shape = Shape(whole, name)
    assert shape.size == len(whole)
    ones = shape.canonical((1 << 8 * len(whole)) - 1)
    kept = {index for index, byte in enumerate(ones) if byte}
    noise = random.Random(len(whole))
    dirty = bytes(byte if i in kept else noise.randrange(256) for i, byte in enumerate(whole))
    trailing = bytes(noise.randrange(256) for _ in range(noise.randrange(4)))
    assert canonical(dirty + trailing, name) == whole
    assert canonical(whole, name) == whole


def joint(names=("knee",), position=(0.5,), velocity=(), effort=(), frame="", stamp=(3, 7)):
    types = store().types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](*stamp), frame)
    arrays = (np.array(values, dtype=float) for values in (position, velocity, effort))
    message = types[JOINT](header, list(names), *arrays)
    return bytes(store().serialize_cdr(message, JOINT))


def test_numbers_are_taken_whatever_the_shape():
    read = Reader(JOINT, ("effort[0]", "position[0]"))
    assert read(joint(position=[0.25], effort=[2.0, 3.0])) == (3_000_000_007, (2.0, 0.25))
    assert read(joint(["a", "b"], [0.75, 1.0], effort=[4.0], frame="leg")) == (3_000_000_007, (4.0, 0.75))
    stamp, (effort, position) = read(joint(position=[0.125]))
    assert (stamp, position) == (3_000_000_007, 0.125)
    assert math.isnan(effort)


def test_another_shape_of_the_same_size_is_noticed():
    read = Reader(JOINT, ("position[0]", "effort[0]"))
    first, second = joint(position=[1.0]), joint(position=[], effort=[2.0])
    assert len(first) == len(second)
    assert read(first)[1][0] == 1.0
    assert read(second)[1][1] == 2.0
    assert math.isnan(read(second)[1][0])


def test_the_other_byte_order_is_understood():
    message = store().deserialize_cdr(joint(position=[0.5]), JOINT)
    swapped = bytes(store().serialize_cdr(message, JOINT, little_endian=False))
    assert swapped[:2] != LITTLE_ENDIAN
    assert Reader(JOINT, ("position[0]",))(swapped) == (3_000_000_007, (0.5,))
    assert Reader(JOINT, ("position[0]",)).stamp_ns(swapped) == 3_000_000_007
    assert canonical(swapped, JOINT) == joint(position=[0.5])


def test_the_stamp_alone_needs_no_more_than_itself():
    read, whole = Reader(JOINT, ("position[0]",)), joint()
    assert [read.stamp_ns(whole[:size]) for size in (len(whole), 12)] == [3_000_000_007] * 2
    for size in (0, 1, 2, 11):
        with pytest.raises(Unreadable):
            read.stamp_ns(whole[:size])


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(0, 70), noise=st.binary(max_size=40))
def test_what_is_no_message_is_refused(cut, noise):
    broken = joint()[:cut] + noise
    read = Reader(JOINT, ("position[0]",))
    try:
        store().deserialize_cdr(broken, JOINT)
    except Exception:
        with pytest.raises(Unreadable):
            read(broken)
        assert canonical(broken, JOINT) == broken


def test_a_template_makes_what_a_serialiser_makes():
    example = joint(position=[0.0, 0.0], velocity=[0.0], frame="leg")
    make = Template(example, JOINT)
    stamp_ns = 5_000_000_009
    expected = joint(position=[1.5, -2.0], velocity=[3.25], frame="leg", stamp=(5, 9))
    assert make(stamp_ns, 1.5, -2.0, 3.25) == expected


@pytest.mark.parametrize("numbers", [(1.0,), (1.0, 2.0, 3.0)])
def test_a_template_wants_all_its_numbers_and_no_more(numbers):
    with pytest.raises(Exception, match="pack"):
        Template(joint(position=[0.0, 0.0]), JOINT)(0, *numbers)


@pytest.mark.parametrize("name", FIELDS)
def test_fields_are_those_of_the_standard(name):
    types = store()
    told = [f"{_spelt(*definition)} {field}" for field, definition in types.fielddefs[name][1]]
    assert FIELDS[name].split(", ") == told
    assert set(TYPES) <= set(FIELDS)


def _spelt(kind, what):
    if kind.name == "SEQUENCE":
        return f"{_spelt(*what[0])}[]"
    return what if kind.name == "NAME" else what[0]


def test_a_number_is_found_by_the_name_of_its_joint_wherever_it_stands():
    read = Reader(JOINT, ["position['knee']", "position['a[0]']", "position['knee']", "position[0]"])
    for names, expected in (
        (["knee", "a[0]"], (1.0, 2.0, 1.0, 1.0)),
        (["a[0]", "knee"], (2.0, 1.0, 2.0, 1.0)),
        (["toes", "knee"], (2.0, np.nan, 2.0, 1.0)),
    ):
        data = messages.serialised(JOINT, messages.joint_state(7, names, position=[1.0, 2.0]))
        stamp_ns, numbers = read(data)
        assert stamp_ns == 7
        np.testing.assert_array_equal(numbers, expected)
