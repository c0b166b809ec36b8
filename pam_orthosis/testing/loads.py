# SPDX-License-Identifier: Apache-2.0
"""What the actuators of a hidden plant move: tables over its coordinate, from geometry written once more.

Angles in rad, positions in m. Rows of a load: inertia, its slope, what pulls back (gravity, springs, a
person's passive moment), then the same of 1 kg that an effect adds. Rows of the strokes: contraction of the
first actuator and its slope, the moment arm, then those of the second.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import Parameters, Section

GRAVITY = 9.81
TABLE_START, TABLE_STEP, TABLE_SIZE = -0.3, 5.0e-4, 4401  # of the knee
MARGIN = 0.25  # of the range between the stops, beyond them
Deviations = Mapping[str, float]
Array = np.ndarray


class Load(NamedTuple):
    """A load: tables from `start` on, `step` apart; range, damping, and the unit of its widths and speeds."""

    table: Array  # (6, n)
    strokes: Array  # (4, n), or (4, 0) for a sprocket
    start: float
    step: float
    stops: Section
    damping: float = 0.0
    middle: float = 0.6
    unit: float = 1.0
    wound: tuple[float, float, float] = (0.0, 0.0, 0.0)  # radius of a sprocket, angle and contraction there


def load_of(parameters: Parameters, off: Deviations) -> Load:
    """Return what the machine of the parameters moves; `off` are deviations, 0 if there is none."""
    machine = parameters.declared
    if len(machine.actuators) != 2:
        raise OrthosisError(f"gap-hide knows machines of two actuators, not {len(machine.actuators)}")
    if machine.kind == "knee":
        return _knee(parameters.leg, off)
    ankle = machine.kind == "ankle"
    stops = parameters.leg.ankle.joint if ankle else parameters.at(machine.parameters)
    margin = MARGIN * (stops.maximum - stops.minimum)
    q = np.linspace(stops.minimum - margin, stops.maximum + margin, TABLE_SIZE)
    sections = (
        [parameters.leg.ankle.dorsiflexor, parameters.leg.ankle.plantarflexor]
        if ankle
        else [parameters.at(one.transmission) for one in machine.actuators]
    )
    knee_range = 1.7  # rad, for which rates and widths of the effects were chosen
    return Load(
        _foot(q, parameters.leg, off) if ankle else _one_axis(q, machine.kind, stops, off),
        np.vstack([stroke(q, section) for section in sections]),
        q[0],
        q[1] - q[0],
        stops,
        0.0 if ankle else stops.damping * (1 + off["damping"]),
        0.5 * (stops.minimum + stops.maximum),
        (stops.maximum - stops.minimum) / knee_range if machine.coordinate.unit == "m" else 1.0,
    )


def _knee(leg: Section, off: Deviations) -> Load:
    if leg.person.present:
        raise OrthosisError("the hidden knee has no person: leave leg.person.present false")
    wound = (leg.cogwheel_diameter / 2, leg.symmetric_angle, leg.symmetric_contraction)
    table = leg_table(leg, 1 + off["moving_mass"])
    return Load(table, np.zeros((4, 0)), TABLE_START, TABLE_STEP, leg.joint, wound=wound)


def _one_axis(q: Array, kind: str, p: Section, off: Deviations) -> Array:
    """Return (6, n) of a load that turns about an axis or slides along a line."""
    leaning = np.ones_like(q) if kind == "translation" else np.sin(q - p.hanging)
    table = np.zeros((6, len(q)))
    table[0] = p.inertia * (1 + off["inertia"])
    table[2] = p.weight * leaning + p.stiffness * (q - p.rest)
    table[3] = 1.0 if kind == "translation" else 0.0
    return table


def _foot(q: Array, leg: Section, off: Deviations) -> Array:
    """Return (6, n) of shoe and foot that turn about a fixed ankle below a shank that the knee holds."""
    p, person, k = leg.ankle, leg.person, leg.configuration
    lengths = [leg.thigh.length, leg.shank.length]
    bodies = [(leg.shoe_mass * (1 + off["moving_mass"]), leg.shoe_length, p.shoe)]
    if person.present:
        lengths = [one.length_fraction * person.height for one in (person.thigh, person.shank)]
        mass = person.foot_mass_fraction * person.mass * (1 + off["person_mass"])
        bodies.append((mass, p.foot.length_fraction * person.height, p.foot))
    knee = p.knee_angle
    thigh, shank = lengths
    below = hip_angle(np.array([knee]), thigh, shank, k, leg.bearing_height)[0] - k * knee  # the shank
    table = np.zeros((6, len(q)))
    for mass, size, part in bodies:
        table[0] += mass * size**2 * (part.forward**2 + part.below**2 + part.gyration**2)
        rise = -part.forward * np.sin(below + k * q) + k * part.below * np.cos(below + k * q)
        table[2] += GRAVITY * mass * size * rise
    if person.present:
        share = p.passive_share * (1 + off["passive_moment"])
        table[2] += share * passive_moment(-np.degrees(q), np.degrees(knee))
    return table


def passive_moment(plantar: Array, knee: float) -> Array:
    """Return a person's passive moment towards plantarflexion, N m, of angles in degrees (Riener 1999)."""
    calf, shin = 2.1016 - 0.0843 * plantar - 0.0176 * knee, -7.9763 + 0.1949 * plantar + 0.0008 * knee
    return np.exp(calf) - np.exp(shin) - 1.792


