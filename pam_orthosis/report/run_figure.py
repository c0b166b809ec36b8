# SPDX-License-Identifier: Apache-2.0
"""The interactive figure of a run: plots that zoom together, and the leg moving above them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import plotly.graph_objects as go
from plotly.colors import sample_colorscale
from plotly.subplots import make_subplots

from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.model import parameters as tree
from pam_orthosis.report.leg_shape import LegShape, Pose
from pam_orthosis.report.run_data import MUSCLES, Panel, RunData

PICTURES_PER_SECOND = 20
MOST_PICTURES = 240
LEG_HEIGHT, PANEL_HEIGHT = 1.5, 1.0  # shares
PIXELS = 230  # of one share
COLOUR_SCALE = "Plasma"
COLOURS = {"reference": "#aaa", "estimate": "#2ca02c", "extensor": "#1f77b4", "flexor": "#ff7f0e"}
CLEAR = {"color": "rgba(0,0,0,0)"}
WIDTH_OF_DIAMETER = 500  # pixels/m


class Scene(NamedTuple):
    """What the animation shows at some instants: seconds (n,), poses, pressures (n,) Pa or None."""

    time: np.ndarray
    pose: Pose
    pressures: dict[str, np.ndarray | None]


def run_figure(run: RunData, bound_deg: float) -> go.Figure:
    """Return the figure; the bound on the error is drawn into its panel."""
    scene = make_scene(run)
    rows = 1 + len(run.panels)
    shares = [LEG_HEIGHT, *[PANEL_HEIGHT] * len(run.panels)]
    figure = make_subplots(rows=rows, cols=1, row_heights=shares, vertical_spacing=0.035)
    for trace in _leg(scene, 0):
        figure.add_trace(trace, row=1, col=1)
    for row in range(2, rows + 1):
        figure.add_trace(_cursor(scene, 0, run.panels[row - 2]), row=row, col=1)
    moving = list(range(len(figure.data)))
    for row, panel in enumerate(run.panels, start=2):
        _add_panel(figure, row, panel, bound_deg)
    figure.frames = [
        go.Frame(
            name=f"{scene.time[i]:.2f}",
            data=[*_leg(scene, i), *(_cursor(scene, i, panel) for panel in run.panels)],
            traces=moving,
        )
        for i in range(len(scene.time))
    ]
    _lay_out(figure, scene, rows, sum(shares))
    return figure


def make_scene(run: RunData) -> Scene:
    """Return the poses of the animation, at most `MOST_PICTURES` of them."""
    series = run.bag["angle"]
    seconds = (series.stamp_ns - series.stamp_ns[0]) / SECOND_NS
    count = min(MOST_PICTURES, len(seconds), max(2, round(seconds[-1] * PICTURES_PER_SECOND)))
    picked = np.unique(np.linspace(0, len(seconds) - 1, count).round().astype(int))
    shipped = tree.load().only("leg", "muscle").flat()
    known = {key: value for key, value in run.bag.parameters.items() if key in shipped}
    return Scene(
        seconds[picked],
        LegShape(tree.load(known)).pose(series.value[picked]),
        {muscle: _held(run, f"{muscle}_pressure", series.stamp_ns[picked]) for muscle in MUSCLES},
    )


def _held(run: RunData, name: str, stamps: np.ndarray) -> np.ndarray | None:
    """Return a signal at instants, each time its newest sample; None if the bag has none."""
    if name not in run.bag.series:
        return None
    series = run.bag[name]
    return series.value[np.maximum(np.searchsorted(series.stamp_ns, stamps, side="right") - 1, 0)]


def _leg(scene: Scene, i: int) -> list[go.Scatter]:
    """Return the traces of one picture: leg, then chain and muscle of extensor and flexor."""
    pose = scene.pose
    points = np.array([pose.hip[i], pose.knee[i], pose.ankle[i], pose.toe[i]])
    traces = [_line(points, "leg", {"color": "#444", "width": 5}, mode="lines+markers")]
    for name in MUSCLES:
        muscle = pose.muscles[name]
        pressure = scene.pressures[name]
        colour = COLOURS[name] if pressure is None else _colour(pressure[i])
        words = name if pressure is None else f"{name} {pressure[i] / 1e5:.2f} bar"
        width = float(muscle.diameter[i] * WIDTH_OF_DIAMETER)
        traces.append(
            _line([muscle.lower[i], muscle.chain[i]], f"{name} chain", {"color": "#999", "width": 2})
        )
        traces.append(_line([muscle.upper[i], muscle.lower[i]], words, {"color": colour, "width": width}))
    return traces


def _line(points, name: str, line: dict, mode: str = "lines") -> go.Scatter:
    x, z = np.round(np.asarray(points).T, 4).tolist()
    return go.Scatter(x=x, y=z, mode=mode, name=name, line=line, hoverinfo="name", showlegend=False)


def _colour(pressure: float) -> str:
    return sample_colorscale(COLOUR_SCALE, float(np.clip((pressure / 1e5 - 1) / 6, 0, 1)))[0]


def _cursor(scene: Scene, i: int, panel: Panel) -> go.Scatter:
    values = np.concatenate([curve.value for curve in panel.curves])
    ends = [round(float(end), 4) for end in (values.min(), values.max())]
    instant = round(float(scene.time[i]), 4)
    return go.Scatter(
        x=[instant, instant], y=ends, mode="lines", line={"color": "#c00", "width": 1},
        hoverinfo="skip", showlegend=False,
    )  # fmt: skip


def _add_panel(figure: go.Figure, row: int, panel: Panel, bound_deg: float) -> None:
    for curve in panel.curves:
        figure.add_trace(_scatter(curve, f"legend{row}"), row=row, col=1)
    figure.update_yaxes(title_text=panel.label, row=row, col=1)
    if panel.label.startswith("error"):
        for sign in (-1, 1):
            figure.add_hline(sign * bound_deg, line={"dash": "dash", "width": 1}, row=row, col=1)


def _scatter(curve, legend: str) -> go.Scatter:
    line: dict = {"width": 1.2, "color": COLOURS.get(curve.name.split()[0], "#c00")}
    if curve.name.endswith("reference"):
        line |= {"dash": "dot"} if curve.name != "reference" else {"width": 3}
    return go.Scatter(x=curve.time, y=curve.value, name=curve.name, line=line, legend=legend)


def _lay_out(figure: go.Figure, scene: Scene, rows: int, shares: float) -> None:
    """Tie the time axes together, keep the leg's proportions, add play, pause and the slider."""
    for row in range(2, rows + 1):
        figure.update_xaxes(matches=None if row == 2 else "x2", row=row, col=1)
        top = figure.layout[f"yaxis{row}"].domain[1]
        figure.update_layout({f"legend{row}": {"x": 1.01, "y": top, "yanchor": "top"}})
    figure.update_xaxes(title_text="time / s", row=rows, col=1)
    x, z = _extent(scene.pose)
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


def _extent(pose: Pose) -> tuple[list[float], list[float]]:
    points = [pose.hip, pose.knee, pose.ankle, pose.toe, *(m.upper for m in pose.muscles.values())]
    every = np.concatenate(points)
    low, high = every.min(axis=0) - 0.05, every.max(axis=0) + 0.05
    return [float(low[0]), float(high[0])], [float(low[1]), float(high[1])]
