# SPDX-License-Identifier: Apache-2.0
"""Picture of a run: the walking leg, angle against reference, error against the bound, pressures."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.bag.read import Bag, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import parameters as parameter_tree
from pam_orthosis.report.leg_drawing import draw_walk

PHASES = 9
BAR = 1e5  # Pa
_NEEDED = ("angle", "reference_angle")
_USEFUL = tuple(f"{m}_pressure{kind}" for m in ("extensor", "flexor") for kind in ("", "_reference"))
_COLOURS = {"extensor": "tab:blue", "flexor": "tab:orange"}


def draw_run(bag_path: Path, bound_deg: float, namespace: str, stream: BinaryIO) -> None:
    """Write the picture of a bag as PNG; OrthosisError if the bag is unusable."""
    bag = read_bag(bag_path, _NEEDED, _USEFUL, namespace)
    figure = Figure(figsize=(11, 8), layout="constrained")
    leg_axes, *time_axes = _axes(figure)
    stamps, (angle, reference) = aligned(bag["angle"], bag["reference_angle"])
    if len(stamps) < 2:
        raise OrthosisError(f"{bag_path}: angle and reference share no stamps")
    time = (stamps - stamps[0]) / SECOND_NS
    _draw_leg(leg_axes, bag, time, angle)
    _draw_angle(time_axes[0], time, angle, reference)
    _draw_error(time_axes[1], time, np.degrees(reference - angle), bound_deg)
    _draw_pressures(time_axes[2], bag, stamps[0])
    time_axes[2].set_xlabel("time / s")
    figure.savefig(stream, dpi=110, format="png")


def _axes(figure):
    grid = figure.add_gridspec(4, 1, height_ratios=[1.5, 1, 0.8, 1])
    first = figure.add_subplot(grid[1])
    others = [figure.add_subplot(grid[row], sharex=first) for row in (2, 3)]
    return figure.add_subplot(grid[0]), first, *others


def _draw_leg(axes, bag: Bag, time, angle) -> None:
    shipped = parameter_tree.load().only("leg").flat()
    known = {key: value for key, value in bag.parameters.items() if key in shipped}
    cycle = min(bag.parameters.get("scenario.cycle_time", time[-1]), time[-1])
    instants = time[-1] - cycle + cycle * np.arange(PHASES) / PHASES
    angles = angle[np.searchsorted(time, instants)]
    colours = mpl.colormaps["viridis"](np.linspace(0, 0.9, PHASES))
    draw_walk(axes, angles, parameter_tree.load(known).leg, colours)
    axes.set_title("last gait cycle, measured knee angle (dark: start, light: end)")


def _draw_angle(axes, time, angle, reference) -> None:
    axes.plot(time, np.degrees(reference), color="0.5", linewidth=2.5, label="reference")
    axes.plot(time, np.degrees(angle), color="tab:red", linewidth=1, label="measured")
    axes.set_ylabel("knee angle / deg")
    _legend_above(axes)


def _draw_error(axes, time, error, bound_deg: float) -> None:
    axes.plot(time, error, color="tab:red", linewidth=0.8)
    for sign in (-1, 1):
        axes.axhline(sign * bound_deg, color="k", linestyle="--", linewidth=1)
    axes.set_ylabel("error / deg")
    axes.annotate(f"bound {bound_deg:g} deg", (time[-1], bound_deg), ha="right", va="top")


def _draw_pressures(axes, bag: Bag, start_ns: int) -> None:
    for muscle, colour in _COLOURS.items():
        for kind, style in (("", "-"), ("_reference", ":")):
            name = f"{muscle}_pressure{kind}"
            if name in bag.series:
                stamps, value = bag[name]
                label = muscle + kind.replace("_", " ")
                axes.plot((stamps - start_ns) / SECOND_NS, value / BAR, style, color=colour,
                          linewidth=1, label=label)  # fmt: skip
    axes.set_ylabel("absolute pressure / bar")
    if axes.lines:
        _legend_above(axes)


def _legend_above(axes) -> None:
    """Put the legend above the axes, where it covers no curve."""
    place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0}
    axes.legend(**place, ncols=4, frameon=False, fontsize="small")
