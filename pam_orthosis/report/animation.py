# SPDX-License-Identifier: Apache-2.0
"""Animated picture of a run: the machine over the last cycle, beside it coordinate and error."""

from pathlib import Path
from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure, FigureBase
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from PIL import Image

from pam_orthosis.bag.read import aligned
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.report.run_data import RunData, View, read_run, view

FRAMES_PER_SECOND = 20
COLOURS = mpl.colormaps["plasma"]
SCALE = mpl.colors.Normalize(1.0, 7.0)  # bar
GREY = "#606060"


def write_animation(bag_path: Path, namespace: str, stream: BinaryIO) -> None:
    """Write the last cycle of a bag as GIF; OrthosisError if the bag is unusable."""
    run = read_run(bag_path, namespace)
    seconds = min(run.last_cycle, 10.0)
    instants = run.time[-1] - seconds + np.arange(round(seconds * FRAMES_PER_SECOND)) / FRAMES_PER_SECOND
    scene = view(run, np.searchsorted(run.time, instants))
    if unknown := [name for name, pressure in scene.pressures.items() if pressure is None]:
        raise OrthosisError(f"{bag_path}: no pressure of {', '.join(unknown)}")
    figure = Figure(figsize=(8.4, 3.4), dpi=100, layout="constrained")
    left, right = figure.subfigures(1, 2, squeeze=False, width_ratios=(1.8, 1))[0]
    machine_axes = left.subplots()
    machine = Moving(machine_axes, scene)
    cursors = _draw_curves(right, run, instants)
    colours = mpl.cm.ScalarMappable(SCALE, COLOURS)
    left.colorbar(
        colours, ax=machine_axes, label="absolute pressure / bar", location="bottom", shrink=0.5, aspect=30
    )

    canvas, frames = FigureCanvasAgg(figure), []
    for i, instant in enumerate(instants):
        machine.show(i)
        for cursor in cursors:
            cursor.set_xdata([instant, instant])
        canvas.draw()
        picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
        frames.append(picture.quantize(64))
    frames[0].save(
        stream, "GIF", save_all=True, append_images=frames[1:], duration=1000 // FRAMES_PER_SECOND, loop=0
    )


class Moving:
    """A machine's body and actuators, as thick as they are and coloured by their pressures."""

    def __init__(self, axes: Axes, scene: View):
        self._scene, sketch, shape = scene, scene.sketch, scene.shape
        names = tuple(sketch.actuators)
        self._wheel = axes.add_patch(Circle((0, 0), 0, facecolor="0.85", edgecolor="0.4", zorder=1))
        (self._body,) = axes.plot([], [], "-o", color=GREY, linewidth=5, markersize=7, zorder=2)
        self._chains = {name: axes.plot([], [], color="0.4", linewidth=1.5, zorder=3)[0] for name in names}
        self._bars = {name: Polygon(np.zeros((4, 2)), zorder=4) for name in names}
        self._names = {name: axes.text(0, 0, name, ha="center", va="center", zorder=5) for name in names}
        for bar in self._bars.values():
            axes.add_patch(bar)
        for low, high, set_limits in zip(*sketch.extent, (axes.set_xlim, axes.set_ylim), strict=True):
            set_limits(low - 0.05, high + 0.05)
        if shape.rail:
            corner, words = shape.rail
            x, z = sketch.body[:, corner, 0].mean(), sketch.body[0, corner, 1]
            axes.axhline(z, color="0.8", linewidth=4, zorder=0)
            axes.text(x, z - 0.045, words, ha="center", va="top")
        axes.set_aspect("equal")
        axes.set_axis_off()

    def show(self, i: int) -> None:
        """Show an instant."""
        body = self._scene.sketch.body[i]
        self._body.set_data(*body.T)
        for name, one in self._scene.sketch.actuators.items():
            upper, lower, pressures = one.upper[i], one.lower[i], self._scene.pressures[name]
            assert pressures is not None  # the animation is of bags that hold them
            self._chains[name].set_data(*np.array([lower, one.chain[i]]).T)
            self._bars[name].set_xy(_outline(upper, lower, one.diameter[i]))
            self._bars[name].set_facecolor(COLOURS(SCALE(pressures[i])))
            along, middle = lower - upper, (lower + upper) / 2
            outward = middle - body[:2].mean(axis=0)
            outward -= along * (outward @ along) / (along @ along)
            self._names[name].set_position(middle + 0.05 * outward / max(np.linalg.norm(outward), 1e-9))
            heading = np.degrees(np.arctan2(along[1], along[0]))
            self._names[name].set_rotation((heading + 90) % 180 - 90)  # never upside down
        if self._scene.shape.wheel:
            corner, radius = self._scene.shape.wheel
            self._wheel.set(center=body[corner], radius=radius)


def _outline(upper: np.ndarray, lower: np.ndarray, diameter: float) -> np.ndarray:
    along = (lower - upper) / np.linalg.norm(lower - upper)
    beside = np.array([-along[1], along[0]]) * diameter / 2
    return np.array([upper + beside, lower + beside, lower - beside, upper - beside])


def _draw_curves(figure: FigureBase, run: RunData, instants: np.ndarray) -> list[Line2D]:
    """Draw coordinate above error; return the lines that show the instant."""
    name, factor = run.machine.coordinate.name, run.machine.coordinate.shown_factor
    stamps, (reference, measured) = aligned(run.bag[f"reference_{name}"], run.bag[name])
    time = (stamps - run.start_ns) / SECOND_NS
    last = time >= instants[0]
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(1.4, 1))
    above.plot(time[last], factor * reference[last], color="0.6", linewidth=4, label="reference")
    above.plot(time[last], factor * measured[last], color="tab:red", linewidth=1.2, label="measured")
    below.plot(time[last], factor * (reference - measured)[last], color="tab:red", linewidth=1.2)
    above.set(ylabel=run.panels[0].label)
    below.set(xlabel="time / s", ylabel=run.panels[1].label)
    above.legend(loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0, ncols=2, frameon=False)
    return [axes.axvline(instants[0], color="tab:blue", linewidth=1) for axes in (above, below)]
