# SPDX-License-Identifier: Apache-2.0
"""A machine as URDF, by its shape."""

from collections.abc import Sequence
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from pam_orthosis.scene.shape import Joint, Mass, Shape, Solid

ROBOT = "pam_orthosis"
COLOURS = {
    "profile": (0.72, 0.74, 0.78, 1.0),
    "wheel": (0.35, 0.35, 0.38, 1.0),
    "shoe": (0.25, 0.25, 0.3, 1.0),
    "muscle": (0.12, 0.12, 0.12, 1.0),
}


def robot_description(shape: Shape) -> str:
    """Return the URDF of a machine."""
    robot = Element("robot", name=ROBOT)
    for name, colour in COLOURS.items():
        SubElement(SubElement(robot, "material", name=name), "color", rgba=_numbers(colour))
    links = {name: SubElement(robot, "link", name=name) for name in shape.links}
    for mass in shape.masses:
        _inertial(links[mass.link], mass)
    for solid in shape.solids:
        _visual(links[solid.link], solid)
    for joint in shape.joints:
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
        # nothing limits the joints but their range; URDF wants more
        limits = {"lower": lower, "upper": upper, "effort": "10000", "velocity": "1000"}
        SubElement(element, "limit", limits)


def _visual(link: Element, solid: Solid) -> None:
    visual = SubElement(link, "visual")
    SubElement(visual, "origin", xyz=_numbers(solid.centre), rpy=_numbers(solid.turned))
    geometry = SubElement(visual, "geometry")
    if len(solid.size) == 3:
        SubElement(geometry, "box", size=_numbers(solid.size))
    else:
        radius, length = solid.size
        SubElement(geometry, "cylinder", radius=_numbers([radius]), length=_numbers([length]))
    SubElement(visual, "material", name=solid.colour)


def _inertial(link: Element, mass: Mass) -> None:
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_numbers((mass.centre, 0.0, 0.0)), rpy="0 0 0")
    SubElement(element, "mass", value=_numbers([mass.mass]))
    moments = {"ixx": mass.along, "iyy": mass.across, "izz": mass.across}
    products = dict.fromkeys(("ixy", "ixz", "iyz"), 0.0)
    SubElement(element, "inertia", {key: _numbers([v]) for key, v in (moments | products).items()})


def _numbers(values: Sequence[float]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
