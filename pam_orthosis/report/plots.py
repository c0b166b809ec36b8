# SPDX-License-Identifier: Apache-2.0
"""Plots of pages as plain data, which the page's script draws: curves by what they mean, axes in words."""

import base64
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

# names of colours of `assets/plots.js`
REFERENCE, MEASURED, ESTIMATE = "@ink", "@blue", "@orange"
BEFORE, AFTER = "@orange", "@blue"
BELOW = "@pale"  # of a wide curve below another one
OF_ACTUATORS = ("@blue", "@orange", "@green", "@purple", "@sky", "@amber", "@faint")

Trace = dict[str, Any]


class Plot(NamedTuple):
    """One plot.

    Attributes:
        title: above it.
        alt: what it shows, for those who do not see it.
        x, y: axes in words, with units.
        data: traces of Plotly.
        levels: of horizontal lines.
        shared: plots with the same word zoom together.
        log: whether y is logarithmic.
        height: pixels.
    """

    title: str
    alt: str
    x: str
    y: str
    data: list[Trace]
    levels: tuple[float, ...] = ()
    shared: str = ""
    log: bool = False
    height: int = 280


def line(
    x: npt.ArrayLike, y: npt.ArrayLike, name: str, colour: str, dash: str = "solid", width: float = 1.6
) -> Trace:
    """Return a curve."""
    drawn = {"color": colour, "dash": dash, "width": width}
    return {"type": "scatter", "mode": "lines", "x": packed(x), "y": packed(y), "name": name, "line": drawn}


def dots(
    x: npt.ArrayLike, y: npt.ArrayLike, name: str, colour: str, size: float = 6.0, symbol: str = "circle"
) -> Trace:
    """Return points."""
    drawn = {"color": colour, "size": size, "symbol": symbol}
    return {
        "type": "scatter",
        "mode": "markers",
        "x": packed(x),
        "y": packed(y),
        "name": name,
        "marker": drawn,
    }


def bars(names: Sequence[str], values: Sequence[float], name: str, colour: str, pattern: str = "") -> Trace:
    """Return bars, one a name; `pattern` tells them from others without colour."""
    drawn = {"color": colour, "pattern": {"shape": pattern}}
    return {"type": "bar", "x": list(names), "y": list(values), "name": name, "marker": drawn}


def packed(values: npt.ArrayLike) -> dict[str, str]:
    """Return numbers as Plotly's typed array, which keeps every bit."""
    numbers = np.ascontiguousarray(values, dtype="<f8")
    return {"dtype": "f8", "bdata": base64.b64encode(numbers.tobytes()).decode()}
