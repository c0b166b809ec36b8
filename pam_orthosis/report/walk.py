# SPDX-License-Identifier: Apache-2.0
"""Picture of a run: the moving machine, coordinate against reference, error against the bound, pressures."""

from pathlib import Path
from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.report.run_data import Panel, RunData, read_run, view

PHASES = 9
PANELS = 3  # coordinate, error, pressures
COLOURS = {"reference": "0.5", "measured": "tab:red", "error": "tab:red"}
OF_ACTUATORS = ("tab:blue", "tab:orange", "tab:purple", "tab:brown", "tab:pink", "tab:gray", "tab:olive")


def draw_run(bag_path: Path, bound: float, namespace: str, stream: BinaryIO) -> None:
    """Write the picture of a bag as PNG; OrthosisError if the bag is unusable."""
    drawn(read_run(bag_path, namespace), bound).savefig(stream, dpi=110, format="png")


def drawn(run: RunData, bound: float) -> Figure:
    """Return the figure of a run."""
    panels = run.panels[:PANELS]
    figure = Figure(figsize=(11, 8), layout="constrained")
    above, *axes = figure.subplots(1 + len(panels), 1, height_ratios=[1.5, 1, 0.8, 1][: 1 + len(panels)])
    _draw_machine(above, run)
    colours = COLOURS | dict(zip(run.machine.names, OF_ACTUATORS, strict=False))
    for one, panel in zip(axes, panels, strict=True):
        _draw_panel(one, panel, colours)
        one.sharex(axes[0])
    for sign in (-1, 1):
        axes[1].axhline(sign * bound, color="k", linestyle="--", linewidth=1)
    unit = panels[1].label.split(" / ")[1]
    axes[1].annotate(f"bound {bound:g} {unit}", (run.time[-1], bound), ha="right", va="top")
    axes[-1].set_xlabel("time / s")
    return figure


def _draw_machine(axes, run: RunData) -> None:
    instants = run.time[-1] - run.last_cycle * (1 - np.arange(PHASES) / PHASES)
    sketch = view(run, np.searchsorted(run.time, instants)).sketch
    for corners, colour in zip(
        sketch.body, mpl.colormaps["viridis"](np.linspace(0, 0.9, PHASES)), strict=True
    ):
        axes.plot(*corners.T, "-o", color=colour, linewidth=2.5, markersize=5)
    axes.set(aspect="equal", xlabel="x / m", ylabel="z / m")
    name = f"{run.machine.name} {run.machine.coordinate.name}"
    axes.set_title(f"last cycle, measured {name} (dark: start, light: end)")


def _draw_panel(axes, panel: Panel, colours: dict[str, str]) -> None:
    for curve in panel.curves:
        if curve.name.startswith("estimate"):
            continue
        style = ":" if curve.name.endswith(" reference") else "-"
        width, colour = 2.5 if curve.name == "reference" else 1, colours[curve.name.split()[0]]
        axes.plot(curve.time, curve.value, style, color=colour, linewidth=width, label=curve.name)
    axes.set_ylabel(panel.label)
    if len(axes.lines) > 1:  # above the axes, where it covers no curve
        place = {"loc": "lower right", "bbox_to_anchor": (1, 1), "borderaxespad": 0}
        axes.legend(**place, ncols=4, frameon=False, fontsize="small")
