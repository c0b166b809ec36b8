# SPDX-License-Identifier: Apache-2.0
"""The paper's figures that show no run: 1, 2 and 6 by the machines' geometry, 3 and 7 of `blocks`."""

import math
from collections.abc import Mapping
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Polygon, Rectangle

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components import muscle
from pam_orthosis.model.device import FOLDER, device_named, of_joint
from pam_orthosis.model.machines import RIG
from pam_orthosis.model.mechanisms import leg
from pam_orthosis.model.mechanisms.carriage import positioner_contraction
from pam_orthosis.model.mechanisms.one_axis import lever_contraction
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.rows import Section
from pam_orthosis.model.shapes import scenario_shape
from pam_orthosis.reading import config_folder
from pam_orthosis.report.paper import blocks
from pam_orthosis.report.paper.blocks import ARROW, Point, muscle_name
from pam_orthosis.report.run_data import BAR
from pam_orthosis.scene.shapes import shape_of

FRAME, MUSCLE, ROPE, PERSON = "0.35", "tab:red", "tab:brown", "tab:blue"
PHASE = 0.72  # of the gait in the pictures: the knee swings
CARRIAGE = 0.12  # m, edge of the carriage in the picture
# of the bodies of `leg.bodies`, in order: apparatus (a), person (p)
BODIES = ("th,a", "k,a", "sh,a", "f,a", "th,p", "sh,p", "f,p")
SCHEMES = {
    "device": "Fig. 1: the device, both legs half a cycle apart",
    "rig": "Fig. 2: test rig",
    "rig_control": "Fig. 3: control of the test rig",
    "mechanics": "Fig. 6: bodies and angles of the mechanical model",
    "knee_control": "Fig. 7: observer-based control of the knee",
}
WITH_PERSON = {"leg.person.present": True}  # fig. 6 shows the person's bodies too


class Pose(NamedTuple):
    """A leg in side view: hip, knee and ankle, m, and where thigh, shank and toes point, rad above x."""

    hip: np.ndarray
    knee: np.ndarray
    ankle: np.ndarray
    thigh: float
    shank: float
    toes: float


def pose_of(knee: float, ankle: float, p: Section) -> Pose:
    """Return the pose of a leg at its angles, rad, by Eq. (24); `p` is the section `leg`."""
    thigh = float(leg.hip_angle(knee, p))
    shank = thigh - p.configuration * knee
    toes = shank + p.configuration * (math.pi / 2 + ankle)
    upper, lower = leg.segment_lengths(p)
    at_knee = upper * _towards(thigh)
    return Pose(np.zeros(2), at_knee, at_knee + lower * _towards(shank), thigh, shank, toes)


def device(overrides: Mapping[str, Any] | None = None) -> Figure:
    """Draw fig. 1: both legs half a cycle apart, with their muscles, ropes and shoes."""
    joints = _joints(overrides or {})
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.subplots()
    for phase, opacity in ((PHASE + 0.5, 0.3), (PHASE, 1.0)):
        _draw_leg(axes, joints, phase, opacity)
    p = joints["knee"]
    names = {name: muscle_name(one.declared.actuators[0].parameters) for name, one in joints.items()}
    count = joints["ankle"].declared.actuators[0].parallel
    axes.set(aspect="equal", xlabel="x / m", ylabel="z / m")
    axes.set_title(
        f"knee: two {names['knee']} of {p.muscle.dmsp_20.length:g} m on a sprocket of"
        f" {p.leg.cogwheel_diameter:g} m; ankle: two times {count} {names['ankle']} on levers;"
        f" a shoe of {p.leg.shoe_length:g} m with two cushions", fontsize=9,
    )  # fmt: skip
    return figure


