# SPDX-License-Identifier: Apache-2.0
"""Animated picture of a run: leg and muscles over the last gait cycle, angle beside its reference."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from PIL import Image

from pam_orthosis.bag.read import Bag, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import parameters as tree
from pam_orthosis.model.orthosis import MUSCLES
from pam_orthosis.report.leg_shape import LegShape

FRAMES_PER_SECOND = 20
MOST_SECONDS = 10.0
COLOURS_IN_FILE = 64
SIZE, DPI = (8.0, 3.2), 100  # inches
COLOURS = mpl.colormaps["plasma"]
LEAST, MOST = 1.0, 7.0  # bar, ends of the colours
GREY = "#606060"


def write_animation(bag_path: Path, namespace: str, stream: BinaryIO) -> None:
    """Write the last cycle of a bag as GIF; OrthosisError if the bag is unusable."""
    needed = ("angle", "reference_angle", *(f"{name}_pressure" for name in MUSCLES))
    bag = read_bag(bag_path, needed, (), namespace)
    stamps, (angle, reference, *pressures) = aligned(*(bag[name] for name in needed))
    if len(stamps) < 2:
        raise OrthosisError(f"{bag_path}: angle, reference and pressures share no stamps")
    time = (stamps - stamps[0]) / SECOND_NS
    seconds = min(bag.parameters.get("scenario.cycle_time", time[-1]), time[-1], MOST_SECONDS)
    instants = time[-1] - seconds + np.arange(round(seconds * FRAMES_PER_SECOND)) / FRAMES_PER_SECOND
    shown = np.searchsorted(time, instants)
    figure = Figure(figsize=SIZE, dpi=DPI, layout="constrained")
    leg_axes, angle_axes = figure.subplots(1, 2, width_ratios=(2.3, 1))
    leg = MovingLeg(leg_axes, _shape(bag), angle[shown], np.array(pressures)[:, shown] / 1e5)
    cursor = _draw_angle(angle_axes, time, np.degrees(angle), np.degrees(reference), instants)
    figure.colorbar(
        _colours(), ax=leg_axes, label="absolute pressure / bar", location="bottom", shrink=0.5, aspect=30
    )

    canvas, frames = FigureCanvasAgg(figure), []
    for i, instant in enumerate(instants):
        leg.show(i)
        cursor.set_xdata([instant, instant])
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        frames.append(picture.quantize(COLOURS_IN_FILE))
    frames[0].save(
        stream, "GIF", save_all=True, append_images=frames[1:], duration=1000 // FRAMES_PER_SECOND, loop=0
    )


class MovingLeg:
    """Thigh, shank and foot with both muscles, as thick as they are and coloured by their pressures."""

    def __init__(self, axes, shape: LegShape, angles: np.ndarray, bars: np.ndarray):
        self._pose, self._bars = shape.pose(angles), bars
        pose = self._pose
        self._sprocket = axes.add_patch(
            Circle((0, 0), shape.radius, facecolor="0.85", edgecolor="0.4", zorder=1)
        )
        (self._bones,) = axes.plot([], [], "-o", color=GREY, linewidth=5, markersize=7, zorder=2)
        self._chains = {name: axes.plot([], [], color="0.4", linewidth=1.5, zorder=3)[0] for name in MUSCLES}
        self._muscles = {name: axes.add_patch(Polygon(np.zeros((4, 2)), zorder=4)) for name in MUSCLES}
        corners = [pose.hip, pose.knee, pose.ankle, pose.toe, *(pose.muscles[name].upper for name in MUSCLES)]
        points = np.concatenate(corners)
        axes.axhline(pose.ankle[0, 1], color="0.8", linewidth=4, zorder=0)
        for end, set_limits in enumerate((axes.set_xlim, axes.set_ylim)):
            set_limits(points[:, end].min() - 0.05, points[:, end].max() + 0.05)
        axes.text(
            pose.ankle[:, 0].mean(), pose.ankle[0, 1] - 0.045, "ankle on its bearing", ha="center", va="top"
        )
        self._names = {name: axes.text(0, 0, name, ha="center", va="center", zorder=5) for name in MUSCLES}
        axes.set_aspect("equal")
        axes.set_axis_off()

    def show(self, i: int) -> None:
        """Show an instant."""
        pose = self._pose
        self._bones.set_data(*np.array([pose.hip[i], pose.knee[i], pose.ankle[i], pose.toe[i]]).T)
        for name, bar in zip(MUSCLES, self._bars[:, i], strict=True):
            muscle = pose.muscles[name]
            self._chains[name].set_data(*np.array([muscle.lower[i], muscle.chain[i]]).T)
            self._muscles[name].set_xy(_outline(muscle.upper[i], muscle.lower[i], muscle.diameter[i]))
            self._muscles[name].set_facecolor(COLOURS((bar - LEAST) / (MOST - LEAST)))
            along = muscle.lower[i] - muscle.upper[i]
            middle = (muscle.lower[i] + muscle.upper[i]) / 2
            outward = middle - (pose.hip[i] + pose.knee[i]) / 2
            outward -= along * (outward @ along) / (along @ along)
            self._names[name].set_position(middle + 0.05 * outward / np.linalg.norm(outward))
            self._names[name].set_rotation(np.degrees(np.arctan2(along[1], along[0])))
        self._sprocket.set_center(pose.knee[i])


def _outline(upper: np.ndarray, lower: np.ndarray, diameter: float) -> np.ndarray:
    along = (lower - upper) / np.linalg.norm(lower - upper)
    beside = np.array([-along[1], along[0]]) * diameter / 2
    return np.array([upper + beside, lower + beside, lower - beside, upper - beside])


def _shape(bag: Bag) -> LegShape:
    shipped = tree.load().only("leg", "muscle").flat()
    return LegShape(tree.load({key: value for key, value in bag.parameters.items() if key in shipped}))


def _draw_angle(axes, time, angle, reference, instants):
    last = time >= instants[0]
    axes.plot(time[last], reference[last], color="0.6", linewidth=4, label="reference")
    axes.plot(time[last], angle[last], color="tab:red", linewidth=1.2, label="measured")
    axes.set(xlabel="time / s", ylabel="knee angle / deg")
    axes.legend(loc="upper right", frameon=False)
    return axes.axvline(instants[0], color="tab:blue", linewidth=1)


def _colours():
    return mpl.cm.ScalarMappable(mpl.colors.Normalize(LEAST, MOST), COLOURS)