def stroke(q: Array, section: Section) -> Array:
    """Return (2, n): contraction of an actuator and its slope."""
    given = dict(section.items())
    if "lever" in given:
        return _lever(q, section)
    if "coordinates" in given:
        return _table(q, section)
    return np.array([section.contraction + section.arm * q, np.full(len(q), section.arm)])


def _lever(q: Array, p: Section) -> Array:
    """Return contraction and slope from the distance of the rope's ends: one held, one on the lever."""
    turned = np.concatenate([q, [0.0]]) + p.angle
    ends = p.lever * np.array([np.cos(turned), np.sin(turned)])
    rope = ends - [[p.ground], [0.0]]
    distance = np.hypot(*rope)
    turning = p.lever * np.array([-np.sin(turned), np.cos(turned)])
    slope = -(rope * turning).sum(axis=0) / distance
    return np.array([p.contraction + distance[-1] - distance, slope])[:, :-1]


def _table(q: Array, p: Section) -> Array:
    """Return contraction and slope of a table: a natural spline, straight beyond its ends."""
    spline = CubicSpline(p.coordinates, p.contractions, bc_type="natural")
    inside = np.clip(q, p.coordinates[0], p.coordinates[-1])
    slope = spline(inside, 1)
    return np.array([spline(inside) + slope * (q - inside), slope])


def leg_table(leg: Section, mass_factor: float) -> Array:
    """Return (6, n): inertia, its slope, gravity torque of the apparatus, then of 1 kg at the ankle."""
    q = TABLE_START + TABLE_STEP * np.arange(TABLE_SIZE)
    names = {"thigh": leg.thigh.mass, "knee": leg.knee_mass, "shank": leg.shank.mass, "ankle": leg.shoe_mass}
    apparatus = {name: mass_factor * mass for name, mass in names.items()}
    ankle = {**dict.fromkeys(names, 0.0), "ankle": 1.0}
    rows = [_inertia_and_gravity(q, leg, masses) for masses in (apparatus, ankle)]
    return np.array([row for m, g in rows for row in (m, np.gradient(m, TABLE_STEP), g)])


def _inertia_and_gravity(q: Array, leg: Section, mass: dict[str, float]) -> tuple[Array, Array]:
    """Return inertia and gravity torque by q from velocities per unit of knee speed (planar linkage)."""
    thigh, shank, k = leg.thigh.length, leg.shank.length, leg.configuration
    a = hip_angle(q, thigh, shank, k, leg.bearing_height)
    s = a - k * q
    a1 = k * shank * np.cos(s) / (thigh * np.cos(a) + shank * np.cos(s))
    s1 = a1 - k
    knee = np.array([-np.sin(a), np.cos(a)]) * thigh * a1
    along = np.array([-np.sin(s), np.cos(s)]) * shank * s1
    speeds = {"thigh": 0.5 * knee, "knee": knee, "shank": knee + 0.5 * along, "ankle": knee + along}
    inertia = sum(mass[name] * (v**2).sum(axis=0) for name, v in speeds.items())
    inertia = inertia + mass["thigh"] * (thigh**2 + leg.thigh.width**2) / 12 * a1**2
    inertia = inertia + mass["shank"] * (shank**2 + leg.shank.width**2) / 12 * s1**2
    return inertia, GRAVITY * sum(mass[name] * v[1] for name, v in speeds.items())


def hip_angle(q: Array, thigh: float, shank: float, k: int, height: float) -> Array:
    """Return the hip angle that puts the ankle on its bearing, by Newton's method."""
    a = 0.5 * k * q
    for _ in range(30):
        wrong = thigh * np.sin(a) + shank * np.sin(a - k * q) - height
        a = a - wrong / (thigh * np.cos(a) + shank * np.cos(a - k * q))
    return a
