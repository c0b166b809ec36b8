# SPDX-License-Identifier: Apache-2.0
"""What is asked of a machine and of its actuators."""

from enum import Enum
from typing import NamedTuple


class Valve(Enum):
    """What may be asked of an actuator in place of a pressure: that its valve stays closed.

    The value stands for it, as a pressure in absolute Pa, in messages, bags and tables.
    """

    CLOSED = 0.0


PressureReference = float | Valve  # absolute, Pa
Pressures = tuple[float, float]  # of both actuators in the machine's order, absolute, Pa


def as_number(asked: PressureReference) -> float:
    """Return what stands for a reference pressure where there are numbers only."""
    return float(asked.value) if isinstance(asked, Valve) else asked


def from_number(number: float) -> PressureReference:
    """Return the reference pressure for which a number stands."""
    return Valve.CLOSED if number == Valve.CLOSED.value else number


class Motion(NamedTuple):
    """Position of the coordinate, rad or m, and its first two derivatives."""

    position: float
    velocity: float
    acceleration: float


class Reference(NamedTuple):
    """Desired motion (rad or m, and derivatives) and mean pressure of the actuators (absolute, Pa).

    Without a mean pressure the controller takes its own. With a plan the planned motion is followed; the
    desired one is what the error counts from. `beside` is the desired motion of a coupled joint.
    """

    position: float
    velocity: float
    acceleration: float
    mean_pressure: PressureReference | None = None
    planned: Motion | None = None
    beside: Motion | None = None
