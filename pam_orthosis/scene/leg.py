# SPDX-License-Identifier: Apache-2.0
"""What the orthosis' leg looks like: thigh, knee, shank, sprocket, foot and both muscles.

Side view as in `model.mechanisms.leg`: hip in the origin, x along the ankle's bearing, z up. Each link's x
runs along its segment, away from the hip. Both muscles lie along the thigh, the extensor on its front, at the
distance of the sprocket's radius; their upper ends are fixed, their lower ends pull the chain. With muscles
of 0.5 m the upper ends lie beyond the hip. The model is plane: its moments of inertia stand for both
transverse axes.
"""

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from pam_orthosis.model.components.muscle import braid_diameter
from pam_orthosis.model.mechanisms import leg as leg_model
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Section
from pam_orthosis.scene.shape import ZERO, Bar, Joint, Mass, Shape, Solid, ranges

# side of the thigh of extensor and flexor: the former on the front, which is up for a knee that points up
SIDES = (1.0, -1.0)


def leg(parameters: Parameters) -> Shape:
    """Return the shape of a leg; of the parameters it needs `leg` and `muscle`."""
    p = parameters.leg
    muscles = {one.name: parameters.at(one.parameters) for one in parameters.declared.actuators}
    q = ca.SX.sym("q")
    contractions = leg_model.contractions(q, p)
    diameters = [braid_diameter(one, m) for one, m in zip(contractions, muscles.values(), strict=True)]
    joints = [leg_model.hip_angle(q, p), q, *contractions]
    function = ca.Function("leg_shape", [q], [*joints, *diameters])
    hip, knee, *slides = ranges(function, p.joint.minimum, p.joint.maximum)
    thigh, shank = leg_model.segment_lengths(p)
    radius = p.cogwheel_diameter / 2
    bars = {name: Bar(m.length, -1.0, 1.0, p.muscle_clearance + m.length) for name, m in muscles.items()}
    upper = [
        (thigh - bar.reach, 0.0, side * p.configuration * radius)
        for bar, side in zip(bars.values(), SIDES, strict=True)
    ]
    own = zip(bars.items(), upper, slides, strict=False)
    return Shape(
        joints=(
            Joint("hip", "revolute", "hip", "thigh", ZERO, (0.0, -1.0, 0.0), hip),
            Joint("knee_housing", "fixed", "thigh", "knee", (thigh, 0.0, 0.0)),
            Joint("knee", "revolute", "knee", "shank", ZERO, (0.0, float(p.configuration), 0.0), knee),
            Joint("arbor", "fixed", "shank", "cogwheel"),
            Joint("ankle", "fixed", "shank", "foot", (shank, 0.0, 0.0)),
            *(j for (name, bar), place, limits in own for j in bar.joints(name, "thigh", place, limits)),
        ),
        bars=bars,
        outline=(
            ("thigh", ZERO), ("shank", ZERO), ("foot", ZERO),
            ("foot", (0.0, 0.0, p.configuration * p.shoe_length)),
        ),
        solids=_solids(p, muscles, radius),
        masses=_masses(p, thigh),
        spacing=p.hip_distance,
        function=function,
        wheel=(1, radius),
        rail=(2, "ankle on its bearing"),
    )  # fmt: skip


def _solids(p: Section, muscles: Mapping[str, Section], radius: float) -> tuple[Solid, ...]:
    lengths, thickness = leg_model.segment_lengths(p), p.shank.width
    profiles = zip(("thigh", "shank"), (p.thigh.width, p.shank.width), lengths, strict=True)
    bones = [
        Solid(name, "profile", (long / 2, 0.0, 0.0), (long, wide, wide)) for name, wide, long in profiles
    ]
    foot = (thickness / 2, 0.0, p.configuration * p.shoe_length / 2)
    shoe = Solid("foot", "shoe", foot, (thickness, 2 * thickness, p.shoe_length))
    wheel = Solid("cogwheel", "wheel", ZERO, (radius, 2 * p.thigh.width / 3), (math.pi / 2, 0.0, 0.0))
    return (*bones, shoe, wheel, *(half for one in muscles.items() for half in _halves(*one)))


def _halves(name: str, m: Section) -> tuple[Solid, Solid]:
    """Return a muscle's halves, which slide into each other as it contracts."""
    half = m.length / 2
    size = (m.geometry.diameter / 2 + m.geometry.wall, half)
    along_x = (0.0, math.pi / 2, 0.0)  # a cylinder stands on z
    return (
        Solid(f"{name}_muscle", "muscle", (half / 2, 0.0, 0.0), size, along_x),
        Solid(f"{name}_chain", "muscle", (-half / 2, 0.0, 0.0), size, along_x),
    )


def _masses(p: Section, thigh: float) -> tuple[Mass, Mass]:
    """Give each body of the model to its link: what lies beyond the knee to the shank."""
    q = ca.SX.sym("q")
    bodies = leg_model.bodies(q, p)
    knee = bodies[1]
    columns = [
        (body.mass, body.inertia, ca.norm_2(body.position), ca.norm_2(body.position - knee.position))
        for body in bodies
    ]
    table = ca.Function("bodies", [q], [ca.vertcat(*(ca.horzcat(*row) for row in columns))])
    # the leg is straight: distances from hip and knee are places along the links
    rows = np.array(table(0.0))
    beyond = rows[:, 2] > thigh + 1e-9
    return (
        _mass("thigh", rows[~beyond][:, [0, 1, 2]], p.thigh.width),
        _mass("shank", rows[beyond][:, [0, 1, 3]], p.shank.width),
    )


def _mass(link: str, bodies: np.ndarray, width: float) -> Mass:
    """Return the inertia of bodies (n, 3): mass, moment about the own centre, place along the link."""
    mass, inertia, place = bodies.T
    total = mass.sum()
    centre = mass @ place / total
    return Mass(link, total, centre, total * width**2 / 6, inertia.sum() + mass @ (place - centre) ** 2)
