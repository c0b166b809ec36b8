# SPDX-License-Identifier: Apache-2.0
"""Mechanics of the leg in the orthosis: Lagrange's equations, Eqs. (24)-(26).

Side view, hip in the origin, x along the ankle's linear bearing, z up. The knee angle q is zero
for the straight leg and positive in flexion; the hip angle a is that of the thigh above x.
Torques act in the direction of +q (flexion). The paper's Eq. (27) counts torque positive in
extension; `knee_torque` carries the change of sign.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import casadi as ca

from pam_orthosis.model.mechanisms.base import GRAVITY, ROTATION, Coordinate, Mechanics, Mechanism
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression

# how the keys of `config/` begin that only machines of the leg have
ROWS = ("leg.", "plant.sensor.angle", "plant.deviation.moving_mass", "plant.deviation.person_mass")
# rules between parameters: what rises from key to key, and what is of one size in any leg
ORDERED = (("leg.joint.minimum", "leg.joint.maximum"),)
ALIKE = tuple((f"leg.thigh.{name}", f"leg.shank.{name}") for name in ("length", "mass", "width"))


@dataclass(frozen=True)
class Body:
    """A rigid body of the side view.

    Mass kg, moment of inertia about its centre kg m^2, position of the centre (x, z) m and orientation
    rad, the last two as functions of q.
    """

    mass: Expression
    inertia: Expression
    position: Expression
    orientation: Expression


@dataclass(frozen=True)
class LegJoint(Mechanism):
    """A joint of the leg, whose section is its own.

    `mechanics` is (angle, velocity, leg, mass that an effect adds) -> terms of Eq. (26).
    """

    coordinate: ClassVar[Coordinate] = ROTATION
    inputs: ClassVar[tuple[str, ...]] = ("external_torque",)
    live: ClassVar[tuple[str, ...]] = ("leg.person.mass",)
    mechanics: Callable[..., Mechanics]

    @property
    def locked(self) -> bool:
        """Whether the joint is locked."""
        return bool(self.ends.locked)

    @property
    def idle(self) -> Mapping[str, str]:
        """The mass of a person who is not there."""
        nobody = "no person is in the orthosis (leg.person.present)"
        return {} if self.parameters.person.present else {"leg.person.mass": nobody}

    def terms(self, q: Expression, velocity: Expression, extra_mass: Expression = 0.0) -> Mechanics:
        """Return the terms of Eq. (26), with a mass that an effect adds, kg."""
        return self.mechanics(q, velocity, self.parameters, extra_mass)


def segment_lengths(leg: Section) -> tuple[Expression, Expression]:
    """Return the lengths of thigh and shank, m; with a person, adjusted to the body height."""
    person = leg.person
    if not person.present:
        return leg.thigh.length, leg.shank.length
    return person.thigh.length_fraction * person.height, person.shank.length_fraction * person.height


def broken_rules(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence where Eq. (24) has no solution somewhere that the joint may go."""
    if "leg.configuration" not in values:
        return
    if abs(values["leg.configuration"]) != 1:
        yield f"leg.configuration = {values['leg.configuration']} must be 1 (knee up) or -1 (knee down)"
    thigh, shank = (values[f"leg.{name}.length"] for name in ("thigh", "shank"))
    if values["leg.person.present"]:
        height = values["leg.person.height"]
        thigh, shank = (values[f"leg.person.{n}.length_fraction"] * height for n in ("thigh", "shank"))
    angles = (values["leg.joint.minimum"], values["leg.joint.maximum"])
    reach = min(math.hypot(thigh + shank * math.cos(q), shank * math.sin(q)) for q in angles)
    if abs(values["leg.bearing_height"]) >= reach:
        yield (
            f"leg.bearing_height = {values['leg.bearing_height']} m is out of reach of a leg bent as far as"
            f" leg.joint allows: from hip to ankle there are {reach:.3g} m then"
        )


