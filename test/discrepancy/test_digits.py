# SPDX-License-Identifier: Apache-2.0
"""Both ends of an interval show its width."""

import pytest

from pam_orthosis.discrepancy.answer.digits import UNKNOWN, digits, interval_words


@pytest.mark.parametrize(
    ("lower", "upper", "fewest", "shown"),
    [
        (52.57, 52.64, 3, "52.57 .. 52.64"),
        (1.0, 3.0, 3, "1 .. 3"),
        (-52.64, -52.57, 3, "-52.64 .. -52.57"),
        (2.0, 2.0, 4, "2 .. 2"),
        (1.0, 1.0 + 1e-14, 4, "1 .. 1"),
    ],
)
def test_the_ends_of_an_interval_differ_where_it_has_a_width(lower, upper, fewest, shown):
    count = digits(lower, upper, fewest)
    assert f"{lower:.{count}g} .. {upper:.{count}g}" == shown


def test_an_interval_without_a_width_is_unknown():
    assert interval_words(34.66, 34.67, 4, "..") == "34.66 .. 34.67"
    assert interval_words(34.66, 34.66 + 1e-9, 4, "..") == UNKNOWN
    assert interval_words(0.0, 0.0, 4, "to", " N") == UNKNOWN
    assert interval_words(0.0, 1.0, 4, "to", " N") == "0 to 1 N"
