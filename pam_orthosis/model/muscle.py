# SPDX-License-Identifier: Apache-2.0
"""Fluidic muscle: force and volume, as the paper's polynomials and as the braid's geometry.

Contraction is the shortening from the nominal length, positive, m. Forces are tensile, N.
The parameters `m` are a section of `config/muscle.yaml` (e.g. `muscle.dmsp_20`). Coefficients are
those of a specimen of length `m.map_length`; other nominal lengths scale by relative contraction.
"""

from __future__ import annotations

import math

import casadi as ca


def polynomial(coefficients, x):
    """Return sum c_i x^i, by Horner's rule."""
    result = 0.0
    for c in reversed(list(coefficients)):
        result = result * x + c
    return result


def specimen_contraction(contraction, m):
    """Return the contraction of the measured specimen at the same relative contraction.

    It is clamped to the box in which the polynomials were identified (no silent extrapolation: see
    `outside_box`).
    """
    x = contraction * (m.map_length / m.length)
    return ca.fmin(ca.fmax(x, m.box.minimum_contraction), m.box.maximum_contraction)


def boxed_pressure(pressure_gauge, m):
    """Return the gauge pressure clamped to the identified box, Pa."""
    return ca.fmin(ca.fmax(pressure_gauge, m.box.minimum_pressure_gauge), m.box.maximum_pressure_gauge)


def outside_box(contraction, pressure_gauge, m):
    """Return 1 where contraction or pressure leaves the identified box, else 0."""
    x = contraction * (m.map_length / m.length)
    return ca.logic_or(
        ca.logic_or(x < m.box.minimum_contraction, x > m.box.maximum_contraction),
        ca.logic_or(
            pressure_gauge < m.box.minimum_pressure_gauge,
            pressure_gauge > m.box.maximum_pressure_gauge,
        ),
    )


def area(contraction, m):
    """Return the area function F-bar(dL) of Eq. (14), m^2."""
    return polynomial(m.force.a, specimen_contraction(contraction, m))


def counterforce(contraction, m):
    """Return the counterforce f(dL) of the braid in Eq. (14), N."""
    return polynomial(m.force.b, specimen_contraction(contraction, m))


def towing_force(contraction, pressure_gauge, m):
    """Return F_tow of Eq. (14), N; negative where the muscle would hang slack.

    The pressure is the gauge pressure: at ambient pressure a muscle does not pull.
    """
    return area(contraction, m) * boxed_pressure(pressure_gauge, m) - counterforce(contraction, m)


def damping_force(contraction_rate, m):
    """Return F_damp of Eq. (13), N, opposed to the shortening."""
    return m.force.damping * contraction_rate


def tension(elastic_force, contraction_rate, m):
    """Return the force of Eq. (13), N; a slack muscle (no elastic force) pulls nothing."""
    taut = elastic_force > 0
    return ca.if_else(taut, ca.fmax(elastic_force - damping_force(contraction_rate, m), 0), 0)


def force(contraction, contraction_rate, pressure_gauge, m):
    """Return the tensile force of Eqs. (13)-(14), N, at least zero."""
    return tension(towing_force(contraction, pressure_gauge, m), contraction_rate, m)


def volume(contraction, pressure_gauge, m):
    """Return the muscle volume of Eqs. (16)-(17), m^3 (two or three coefficients v: DMSP-10 or -20)."""
    x = specimen_contraction(contraction, m)
    p = boxed_pressure(pressure_gauge, m)
    scale = m.length / m.map_length
    return scale * polynomial(m.volume.v, x) * polynomial(m.volume.w, p)


def braid_diameter(contraction, m):
    """Return the diameter of the braided cylinder, m, for inextensible fibres.

    Source: Martens & Boblan, Actuators 2017, 6(4):33 (geometry).
    """
    fibre, turns = _braid(m)
    length = m.length - contraction
    return ca.sqrt(fibre**2 - length**2) / (ca.pi * turns)


def geometric_force(contraction, pressure_gauge, m):
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


def geometric_volume(contraction, pressure_gauge, m):
    """Return the volume of Eq. (15), a cylinder with a frustum at each end, m^3.

    The frustum's height grows linearly with the shortening; the braid gives the cylinder's diameter.
    """
    return composed_volume(*cylinder(contraction, pressure_gauge, m), m.geometry.diameter)


def composed_volume(diameter, length, frustum, end):
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


def cylinder(contraction, pressure_gauge, m):
    """Return diameter, length of the cylindrical part and height of a frustum, m (section 2.3)."""
    swelling = ca.sqrt(1 + m.geometry.volume_compliance * pressure_gauge)
    diameter = braid_diameter(contraction, m) * swelling
    frustum = m.geometry.frustum_slope * contraction
    return diameter, m.length - contraction - 2 * frustum, frustum


def _braid(m):
    """Return the length of a fibre, m, and its number of turns."""
    angle = m.geometry.fibre_angle + m.geometry.fibre_angle_correction
    fibre = m.length / ca.cos(angle)
    return fibre, m.length * ca.tan(angle) / (ca.pi * m.geometry.diameter)
