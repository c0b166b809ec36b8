# SPDX-License-Identifier: Apache-2.0
"""A valve's command as the position of its spool, from -1 (vent open) to 1 (fill open), and back."""

import math

from pam_orthosis.model.rows import Section

VENT = -1.0


def voltage_of(position: float, valve: Section) -> float:
    """Return the voltage that asks for a relative position of the spool, V."""
    closed: float = valve.closed_voltage
    span: float = valve.maximum_voltage - closed if position >= 0 else closed - valve.minimum_voltage
    return closed + span * position


def spool_position(voltage: float, valve: Section) -> float:
    """Return the relative position of the spool that a voltage asks for.

    Where rounding leaves a choice it is the one that gives the voltage back to the bit, if one does.
    """
    closed: float = valve.closed_voltage
    away = voltage - closed
    near = away / (valve.maximum_voltage - closed if away >= 0 else closed - valve.minimum_voltage)
    others = near, math.nextafter(near, -math.inf), math.nextafter(near, math.inf)
    return next((one for one in others if voltage_of(one, valve) == voltage), near)


def as_commanded(voltage: float, valve: Section) -> float:
    """Return what is left of a voltage, to the last bit, once it is sent as a position of the spool, V."""
    return voltage_of(spool_position(voltage, valve), valve)
