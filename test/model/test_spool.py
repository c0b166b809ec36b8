# SPDX-License-Identifier: Apache-2.0
"""A valve's command as a position of its spool: what is sent comes back to the bit."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pam_orthosis.model.components.spool import VENT, as_commanded, spool_position, voltage_of
from pam_orthosis.model.parameters import load

SHIPPED = load().valve
UNEVEN = load(
    {"valve.minimum_voltage": -1.0, "valve.closed_voltage": 4.0, "valve.maximum_voltage": 9.5}
).valve


@pytest.mark.parametrize("valve", [SHIPPED, UNEVEN], ids=["shipped", "uneven"])
def test_vent_closed_and_fill_are_exact(valve):
    volts = valve.minimum_voltage, valve.closed_voltage, valve.maximum_voltage
    assert [spool_position(each, valve) for each in volts] == [VENT, 0.0, 1.0]
    assert tuple(voltage_of(each, valve) for each in (VENT, 0.0, 1.0)) == volts
    assert voltage_of(0.5, valve) == (valve.closed_voltage + valve.maximum_voltage) / 2


@given(st.floats(-1.0, 1.0))
def test_a_voltage_that_was_a_position_survives_any_number_of_trips_to_the_bit(position):
    for valve in (SHIPPED, UNEVEN):
        sent = voltage_of(position, valve)
        assert voltage_of(spool_position(sent, valve), valve) == sent


@given(st.floats(0.0, 10.0))
def test_of_any_voltage_no_more_than_rounding_is_lost(voltage):
    assert as_commanded(voltage, SHIPPED) == pytest.approx(voltage, abs=2e-15)


def test_what_is_no_number_stays_none():
    assert math.isnan(spool_position(math.nan, SHIPPED))