def rig(p: Parameters) -> Figure:
    """Draw fig. 2: the carriage between the investigated muscle and the one that positions it, in balance."""
    settings, (specimen, positioner) = p.rig, (p.at(one.parameters) for one in RIG.actuators)
    x = 0.3 * settings.position_offset
    contracted = float(positioner_contraction(x, settings))
    gauge = 4.0e5 - p.valve.ambient_pressure
    force = float(muscle.towing_force(x, gauge, specimen))
    beside = force + float(muscle.counterforce(contracted, positioner))
    held = beside / float(muscle.area(contracted, positioner))
    left, right = specimen.length - x, specimen.length - x + CARRIAGE
    wall = right + positioner.length - contracted
    figure = Figure(figsize=(11, 3.2), layout="constrained")
    axes = figure.subplots()
    for (start, end), one, at, shown, branch in zip(
        ((0.0, left), (right, wall)), (specimen, positioner), (x, contracted), (gauge, held),
        (one.parameters for one in RIG.actuators), strict=True,
    ):  # fmt: skip
        thick = float(muscle.braid_diameter(at, one))
        axes.add_patch(Rectangle((start, -thick / 2), end - start, thick, fc=MUSCLE, ec="k", alpha=0.7))
        words = f"{muscle_name(branch)}, {one.length:g} m\n$\\Delta L$ = {1e3 * at:.1f} mm"
        axes.text((start + end) / 2, 0.05, f"{words} at {shown / BAR:.2f} bar gauge", ha="center", fontsize=9)
    axes.add_patch(Rectangle((left, -CARRIAGE / 2), CARRIAGE, CARRIAGE, fc="0.85", ec="k"))
    axes.text(left + CARRIAGE / 2, 0, f"$m_S$\n{settings.carriage_mass:g} kg", ha="center", va="center")
    axes.plot([left + 0.03, right - 0.03], [-0.07, -0.07], "o", color=FRAME, ms=8)
    axes.plot([0, wall], [-0.085, -0.085], color=FRAME, lw=2)
    for place in (0.0, wall):
        axes.plot([place, place], [-0.12, 0.12], color=FRAME, lw=6)
    axes.plot([left], [0], "s", color="k", ms=7)
    axes.annotate(f"M: load cell, class {p.plant.rig.load_cell.accuracy:g} N", (left, 0), (left, 0.14),
                  ha="center", fontsize=9, arrowprops={"arrowstyle": "-"})  # fmt: skip
    _arrow(axes, (left, -0.03), (left - 0.2, -0.03), f"$F_{{M,d}}$ = {force:.0f} N")
    _arrow(axes, (right, -0.03), (right + 0.2, -0.03), f"$F_{{M,r}}$ = {force:.0f} N")
    _arrow(axes, (specimen.length, -0.13), (left, -0.13), f"$x_S$ = {1e3 * x:.1f} mm")
    slack = specimen.length - settings.position_offset
    _arrow(axes, (specimen.length, -0.18), (slack, -0.18), f"$X_S$ = {1e3 * settings.position_offset:g} mm")
    axes.set(aspect="equal", xlim=(-0.03, wall + 0.03), ylim=(-0.23, 0.19), xlabel="m", yticks=())
    return figure


def mechanics(p: Parameters) -> Figure:
    """Draw fig. 6: bodies, angles, swivel-joint and linear bearing, with what each body weighs."""
    angle, section = float(scenario_shape(p)(PHASE)[0]), p.leg
    pose = pose_of(angle, 0.0, section)
    figure = Figure(figsize=(11, 4), layout="constrained")
    axes, listed = figure.subplots(1, 2, width_ratios=(3, 1))
    if section.person.present:
        _draw_person(axes, pose, section)
    _draw_frame(axes, pose, section)
    rows = []
    for name, body in zip(BODIES, leg.bodies(angle, section), strict=False):
        place = np.array(body.position).ravel()
        mass = float(body.mass)
        inertia = float(body.inertia)
        colour = PERSON if name.endswith("p") else "k"
        axes.plot(*place, "x" if inertia else "o", color=colour, ms=9, mew=2)
        aside, side = (-0.012, "right") if name.endswith("p") else (0.012, "left")
        up = -0.045 if name in ("sh,p", "f,p") else 0.02  # beside the shank, which falls
        axes.text(place[0] + aside, place[1] + up, f"$m_{{{name}}}$", color=colour, ha=side)
        rows.append((f"$m_{{{name}}}$, $J_{{{name}}}$", f"{mass:.3g}", f"{inertia:.3g}"))
    _draw_angles(axes, pose, angle)
    axes.set(aspect="equal", xlabel="x / m", ylabel="z / m")
    listed.axis("off")
    listed.table(rows, colLabels=("body", "m / kg", "J / kg m²"), loc="center", cellLoc="left").scale(1, 1.5)
    return figure


