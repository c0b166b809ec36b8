# SPDX-License-Identifier: Apache-2.0
"""The leg as URDF: thigh, knee, shank, cogwheel, foot and both muscles, with the model's masses.

A muscle is drawn as two halves, one at its fixed end and one at its chain, that slide into each other as it
contracts. The model is plane: its moments of inertia stand for both transverse axes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import casadi as ca
import numpy as np

from pam_orthosis.model import leg as leg_model
from pam_orthosis.model.orthosis import MUSCLES
from pam_orthosis.scene.frames import Joint, LegFrames, Vector

ROBOT = "pam_orthosis"
# URDF wants them and the model has none: nothing limits the joints but their range
EFFORT, VELOCITY = 1e4, 1e3
COLOURS = {
    "profile": (0.72, 0.74, 0.78, 1.0),
    "wheel": (0.35, 0.35, 0.38, 1.0),
    "shoe": (0.25, 0.25, 0.3, 1.0),
    "muscle": (0.12, 0.12, 0.12, 1.0),
}
QUARTER = math.pi / 2
_ALONG_X = (0.0, QUARTER, 0.0)  # a cylinder stands on z
_ALONG_Y = (QUARTER, 0.0, 0.0)


def robot_description(frames: LegFrames) -> str:
    """Return the URDF of a leg."""
    robot = Element("robot", name=ROBOT)
    for name, colour in COLOURS.items():
        SubElement(SubElement(robot, "material", name=name), "color", rgba=_numbers(colour))
    links = {name: SubElement(robot, "link", name=name) for name in frames.links}
    _masses(links, frames)
    _shapes(links, frames)
    for joint in frames.joints:
        _joint(robot, joint)
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def _joint(robot: Element, joint: Joint) -> None:
    element = SubElement(robot, "joint", name=joint.name, type=joint.kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    SubElement(element, "origin", xyz=_numbers(joint.origin), rpy="0 0 0")
    if joint.kind != "fixed":
        SubElement(element, "axis", xyz=_numbers(joint.axis))
        lower, upper = (_numbers([limit]) for limit in joint.limits)
        limits = {"lower": lower, "upper": upper, "effort": f"{EFFORT:g}", "velocity": f"{VELOCITY:g}"}
        SubElement(element, "limit", limits)


def _shapes(links: dict[str, Element], frames: LegFrames) -> None:
    leg, muscle = frames.parameters.leg, frames.parameters.muscle.dmsp_20
    for name, profile, length in (
        ("thigh", leg.thigh, frames.thigh_length),
        ("shank", leg.shank, frames.shank_length),
    ):
        size = (length, profile.width, profile.width)
        _visual(links[name], "profile", (length / 2, 0.0, 0.0), box={"size": _numbers(size)})
    foot, thickness = leg.configuration * leg.shoe_length, leg.shank.width
    size = _numbers((thickness, 2 * thickness, leg.shoe_length))
    _visual(links["foot"], "shoe", (thickness / 2, 0.0, foot / 2), box={"size": size})
    wheel = partial(_cylinder, radius=frames.shape.radius, length=2 * leg.thigh.width / 3)
    _visual(links["cogwheel"], "wheel", (0.0, 0.0, 0.0), _ALONG_Y, cylinder=wheel())
    half = frames.muscle_length / 2
    tube = _cylinder(radius=muscle.geometry.diameter / 2 + muscle.geometry.wall, length=half)
    for name in MUSCLES:
        _visual(links[f"{name}_muscle"], "muscle", (half / 2, 0.0, 0.0), _ALONG_X, cylinder=tube)
        _visual(links[f"{name}_chain"], "muscle", (-half / 2, 0.0, 0.0), _ALONG_X, cylinder=tube)


def _visual(link: Element, colour: str, centre: Vector, turned: Vector = (0, 0, 0), **shape) -> None:
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=_numbers(centre), rpy=_numbers(turned))
    geometry = SubElement(visual, "geometry")
    for kind, sizes in shape.items():
        SubElement(geometry, kind, sizes)
    SubElement(visual, "material", name=colour)


def _cylinder(radius: float, length: float) -> dict[str, str]:
    return {"radius": _numbers([radius]), "length": _numbers([length])}


def _masses(links: dict[str, Element], frames: LegFrames) -> None:
    """Give each body of the model to its link: what lies beyond the knee to the shank."""
    leg = frames.parameters.leg
    q = ca.SX.sym("q")
    bodies = leg_model.bodies(q, leg)
    knee = bodies[1]
    columns = [
        (body.mass, body.inertia, ca.norm_2(body.position), ca.norm_2(body.position - knee.position))
        for body in bodies
    ]
    table = ca.Function("bodies", [q], [ca.vertcat(*(ca.horzcat(*row) for row in columns))])
    # the leg is straight: distances from hip and knee are places along the links
    rows = np.array(table(0.0))
    beyond = rows[:, 2] > frames.thigh_length + 1e-9
    _inertial(links["thigh"], rows[~beyond][:, [0, 1, 2]], leg.thigh.width)
    _inertial(links["shank"], rows[beyond][:, [0, 1, 3]], leg.shank.width)


def _inertial(link: Element, bodies: np.ndarray, width: float) -> None:
    """Write the inertia of bodies (n, 3): mass, moment about the own centre, place along the link."""
    mass, inertia, place = bodies.T
    total = mass.sum()
    centre = mass @ place / total
    transverse = inertia.sum() + mass @ (place - centre) ** 2
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_numbers((centre, 0.0, 0.0)), rpy="0 0 0")
    SubElement(element, "mass", value=_numbers([total]))
    moments = {"ixx": total * width**2 / 6, "iyy": transverse, "izz": transverse}
    products = dict.fromkeys(("ixy", "ixz", "iyz"), 0.0)
    SubElement(element, "inertia", {key: _numbers([v]) for key, v in (moments | products).items()})


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
