# SPDX-License-Identifier: Apache-2.0
"""What a machine of one axis looks like: a box that slides along x or turns about y, its actuators beside it.

A muscle pulls the load and gets shorter, a cylinder's chamber pushes it and gets longer. Where the load
slides, each is on the side to which it pulls, or from which it pushes, and ends at the load's start. Where it
turns, each lies before the axis, as far above or below it as its moment arm at the start is long.
"""

import math
from typing import Protocol, cast

import casadi as ca

from pam_orthosis.model.components.muscle import braid_diameter
from pam_orthosis.model.machine import ActuatorOf
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression
from pam_orthosis.scene.shape import ZERO, Bar, Joint, Mass, Shape, Solid, Vector, ranges

BASE, LOAD = "base", "load"
EDGE = 0.06  # m, of the sliding box, and how thick the turning one is
LONG = 0.25  # m, of the box that turns


class _Turning(Protocol):
    """A mechanism whose load turns."""

    @property
    def heading(self) -> float:
        """Where the load points at the coordinate zero, rad above x."""


def one_axis(parameters: Parameters) -> Shape:
    """Return the shape of a machine whose load slides or turns."""
    machine = parameters.declared
    mechanism, start = machine.mechanism(parameters), parameters.at(machine.start)
    turns = machine.coordinate.unit == "rad"
    q = ca.SX.sym("q")
    contractions = mechanism.contractions(q)
    measures = [
        _measures(one, parameters, dl) for one, dl in zip(machine.actuators, contractions, strict=True)
    ]
    function = ca.Function("shape", [q], [q, *contractions, *(diameter for _, _, diameter in measures)])
    arms = ca.Function("arms", [q], [ca.jtimes(one, q, 1) for one in contractions])(start)
    own, *slides = ranges(function, *mechanism.limits)
    at_start, bars = function(start), {}
    joints: list[Joint] = []
    for i, (one, (rest, grows, _)) in enumerate(zip(machine.actuators, measures, strict=True)):
        arm, length = float(arms[i]), rest + grows * float(at_start[1 + i])
        way = 1.0 if turns else math.copysign(1.0, grows * arm)
        if turns:
            place = (-0.05 - length, 0.0, grows * arm)  # its end lies clear of the axis
        else:
            place = (start - way * length, 0.0, EDGE * (i - (len(machine.names) - 1) / 2))
        bars[one.name] = Bar(rest, grows, way, -place[0] if turns else None)
        joints += bars[one.name].joints(one.name, BASE, place, slides[i])
    heading = cast(_Turning, mechanism).heading if turns else 0.0  # of the box in its link
    inertia = float(ca.Function("inertia", [q], [mechanism.terms(q, ca.SX.sym("velocity")).inertia])(start))
    return Shape(
        joints=(_axis(machine.name, turns, own), *joints),
        bars=bars,
        outline=_outline(turns, heading),
        solids=(_box(turns, heading),),
        masses=(_mass(turns, inertia),),
        spacing=0.5,
        function=function,
    )


def _measures(one: ActuatorOf, parameters: Parameters, dl: Expression) -> tuple[float, float, Expression]:
    """Return the length of an actuator that is not contracted, whether it grows (1 or -1), its diameter."""
    section = parameters.at(one.parameters)
    if one.kind == "cylinder":
        return section.volume / section.area, 1.0, ca.SX(2 * math.sqrt(section.area / math.pi))
    return section.length, -1.0, braid_diameter(dl, section)


def _axis(name: str, turns: bool, limits: tuple[float, float]) -> Joint:
    if turns:
        return Joint(name, "revolute", BASE, LOAD, ZERO, (0.0, 1.0, 0.0), limits)
    return Joint(name, "prismatic", BASE, LOAD, ZERO, (1.0, 0.0, 0.0), limits)


def _outline(turns: bool, heading: float) -> tuple[tuple[str, Vector], ...]:
    if turns:
        return (LOAD, ZERO), (LOAD, (LONG * math.cos(heading), 0.0, LONG * math.sin(heading)))
    half = EDGE / 2
    corners = ((-half, -half), (half, -half), (half, half), (-half, half), (-half, -half))
    return tuple((LOAD, (x, 0.0, z)) for x, z in corners)


def _box(turns: bool, heading: float) -> Solid:
    if not turns:
        return Solid(LOAD, "profile", ZERO, (EDGE, EDGE, EDGE))
    centre = (LONG / 2 * math.cos(heading), 0.0, LONG / 2 * math.sin(heading))
    return Solid(LOAD, "profile", centre, (LONG, EDGE, EDGE), (0.0, -heading, 0.0))


def _mass(turns: bool, inertia: float) -> Mass:
    """Return the mass that slides, or one that has the moment of inertia about the axis."""
    mass = inertia / (LONG / 2) ** 2 if turns else inertia
    own = mass * EDGE**2 / 6
    return Mass(LOAD, mass, 0.0, own, inertia if turns else own)
