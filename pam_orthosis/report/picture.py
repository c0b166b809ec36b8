# SPDX-License-Identifier: Apache-2.0
"""Plots of pages as a picture file, for programs and papers that take no HTML."""

import base64
from collections.abc import Sequence
from typing import Any, BinaryIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pam_orthosis.report.plots import Plot, Trace

SIZE = (6.0, 3.6)  # inches, of a plot
# light scheme of `assets/plots.js`
COLOURS = {
    "ink": "#1b1b1b", "faint": "#767676", "pale": "#c4c8cc", "blue": "#0072b2", "orange": "#d55e00",
    "green": "#007a5a", "purple": "#b0578d", "sky": "#2a8fc9", "amber": "#b97f00",
}  # fmt: skip
DASHES = {"solid": "-", "dash": "--", "dot": ":"}
SYMBOLS = {"circle": "o", "diamond": "D", "square": "s", "x": "x"}


def draw(plots: Sequence[Plot], stream: BinaryIO, columns: int = 1) -> None:
    """Draw plots in rows of so many, as PNG."""
    rows = -(-len(plots) // columns)
    figure = Figure(figsize=(SIZE[0] * columns, SIZE[1] * rows), layout="constrained")
    axes = list(figure.subplots(rows, columns, squeeze=False).flat)
    for one, plot in zip(axes, plots, strict=False):
        draw_plot(one, plot)
    for unused in axes[len(plots) :]:
        unused.remove()
    figure.savefig(stream, dpi=110, format="png")


def draw_plot(axes: Axes, plot: Plot) -> None:
    """Draw a plot on axes."""
    bars = [trace for trace in plot.data if trace["type"] == "bar"]
    for number, trace in enumerate(bars):
        places, width = np.arange(len(trace["x"])), 0.8 / len(bars)
        own = places + (number - (len(bars) - 1) / 2) * width
        axes.bar(own, trace["y"], width, color=_colour(trace["marker"]), label=trace["name"])
        axes.set_xticks(places, trace["x"])
    for trace in plot.data:
        if trace["type"] == "scatter":
            points = _numbers(trace["x"]), _numbers(trace["y"])
            axes.plot(*points, label=_label(trace), **_look(trace))
            for x, y, word in zip(*points, trace.get("text", ()), strict=False):
                axes.annotate(word, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7)
    for level in plot.levels:
        axes.axhline(level, color=COLOURS["faint"], ls="--", lw=0.8)
    axes.set_title(plot.title, fontsize="small", wrap=True)
    axes.set(xlabel=plot.x, ylabel=plot.y, yscale="log" if plot.log else "linear")
    if len(axes.get_legend_handles_labels()[0]) > 1:
        beside = (1, 1)  # the axes, where it covers no curve
        axes.legend(loc="upper left", bbox_to_anchor=beside, frameon=False, fontsize="small")


def _look(trace: Trace) -> dict[str, Any]:
    if trace["mode"] == "markers":
        own = trace["marker"]
        return {"ls": "", "color": _colour(own), "ms": own["size"] / 2, "marker": SYMBOLS[own["symbol"]]}
    own, dotted = trace["line"], "markers" in trace["mode"]
    look = {"color": _colour(own), "ls": DASHES[own["dash"]], "lw": own["width"] / 1.6}
    return look | ({"marker": ".", "ms": 6} if dotted else {})


def _label(trace: Trace) -> str:
    return trace["name"] if trace.get("showlegend", True) else "_"


def _colour(look: dict[str, Any]) -> str:
    return COLOURS[look["color"].removeprefix("@")]


def _numbers(packed: dict[str, str]) -> np.ndarray:
    """Return what `plots.packed` packs."""
    return np.frombuffer(base64.b64decode(packed["bdata"]), "<f8")