def hip_angle(q: Expression, leg: Section) -> Expression:
    """Return the hip angle of Eq. (24), a = a(q, k1), rad.

    The ankle stays on its bearing, at the height h over the hip:
    l_th sin a + l_sh sin(a - k1 q) = h. The configuration factor k1 = 1 or -1 says whether the
    flexed knee points up or down.
    """
    thigh_length, shank_length = segment_lengths(leg)
    along = thigh_length + shank_length * ca.cos(q)
    across = leg.configuration * shank_length * ca.sin(q)
    reach = ca.sqrt(along**2 + across**2)
    return ca.atan2(across, along) + ca.asin(leg.bearing_height / reach)


def lumped_foot(_shank: Expression, ankle: Expression, leg: Section) -> list[Body]:
    """Return shoe and, with a person, foot as the paper has them: lumped masses at the ankle."""
    parts, person = [Body(leg.shoe_mass, 0.0, ankle, 0.0)], leg.person
    if person.present:
        parts.append(Body(person.foot_mass_fraction * person.mass, 0.0, ankle, 0.0))
    return parts


def bodies(q: Expression, leg: Section, foot: Callable[..., list[Body]] = lumped_foot) -> list[Body]:
    """Return the bodies of apparatus and person (section 3): thighs, knee, shanks, shoe and foot.

    The person's parts have De Leva's (1996) fractions of the body mass; without a person they are
    left out. `foot` is (angle of the shank, position of the ankle, leg) -> shoe and foot.
    """
    hip = hip_angle(q, leg)
    shank_angle = hip - leg.configuration * q
    thigh, shank = direction(hip), direction(shank_angle)
    thigh_length, shank_length = segment_lengths(leg)
    knee = thigh_length * thigh
    ankle = knee + shank_length * shank
    shoe, *feet = foot(shank_angle, ankle, leg)
    parts = [
        _bar(leg.thigh, thigh_length, 0.5 * thigh_length * thigh, hip),
        Body(leg.knee_mass, 0.0, knee, 0.0),
        _bar(leg.shank, shank_length, knee + 0.5 * shank_length * shank, shank_angle),
        shoe,
    ]
    person = leg.person
    if person.present:
        parts += [
            _segment(person.thigh, person, thigh_length, 0 * knee, thigh, hip),
            _segment(person.shank, person, shank_length, knee, shank, shank_angle),
        ]
    return parts + feet


def mechanics(
    q: Expression, velocity: Expression, leg: Section, extra_foot_mass: Expression = 0.0
) -> Mechanics:
    """Return m(q), k(q, q-dot) and G(q) of Eq. (26) from L = T - U by Eq. (25).

    `extra_foot_mass` (kg) is a lumped mass at the ankle that an effect may add.
    """
    parts = bodies(q, leg)
    parts.append(Body(extra_foot_mass, 0.0, parts[3].position, 0.0))
    return lagrange(q, velocity, parts)


def lagrange(q: Expression, velocity: Expression, parts: Sequence[Body]) -> Mechanics:
    """Return the terms of Eq. (26) of bodies that move with n coordinates, from L = T - U by Eq. (25).

    Eq. (25) prints a partial derivative by time where the total one is meant.
    Inertia (n, n), the others (n,); q and velocity are symbols.
    """
    kinetic, potential = energies(q, velocity, parts)
    momenta = ca.vertsplit(ca.gradient(kinetic, velocity))
    inertia = ca.horzcat(*(ca.gradient(one, velocity) for one in momenta))
    # d/dt (dL/dq-dot) - dL/dq = m q-ddot + [d(dT/dq-dot)/dq q-dot - dT/dq] + dU/dq
    carried = ca.vertcat(*(ca.dot(ca.gradient(one, q), velocity) for one in momenta))
    coriolis = carried - ca.gradient(kinetic, q)
    return Mechanics(inertia, coriolis, ca.gradient(potential, q))