def _joints(overrides: Mapping[str, Any]) -> dict[str, Parameters]:
    """Return the parameters of the device's joints, each with what of the overrides it has."""
    declared = device_named(config_folder() / FOLDER / "device.yaml")
    if declared is None:
        raise OrthosisError("config/devices/device.yaml declares no joints")
    joints = {name: load(machine=machine) for name, machine in declared.joints.items()}
    return {
        name: p.changed({key: one for key, one in of_joint(name, overrides).items() if key in p.flat()})
        for name, p in joints.items()
    }


def _draw_leg(axes: Axes, joints: Mapping[str, Parameters], phase: float, opacity: float) -> None:
    """Draw one leg at a phase of the gait: frame, muscles of the knee, ropes of the ankle, shoe."""
    knee, ankle = (float(scenario_shape(joints[name])(phase)[0]) for name in ("knee", "ankle"))
    p = joints["knee"].leg
    pose = pose_of(knee, ankle, p)
    _draw_frame(axes, pose, p, opacity)
    for line in shape_of(joints["knee"]).sketch(np.array([knee])).actuators.values():
        axes.plot(*np.vstack([line.lower, line.chain]).T, color=ROPE, lw=1, alpha=opacity)
        _draw_muscle(axes, line.upper[0], line.lower[0], opacity)
    for one in joints["ankle"].declared.actuators:
        part = getattr(p.ankle, one.name)
        upper = pose.ankle - part.ground * _towards(pose.shank)
        lever = pose.shank + math.pi + p.configuration * (part.angle + ankle)
        end = pose.ankle + part.lever * _towards(lever)
        length = joints["ankle"].at(one.parameters).length - float(lever_contraction(ankle, part))
        lower = upper + length * (end - upper) / np.linalg.norm(end - upper)
        axes.plot(*np.array([lower, end, pose.ankle]).T, color=ROPE, lw=1.5, alpha=opacity)
        _draw_muscle(axes, upper, lower, opacity)
    _draw_shoe(axes, joints["shoe"], p, pose, opacity)


def _draw_shoe(axes: Axes, shoe: Parameters, p: Section, pose: Pose, opacity: float) -> None:
    """Draw the sole, and below it the cushions of heel and forefoot."""
    forward, down = _towards(pose.toes), _towards(pose.toes - p.configuration * math.pi / 2)
    middle = pose.ankle + p.shoe_length * (p.ankle.shoe.forward * forward + p.ankle.shoe.below * down)
    half = 0.5 * p.shoe_length * forward
    axes.plot(*np.array([pose.ankle, middle]).T, color=FRAME, lw=2, alpha=opacity)
    axes.plot(*np.array([middle - half, middle + half]).T, color=FRAME, lw=3, alpha=opacity)
    for one in shoe.declared.actuators:
        cushion, arm = shoe.at(one.parameters), shoe.at(one.transmission).arm
        edge = 0.5 * math.sqrt(cushion.area) * forward
        place, deep = middle + arm * forward, cushion.length * down
        corners = [place - edge, place + edge, place + edge + deep, place - edge + deep]
        axes.add_patch(Polygon(corners, fc="tab:green", ec="k", alpha=opacity))


