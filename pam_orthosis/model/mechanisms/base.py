# SPDX-License-Identifier: Apache-2.0
"""What a machine asks of its mechanism."""

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca

from pam_orthosis.model.rows import Field, Section
from pam_orthosis.model.signals import Expression, Signals

GRAVITY = 9.81  # m/s^2


@dataclass(frozen=True)
class Coordinate:
    """How a coordinate is called: its kind, itself, its unit, what moves it, and the unit of that.

    To people it is shown in `shown_unit`, `shown_factor` times as large a number.
    """

    kind: str
    name: str
    unit: str
    effort: str
    effort_unit: str
    shown_unit: str
    shown_factor: float

    def shown(self, value: float, form: str = ".2f") -> str:
        """Return a coordinate, or a distance of two, for people."""
        return f"{value * self.shown_factor:{form}} {self.shown_unit}"


ROTATION = Coordinate("rotation", "angle", "rad", "torque", "N m", "deg", 180.0 / math.pi)
TRANSLATION = Coordinate("translation", "position", "m", "force", "N", "mm", 1e3)


@dataclass(frozen=True)
class Mechanics:
    """The terms of Eq. (26): inertia m(q), k(q, q-dot), G(q), so that m q-ddot + k + G is the effort."""

    inertia: Expression
    coriolis: Expression
    gravity: Expression


def acceleration(effort: Expression, terms: Mechanics) -> Expression:
    """Return q-double-dot of Eq. (26) for the sum of all forces or torques on the coordinate."""
    return (effort - terms.coriolis - terms.gravity) / terms.inertia


def stop_effort(q: Expression, velocity: Expression, stops: Section) -> Expression:
    """Return the force or torque of soft stops at the ends of a range.

    A stop only pushes: its damper cannot hold the load back when it leaves the stop.
    """
    below = ca.fmax(stops.minimum - q, 0)
    above = ca.fmax(q - stops.maximum, 0)
    push_up = below * (stops.stop_stiffness - stops.stop_damping * velocity)
    push_down = above * (stops.stop_stiffness + stops.stop_damping * velocity)
    return ca.fmax(push_up, 0) - ca.fmax(push_down, 0)


@dataclass(frozen=True)
class Mechanism(ABC):
    """One coordinate that actuators move.

    Attributes:
        kind: as machines name it.
        coordinate: its name and units.
        inputs: what acts on it from outside, beside the actuators.
        stops: names of the parameters that bound the coordinate; empty: nothing does.
        live: keys of parameters that may change while a machine runs.
        rows: how the keys of `config/` begin that only machines of its kind have; empty: with its branch.
        subject: the file of `config/` with such rows, if they have one of their own.
        fields: what a machine's file gives, and a transmission for each actuator; empty: it names a branch.
        parameters: its section of the parameters.
    """

    kind: ClassVar[str]
    coordinate: ClassVar[Coordinate]
    inputs: ClassVar[tuple[str, ...]]
    stops: ClassVar[tuple[str, ...]] = ()
    live: ClassVar[tuple[str, ...]] = ()
    rows: ClassVar[tuple[str, ...]] = ()
    subject: ClassVar[str] = ""
    fields: ClassVar[tuple[Field, ...]] = ()
    parameters: Section

    @property
    def ends(self) -> Section:
        """The parameters of its soft stops."""
        return self.parameters

    @property
    def limits(self) -> tuple[Expression, Expression]:
        """Its stops: least and largest coordinate."""
        return self.ends.minimum, self.ends.maximum

    @property
    def locked(self) -> bool:
        """Whether its coordinate is held where it is."""
        return False

    @property
    def idle(self) -> Mapping[str, str]:
        """Its live keys that have no effect on it as it is, and why."""
        return {}

    @abstractmethod
    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return the terms of Eq. (26), with a mass that an effect adds, kg."""

    @abstractmethod
    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contraction of each actuator at a coordinate, in the machine's order, m."""

    def effort(self, s: Signals) -> Expression:
        """Return the force or torque on the coordinate, without any effect's.

        By virtual work: an actuator of tension F adds F dL/dq.
        """
        arms = (ca.jtimes(contraction, s.coordinate, 1) for contraction in self.contractions(s.coordinate))
        total = sum(one.tension * arm for one, arm in zip(s.actuators.values(), arms, strict=True))
        return total + stop_effort(s.coordinate, s.velocity, self.ends) + s.external[self.inputs[0]]
