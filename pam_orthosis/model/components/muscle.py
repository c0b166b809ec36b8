# SPDX-License-Identifier: Apache-2.0
"""Fluidic muscle: force and volume, as the paper's polynomials and as the braid's geometry.

Contraction is the shortening from the nominal length, positive, m. Forces are tensile, N.
The parameters `m` are a section of `config/muscle.yaml` (e.g. `muscle.dmsp_20`). Coefficients are
those of a specimen of length `m.map_length`; other nominal lengths scale by relative contraction.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import casadi as ca

from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression

MUSCLE = re.compile(r"muscle\.\w+\.map_length")


def broken_rules(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence where parameters of a muscle contradict each other."""
    for name in (key.removesuffix(".map_length") for key in values if MUSCLE.fullmatch(key)):
        low, high = (f"{name}.box.{end}_contraction" for end in ("minimum", "maximum"))
        if not values[low] < values[high]:
            yield f"{low} = {values[low]} must be below {high} = {values[high]}"
        yield from _braid_rule(values, name)


def _braid_rule(values: Mapping[str, Any], muscle: str) -> Iterator[str]:
    """Compare what the coefficients give at no contraction with the ideal braid and its cylinder."""
    diameter, angle = (values[f"{muscle}.geometry.{name}"] for name in ("diameter", "fibre_angle"))
    area = braid_area(diameter, angle)
    volume = math.pi / 4 * diameter**2 * values[f"{muscle}.map_length"]
    braid_share = (0.3, 5.0)  # what identified coefficients and the braid's geometry differ by at most
    for name, ideal, unit in (("force.a", area, "m^2"), ("volume.v", volume, "m^3")):
        first = values[f"{muscle}.{name}"][0]
        if not braid_share[0] * ideal < first < braid_share[1] * ideal:
            yield (
                f"{muscle}.{name} gives {first:g} {unit} at no contraction, the geometry in"
                f" {muscle}.geometry {ideal:.3g} {unit}; has a decimal point slipped?"
            )


def braid_area(diameter: float, angle: float, shortened: float = 0.0) -> float:
    """Return the force of an ideal braid by its gauge pressure, m^2, shortened by a share of its length."""
    cosine = (1 - shortened) * math.cos(angle)
    return math.pi / 4 * diameter**2 * (3 * cosine**2 - 1) / math.sin(angle) ** 2


def actuator(m: Section) -> Actuator:
    """Return the muscle of the controllers' nominal model: Eqs. (13)-(14) and (16)-(17)."""
    return Actuator(
        lambda dl, p: towing_force(dl, p, m),
        lambda dl, p: volume(dl, p, m),
        m.force.damping,
        m.length,
        affine=lambda dl: (area(dl, m), counterforce(dl, m)),
        outside=lambda dl, p: outside_box(dl, p, m),
    )


def braid(m: Section, scale: Expression = 1.0, shortened: Expression = 0.0) -> Actuator:
    """Return the muscle of the braid's geometry; `scale` is the specimen's force / nominal force.

    `shortened` is by how much more than nominal it is contracted as it is mounted, m.
    """
    return Actuator(
        lambda dl, p: scale * geometric_force(dl + shortened, p, m),
        lambda dl, p: geometric_volume(dl + shortened, p, m),
        m.force.damping,
        m.length,
    )


def polynomial(coefficients: Iterable[Expression], x: Expression) -> Expression:
    """Return sum c_i x^i, by Horner's rule."""
    result = 0.0
    for c in reversed(list(coefficients)):
        result = result * x + c
    return result


def specimen_contraction(contraction: Expression, m: Section) -> Expression:
    """Return the contraction of the measured specimen at the same relative contraction.

    It is clamped to the box in which the polynomials were identified (no silent extrapolation: see
    `outside_box`).
    """
    x = contraction * (m.map_length / m.length)
    return ca.fmin(ca.fmax(x, m.box.minimum_contraction), m.box.maximum_contraction)


def boxed_pressure(pressure_gauge: Expression, m: Section) -> Expression:
    """Return the gauge pressure clamped to the identified box, Pa."""
    return ca.fmin(ca.fmax(pressure_gauge, m.box.minimum_pressure_gauge), m.box.maximum_pressure_gauge)


def outside_box(contraction: Expression, pressure_gauge: Expression, m: Section) -> Expression:
    """Return 1 where contraction or pressure leaves the identified box, else 0."""
    x = contraction * (m.map_length / m.length)
    return ca.logic_or(
        ca.logic_or(x < m.box.minimum_contraction, x > m.box.maximum_contraction),
        ca.logic_or(
            pressure_gauge < m.box.minimum_pressure_gauge,
            pressure_gauge > m.box.maximum_pressure_gauge,
        ),
    )


