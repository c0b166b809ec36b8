# SPDX-License-Identifier: Apache-2.0
"""Picture of a run: the moving machine, coordinate against reference, error against the bound, pressures."""

from pathlib import Path
from typing import BinaryIO

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pam_orthosis.report.picture import draw_plot
from pam_orthosis.report.run_data import DRAWN, RunData, read_run, view
from pam_orthosis.report.run_page import plot

PHASES = 9


def draw_run(bag_path: Path, bound: float, namespace: str, stream: BinaryIO) -> None:
    """Write the picture of a bag as PNG; OrthosisError if the bag is unusable."""
    drawn(read_run(bag_path, namespace), bound).savefig(stream, dpi=110, format="png")


def drawn(run: RunData, bound: float) -> Figure:
    """Return the figure of a run."""
    panels = run.panels[:DRAWN]
    figure = Figure(figsize=(11, 8), layout="constrained")
    above, *axes = figure.subplots(1 + len(panels), 1, height_ratios=[1.5, 1, 0.8, 1][: 1 + len(panels)])
    _draw_machine(above, run)
    for one, panel in zip(axes, panels, strict=True):
        draw_plot(one, plot(panel, run, bound))
        one.sharex(axes[0])
    return figure


def _draw_machine(axes: Axes, run: RunData) -> None:
    instants = run.time[-1] - run.last_cycle * (1 - np.arange(PHASES) / PHASES)
    sketch = view(run, np.searchsorted(run.time, instants)).sketch
    for corners, colour in zip(
        sketch.body, mpl.colormaps["viridis"](np.linspace(0, 0.9, PHASES)), strict=True
    ):
        axes.plot(*corners.T, "-o", color=colour, linewidth=2.5, markersize=5)
    axes.set(aspect="equal", xlabel="x / m", ylabel="z / m")
    name = f"{run.machine.name} {run.machine.coordinate.name}"
    axes.set_title(f"last cycle, measured {name} (dark: start, light: end)")
