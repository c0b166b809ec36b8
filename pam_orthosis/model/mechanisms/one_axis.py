# SPDX-License-Identifier: Apache-2.0
"""A load on one axis, turned or pushed by actuators whose contraction is any function of its coordinate."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import casadi as ca
import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.mechanisms.base import ROTATION, TRANSLATION, Coordinate, Mechanics, Mechanism
from pam_orthosis.model.rows import Field, Section
from pam_orthosis.model.signals import Expression

LARGE = 1.0e6
TURN = 7.0  # rad: what is farther is in degrees
CONTRACTION = Field("contraction", "m", -LARGE, LARGE, "contraction at the coordinate zero", 0.0)
# how a contraction depends on the coordinate: name of the way -> what it is given by
TRANSMISSIONS = {
    "arm": (Field("arm", "m/rad or m/m", -LARGE, LARGE, "contraction per coordinate"), CONTRACTION),
    "lever": (
        Field("ground", "m", 1.0e-4, LARGE, "distance from the axis to the end that is held"),
        Field("lever", "m", 1.0e-4, LARGE, "distance from the axis to the end on the load"),
        Field(
            "angle", "rad", -TURN, TURN, "angle between the two at the coordinate zero; its sign is the side"
        ),
        CONTRACTION,
    ),
    "table": (
        Field("coordinates", "rad or m", -LARGE, LARGE, "places, rising, 3 to 40 of them", many=True),
        Field("contractions", "m", -LARGE, LARGE, "contraction at each place", many=True),
    ),
}


def _fields(inertia: str, effort: str, unit: str, farthest: float) -> tuple[Field, ...]:
    return (
        Field("inertia", inertia, 1.0e-6, LARGE, "mass, or moment of inertia about the axis"),
        Field("damping", f"{effort} s/{unit}", 0.0, LARGE, "viscous damping", 0.0),
        Field("stiffness", f"{effort}/{unit}", 0.0, LARGE, "stiffness of a spring", 0.0),
        Field("rest", unit, -LARGE, LARGE, "coordinate at which the spring is free of load", 0.0),
        Field("weight", effort, -LARGE, LARGE, "force, or largest torque, by which gravity pulls back", 0.0),
        Field("minimum", unit, -farthest, farthest, "lower stop"),
        Field("maximum", unit, -farthest, farthest, "upper stop"),
        Field("stop_stiffness", f"{effort}/{unit}", 0.0, 1.0e9, "stiffness of the stops", 1.0e5),
        Field("stop_damping", f"{effort} s/{unit}^2", 0.0, 1.0e9, "damping of the stops per depth", 1.0e3),
        Field("start", unit, -farthest, farthest, "coordinate at which it rests at the start"),
    )


def _between(a: Expression, b: Expression, angle: Expression) -> Expression:
    """Return the third side of a triangle by the law of cosines."""
    return ca.sqrt(a**2 + b**2 - 2 * a * b * ca.cos(angle))


def lever_contraction(q: Expression, section: Section) -> Expression:
    """Return the contraction, m, of an actuator between the ground and a lever that turns with q.

    By the law of cosines; its derivative, the moment arm, is the distance of the line of pull from the axis.
    """
    a, b, angle = section.ground, section.lever, section.angle
    return section.contraction + _between(a, b, angle) - _between(a, b, angle + q)


def _spline(places: list[float], values: list[float]) -> Callable[[Expression], Expression]:
    """Return the natural cubic spline through a table, straight beyond its ends."""
    from scipy.interpolate import CubicSpline  # takes a third of a second to load

    if any(low >= high for low, high in pairwise(places)):
        raise OrthosisError(f"coordinates of a transmission rise from one to the next, not so: {places}")
    spline = CubicSpline(places, values, bc_type="natural")
    bends = np.diff(spline.c[0], prepend=0.0)

    def contraction(q: Expression) -> Expression:
        inside = ca.fmin(ca.fmax(q, places[0]), places[-1])
        total = values[0] + float(spline.c[2][0]) * (inside - places[0])
        for place, bend in zip(places[:-1], bends, strict=True):
            total += float(bend) * ca.fmax(inside - place, 0) ** 3
        slope_low, slope_high = (float(spline(end, 1)) for end in (places[0], places[-1]))
        return total + slope_low * ca.fmin(q - places[0], 0) + slope_high * ca.fmax(q - places[-1], 0)

    return contraction


@dataclass(frozen=True)
class OneAxis(Mechanism):
    """What turning and pushing loads have in common; `transmissions` are the actuators', in order."""

    stops: ClassVar[tuple[str, ...]] = ("minimum", "maximum")
    transmissions: tuple[Callable[[Expression], Expression], ...]

    @staticmethod
    def transmission(section: Section) -> Callable[[Expression], Expression]:
        """Return coordinate -> contraction, by a constant arm, a lever or a table."""
        given = dict(section.items())
        if "lever" in given:
            return lambda q: lever_contraction(q, section)
        if "coordinates" in given:
            return _spline(section.coordinates, section.contractions)
        return lambda q: section.contraction + section.arm * q

    def contractions(self, q: Expression) -> tuple[Expression, ...]:
        """Return the contraction of each actuator, m."""
        return tuple(contraction(q) for contraction in self.transmissions)

    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return inertia, damping, and what weight and spring pull back."""
        p = self.parameters
        back = p.weight * self.leaning(q) + p.stiffness * (q - p.rest)
        return Mechanics(p.inertia + extra_mass, p.damping * velocity, back)

    def leaning(self, _q: Expression) -> Expression:
        """Return the share of the weight that pulls back: all of it on a line."""
        return 1


@dataclass(frozen=True)
class Rotation(OneAxis):
    """A load that turns about an axis; at `hanging` its centre of mass is below it."""

    kind: ClassVar[str] = "rotation"
    coordinate: ClassVar[Coordinate] = ROTATION
    inputs: ClassVar[tuple[str, ...]] = ("external_torque",)
    fields: ClassVar[tuple[Field, ...]] = (
        *_fields("kg m^2", "N m", "rad", TURN),
        Field("hanging", "rad", -TURN, TURN, "angle at which the load hangs straight down", 0.0),
    )

    @property
    def heading(self) -> Expression:
        """Where the centre of mass is at the coordinate zero: angle above x, rad."""
        return self.parameters.hanging - math.pi / 2

    def leaning(self, q: Expression) -> Expression:
        """Return the share of the weight's largest torque."""
        return ca.sin(q - self.parameters.hanging)


@dataclass(frozen=True)
class Sole(Rotation):
    """A sole that cushions load with a share of the body's weight; its coordinate is its pitch.

    The motion and the mean pressure of the scenario press with the weight of `course`, and are scaled to it.
    """

    kind: ClassVar[str] = "sole"
    fields: ClassVar[tuple[Field, ...]] = (
        *Rotation.fields,
        Field("share", "-", 0.05, 1.5, "share of the body's weight with which the sole is loaded"),
        Field("body_mass", "kg", 10.0, 250.0, "mass of the body"),
        Field("course", "kg", 0.5, 375.0, "mass with whose weight the scenario's course presses"),
    )

    @property
    def load(self) -> float:
        """What is asked for, over the scenario's course."""
        return float(self.parameters.share * self.parameters.body_mass / self.parameters.course)


@dataclass(frozen=True)
class Translation(OneAxis):
    """A load that slides along a line; its weight pulls towards lower coordinates."""

    kind: ClassVar[str] = "translation"
    coordinate: ClassVar[Coordinate] = TRANSLATION
    inputs: ClassVar[tuple[str, ...]] = ("external_force",)
    fields: ClassVar[tuple[Field, ...]] = _fields("kg", "N", "m", LARGE)