def area(contraction: Expression, m: Section) -> Expression:
    """Return the area function F-bar(dL) of Eq. (14), m^2."""
    return polynomial(m.force.a, specimen_contraction(contraction, m))


def counterforce(contraction: Expression, m: Section) -> Expression:
    """Return the counterforce f(dL) of the braid in Eq. (14), N."""
    return polynomial(m.force.b, specimen_contraction(contraction, m))


def towing_force(contraction: Expression, pressure_gauge: Expression, m: Section) -> Expression:
    """Return F_tow of Eq. (14), N; negative where the muscle would hang slack.

    Eq. (14) prints p_M for any pressure: it is the gauge pressure, since at ambient pressure no muscle pulls.
    """
    return area(contraction, m) * boxed_pressure(pressure_gauge, m) - counterforce(contraction, m)


def volume(contraction: Expression, pressure_gauge: Expression, m: Section) -> Expression:
    """Return the muscle volume of Eqs. (16)-(17), m^3 (two or three coefficients v: DMSP-10 or -20)."""
    x = specimen_contraction(contraction, m)
    p = boxed_pressure(pressure_gauge, m)
    scale = m.length / m.map_length
    return scale * polynomial(m.volume.v, x) * polynomial(m.volume.w, p)


def braid_diameter(contraction: Expression, m: Section) -> Expression:
    """Return the diameter of the braided cylinder, m, for inextensible fibres.

    Source: Martens & Boblan, Actuators 2017, 6(4):33 (geometry).
    """
    fibre, turns = _braid(m)
    length = m.length - contraction
    return ca.sqrt(fibre**2 - length**2) / (ca.pi * turns)


def geometric_force(contraction: Expression, pressure_gauge: Expression, m: Section) -> Expression:
    """Return the static force of the geometric law with rubber elasticity, N; negative where slack.

    Source: Martens & Boblan, Actuators 2017, 6(4):33, erratum 2018, 7(1):9. The elastic modulus
    polynomial was measured on a specimen of length `m.geometry.map_length` and is taken at the
    specimen's length with the same relative contraction.
    """
    fibre, turns = _braid(m)
    length = m.length - contraction
    diameter = braid_diameter(contraction, m)
    modulus = polynomial(m.geometry.modulus, length * (m.geometry.map_length / m.length))
    axial = modulus * (length - m.length) / m.length
    hoop = modulus * (diameter - m.geometry.diameter) / m.geometry.diameter
    volume_slope = (fibre**2 - 3 * length**2) / (4 * ca.pi * turns**2)
    diameter_slope = -length / (turns * ca.pi * ca.sqrt(fibre**2 - length**2))
    wall = m.geometry.wall
    return (
        -pressure_gauge * volume_slope
        + hoop * wall * length * ca.pi * diameter_slope
        - axial * wall * ca.pi * diameter
    )


def geometric_volume(contraction: Expression, pressure_gauge: Expression, m: Section) -> Expression:
    """Return the volume of Eq. (15), a cylinder with a frustum at each end, m^3.

    The frustum's height grows linearly with the shortening; the braid gives the cylinder's diameter.
    """
    return composed_volume(*cylinder(contraction, pressure_gauge, m), m.geometry.diameter)


def composed_volume(
    diameter: Expression, length: Expression, frustum: Expression, end: Expression
) -> Expression:
    """Return V_cyl + 2 V_F of Eq. (15), m^3.

    Args:
        diameter: of the cylinder and of the frustums' wide ends, m.
        length: of the cylinder, m.
        frustum: height of a frustum, m.
        end: diameter of the frustums' narrow ends (the fittings), m.
    """
    cylinder_volume = math.pi / 4 * diameter**2 * length
    frustum_volume = math.pi / 12 * frustum * (diameter**2 + diameter * end + end**2)
    return cylinder_volume + 2 * frustum_volume


def cylinder(
    contraction: Expression, pressure_gauge: Expression, m: Section
) -> tuple[Expression, Expression, Expression]:
    """Return diameter, length of the cylindrical part and height of a frustum, m (section 2.3)."""
    swelling = ca.sqrt(1 + m.geometry.volume_compliance * pressure_gauge)
    diameter = braid_diameter(contraction, m) * swelling
    frustum = m.geometry.frustum_slope * contraction
    return diameter, m.length - contraction - 2 * frustum, frustum


def _braid(m: Section) -> tuple[Expression, Expression]:
    """Return the length of a fibre, m, and its number of turns."""
    angle = m.geometry.fibre_angle + m.geometry.fibre_angle_correction
    fibre = m.length / ca.cos(angle)
    return fibre, m.length * ca.tan(angle) / (ca.pi * m.geometry.diameter)
