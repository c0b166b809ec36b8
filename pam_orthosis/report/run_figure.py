# SPDX-License-Identifier: Apache-2.0
"""The interactive figure of a run: plots that zoom together, and the machine moving above them."""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.subplots import make_subplots

from pam_orthosis.report.run_data import Panel, RunData, View, view

PICTURES_PER_SECOND = 20
MOST_PICTURES = 240
VIEW_HEIGHT, PANEL_HEIGHT = 1.5, 1.0  # shares
PIXELS = 230  # of one share
COLOUR_SCALE = "Plasma"
COLOURS = {"reference": "#aaa", "estimate": "#2ca02c"}
OF_ACTUATORS = ("#1f77b4", "#ff7f0e", "#9467bd", "#8c564b", "#e377c2", "#7f7f7f", "#bcbd22", "#17becf")
CLEAR = {"color": "rgba(0,0,0,0)"}
WIDTH_OF_DIAMETER = 500  # pixels/m
MARGIN = 0.05  # m


def run_figure(run: RunData, bound: float) -> go.Figure:
    """Return the figure; the bound on the error is drawn into its panel."""
    scene = view(run, _picked(run.time))
    colours = COLOURS | dict(zip(run.machine.names, OF_ACTUATORS, strict=False))
    rows = 1 + len(run.panels)
    shares = [VIEW_HEIGHT, *[PANEL_HEIGHT] * len(run.panels)]
    figure = make_subplots(rows=rows, cols=1, row_heights=shares, vertical_spacing=0.035)
    for trace in _machine(scene, 0, colours):
        figure.add_trace(trace, row=1, col=1)
    for row in range(2, rows + 1):
        figure.add_trace(_cursor(scene, 0, run.panels[row - 2]), row=row, col=1)
    moving = list(range(len(figure.data)))
    for row, panel in enumerate(run.panels, start=2):
        _add_panel(figure, row, panel, bound, colours)
    figure.frames = [
        go.Frame(
            name=f"{scene.time[i]:.2f}",
            data=[*_machine(scene, i, colours), *(_cursor(scene, i, panel) for panel in run.panels)],
            traces=moving,
        )
        for i in range(len(scene.time))
    ]
    _lay_out(figure, scene, rows, sum(shares))
    return figure


def _picked(seconds: np.ndarray) -> np.ndarray:
    """Return which samples the animation shows, at most `MOST_PICTURES` of them."""
    count = min(MOST_PICTURES, len(seconds), max(2, round(seconds[-1] * PICTURES_PER_SECOND)))
    return np.unique(np.linspace(0, len(seconds) - 1, count).round().astype(int))


def _machine(scene: View, i: int, colours: dict[str, str]) -> list[go.Scatter]:
    """Return the traces of one picture: the body, then chain and bar of each actuator."""
    body = {"color": "#444", "width": 5}
    traces = [_line(scene.sketch.body[i], "body", body, mode="lines+markers")]
    for name, one in scene.sketch.actuators.items():
        bars = scene.pressures[name]
        colour = colours[name] if bars is None else _colour(bars[i])
        words = name if bars is None else f"{name} {bars[i]:.2f} bar"
        width = float(one.diameter[i] * WIDTH_OF_DIAMETER)
        traces.append(_line([one.lower[i], one.chain[i]], f"{name} chain", {"color": "#999", "width": 2}))
        traces.append(_line([one.upper[i], one.lower[i]], words, {"color": colour, "width": width}))
    return traces


def _line(points, name: str, line: dict, mode: str = "lines") -> go.Scatter:
    x, z = np.round(np.asarray(points).T, 4).tolist()
    return go.Scatter(x=x, y=z, mode=mode, name=name, line=line, hoverinfo="name", showlegend=False)


def _colour(bar: float) -> str:
    return sample_colorscale(COLOUR_SCALE, float(np.clip((bar - 1) / 6, 0, 1)))[0]


def _cursor(scene: View, i: int, panel: Panel) -> go.Scatter:
    values = np.concatenate([curve.value for curve in panel.curves])
    ends = [round(float(end), 4) for end in (values.min(), values.max())]
    instant = round(float(scene.time[i]), 4)
    return go.Scatter(
        x=[instant, instant], y=ends, mode="lines", line={"color": "#c00", "width": 1},
        hoverinfo="skip", showlegend=False,
    )  # fmt: skip


def _add_panel(figure: go.Figure, row: int, panel: Panel, bound: float, colours: dict[str, str]) -> None:
    for curve in panel.curves:
        figure.add_trace(_scatter(curve, f"legend{row}", colours), row=row, col=1)
    figure.update_yaxes(title_text=panel.label, row=row, col=1)
    if panel.label.startswith("error"):
        for sign in (-1, 1):
            figure.add_hline(sign * bound, line={"dash": "dash", "width": 1}, row=row, col=1)


def _scatter(curve, legend: str, colours: dict[str, str]) -> go.Scatter:
    line: dict = {"width": 1.2, "color": colours.get(curve.name.split()[0], "#c00")}
    if curve.name.endswith("reference"):
        line |= {"dash": "dot"} if curve.name != "reference" else {"width": 3}
    return go.Scatter(x=curve.time, y=curve.value, name=curve.name, line=line, legend=legend)


def _lay_out(figure: go.Figure, scene: View, rows: int, shares: float) -> None:
    """Tie the time axes together, keep the leg's proportions, add play, pause and the slider."""
    for row in range(2, rows + 1):
        figure.update_xaxes(matches=None if row == 2 else "x2", row=row, col=1)
        top = figure.layout[f"yaxis{row}"].domain[1]
        figure.update_layout({f"legend{row}": {"x": 1.01, "y": top, "yanchor": "top"}})
    figure.update_xaxes(title_text="time / s", row=rows, col=1)
    low, high = scene.sketch.extent
    x, z = zip((low - MARGIN).tolist(), (high + MARGIN).tolist(), strict=True)
    figure.update_xaxes(title_text="x / m", range=x, constrain="domain", row=1, col=1)
    figure.update_yaxes(title_text="z / m", range=z, scaleanchor="x", row=1, col=1)
    period = 1e3 * float(np.mean(np.diff(scene.time))) if len(scene.time) > 1 else 100.0
    go_on = {
        "frame": {"duration": period, "redraw": False},
        "fromcurrent": True,
        "transition": {"duration": 0},
    }
    stay = {"frame": {"duration": 0, "redraw": False}, "mode": "immediate", "transition": {"duration": 0}}
    figure.update_layout(
        height=round(PIXELS * shares), margin={"t": 110, "l": 70, "r": 20}, template="plotly_white",
        hovermode="x",
        updatemenus=[{
            "type": "buttons", "direction": "left", "x": 0, "y": 1.0, "yanchor": "bottom", "pad": {"b": 40},
            "buttons": [
                {"label": "play", "method": "animate", "args": [None, go_on]},
                {"label": "pause", "method": "animate", "args": [[None], stay]},
            ],
        }],
        sliders=[{
            "x": 0.2, "len": 0.8, "y": 1.0, "yanchor": "bottom", "pad": {"b": 20}, "font": CLEAR,
            "ticklen": 0, "minorticklen": 0,
            "currentvalue": {"prefix": "time / s: ", "font": {"color": "#333"}},
            "steps": [
                {"label": frame.name, "method": "animate", "args": [[frame.name], stay]}
                for frame in figure.frames
            ],
        }],
    )  # fmt: skip