def _draw_frame(axes: Axes, pose: Pose, p: Section, opacity: float = 1.0) -> None:
    """Draw thigh and shank, the sprocket, the swivel-joint of the hip and the bearing of the ankle."""
    axes.plot(*np.array([pose.hip, pose.knee, pose.ankle]).T, "-", color=FRAME, lw=5, alpha=opacity,
              solid_capstyle="round")  # fmt: skip
    axes.add_patch(
        Circle(tuple(pose.knee), p.cogwheel_diameter / 2, fc="none", ec=FRAME, lw=2, alpha=opacity)
    )
    axes.plot(*pose.hip, "^", color="k", ms=14, alpha=opacity)
    axes.plot(*pose.ankle, "o", color="k", ms=8, alpha=opacity)
    along = pose.ankle[0] + np.array([-0.2, 0.2])
    axes.plot(along, [p.bearing_height - 0.015] * 2, color="k", lw=2, alpha=opacity)


def _draw_person(axes: Axes, pose: Pose, p: Section) -> None:
    """Draw the person's thigh as a frustum and the shank as a cylinder, by mass and density."""
    for segment, start, end in (
        (p.person.thigh, pose.hip, pose.knee), (p.person.shank, pose.knee, pose.ankle)
    ):  # fmt: skip
        length, mass = float(np.linalg.norm(end - start)), segment.mass_fraction * p.person.mass
        wide, narrow = map(float, leg.frustum_radii(mass, length, segment.solid_centre, segment.density))
        aside = np.array([start[1] - end[1], end[0] - start[0]]) / length
        corners = [start + wide * aside, end + narrow * aside, end - narrow * aside, start - wide * aside]
        axes.add_patch(Polygon(corners, fc=PERSON, ec=PERSON, alpha=0.2))


def _draw_muscle(axes: Axes, upper: np.ndarray, lower: np.ndarray, opacity: float) -> None:
    axes.plot(*np.array([upper, lower]).T, color=MUSCLE, lw=6, alpha=opacity, solid_capstyle="butt")


def _draw_angles(axes: Axes, pose: Pose, angle: float) -> None:
    """Draw hip angle a and knee angle q as arcs."""
    thigh, shank = math.degrees(pose.thigh), math.degrees(pose.shank)
    for at, ends, name, size in (
        (pose.hip, (0.0, thigh), f"$a$ = {thigh:.0f}°", 0.3),
        (pose.knee, (shank, thigh), f"$q$ = {math.degrees(angle):.0f}°", 0.2),
    ):
        axes.add_patch(Arc(tuple(at), size, size, theta1=min(ends), theta2=max(ends)))
        middle = math.radians(sum(ends) / 2)
        x, z = at + 0.55 * size * _towards(middle)
        axes.text(x, z, name, va="center")
    axes.plot(*np.array([pose.knee, pose.knee + 0.15 * _towards(pose.thigh)]).T, "k--", lw=0.8)
    axes.plot([0.0, 0.3], [0.0, 0.0], "k--", lw=0.8)


def _arrow(axes: Axes, start: Point, end: Point, words: str) -> None:
    axes.annotate("", end, start, arrowprops=ARROW)
    axes.text((start[0] + end[0]) / 2, start[1] - 0.008, words, ha="center", va="top", fontsize=9)


def _towards(angle: float) -> np.ndarray:
    """Return the unit vector (x, z) at an angle above x."""
    return np.array([math.cos(angle), math.sin(angle)])


def schemes() -> dict[str, bytes]:
    """Return each figure as PNG, drawn from the declared machines."""
    p = load()
    figures = {
        "device": device(),
        "rig": rig(p),
        "rig_control": blocks.rig_control(p),
        "mechanics": mechanics(load(WITH_PERSON)),
        "knee_control": blocks.knee_control(p),
    }
    return {name: _png(figure) for name, figure in figures.items()}


def _png(figure: Figure) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, dpi=110, format="png")
    return stream.getvalue()