def energies(q: Expression, velocity: Expression, parts: Sequence[Body]) -> tuple[Expression, Expression]:
    """Return kinetic and potential energy T and U of the bodies, J."""
    kinetic, potential = 0.0, 0.0
    for body in parts:
        speed = ca.jtimes(body.position, q, velocity)
        kinetic += 0.5 * body.mass * ca.dot(speed, speed)
        if not isinstance(body.orientation, float):
            spin = ca.jtimes(body.orientation, q, velocity)
            kinetic += 0.5 * body.inertia * spin**2
        potential += body.mass * GRAVITY * body.position[1]
    return kinetic, potential


def knee_torque(extensor_force: Expression, flexor_force: Expression, leg: Section) -> Expression:
    """Return the torque of Eq. (27) in the direction of flexion, N m.

    Eq. (27) prints M_k = d_cw / 2 (F_e - F_f), positive in extension: here q and torque are positive in
    flexion, hence the flexor's force comes first.
    """
    return leg.cogwheel_diameter / 2 * (flexor_force - extensor_force)


def contractions(q: Expression, leg: Section) -> tuple[Expression, Expression]:
    """Return the contractions of extensor and flexor, m: the chain winds on the sprocket."""
    wound = leg.cogwheel_diameter / 2 * (q - leg.symmetric_angle)
    return leg.symmetric_contraction - wound, leg.symmetric_contraction + wound


def direction(angle: Expression) -> Expression:
    """Return the unit vector (x, z) at an angle above x."""
    return ca.vertcat(ca.cos(angle), ca.sin(angle))


def _bar(bar: Section, length: Expression, position: Expression, orientation: Expression) -> Body:
    """Return an aluminium profile of square section: J = m (l^2 + b^2) / 12."""
    return Body(bar.mass, bar.mass * (length**2 + bar.width**2) / 12, position, orientation)


def segment_inertia(segment: Section, person: Section, length: Expression) -> tuple[Expression, Expression]:
    """Return where a person's segment has its centre / its length, and its moment of inertia there, kg m^2.

    By De Leva's radius of gyration or, as the paper has it, of a frustum (thigh) and a cylinder (shank).
    """
    mass = segment.mass_fraction * person.mass
    if person.inertia == "gyration":
        return segment.centre_fraction, mass * (segment.gyration_fraction * length) ** 2
    return segment.solid_centre, frustum_inertia(mass, length, segment.solid_centre, segment.density)


def frustum_radii(
    mass: Expression, length: Expression, centre: Expression, density: Expression
) -> tuple[Expression, Expression]:
    """Return the radii of a homogeneous frustum, proximal and distal, m; a cylinder's centre is at 0.5.

    With the ratio k of the radii its centre is (1 + 2k + 3k^2) / (4 (1 + k + k^2)) of its length away from
    the proximal end, its volume pi/3 R^2 l (1 + k + k^2).
    """
    a, b, c = 3 - 4 * centre, 2 - 4 * centre, 1 - 4 * centre
    ratio = (ca.sqrt(b**2 - 4 * a * c) - b) / (2 * a)
    proximal = ca.sqrt(3 * mass / (math.pi * density * length * (1 + ratio + ratio**2)))
    return proximal, ratio * proximal


def frustum_inertia(
    mass: Expression, length: Expression, centre: Expression, density: Expression
) -> Expression:
    """Return the transverse moment of inertia of a homogeneous frustum about its centre, kg m^2.

    By integration of r^4 / 4 + r^2 z^2 along it.
    """
    proximal, distal = frustum_radii(mass, length, centre, density)
    k, across = distal / proximal, 3 * mass / (1 + distal / proximal + (distal / proximal) ** 2)
    thick = proximal**2 * (1 + k + k**2 + k**3 + k**4) / 20
    long = length**2 * (1 + 3 * k + 6 * k**2) / 30
    return across * (thick + long) - mass * (centre * length) ** 2


def _segment(
    segment: Section,
    person: Section,
    length: Expression,
    proximal: Expression,
    direction: Expression,
    orientation: Expression,
) -> Body:
    centre, inertia = segment_inertia(segment, person, length)
    place = proximal + centre * length * direction
    return Body(segment.mass_fraction * person.mass, inertia, place, orientation)
