# SPDX-License-Identifier: Apache-2.0
"""An identification: figures like the paper's fig. 4 (force) and fig. 5 (volume), residuals, and the page."""

from collections.abc import Mapping
from functools import partial
from itertools import cycle
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

from pam_orthosis.files import Write
from pam_orthosis.identification.identify import DIRECTIONS, Identified
from pam_orthosis.identification.samples import Samples
from pam_orthosis.report.page import GOOD, NEUTRAL, Page, Part, listed
from pam_orthosis.report.picture import draw, draw_plot
from pam_orthosis.report.plots import OF_ACTUATORS, Plot, dots, line

FORCE, RESIDUAL, VOLUME = "force.png", "residual.png", "volume.png"
LOOKS = {1.0: ("@blue", "circle"), -1.0: ("@orange", "diamond"), 0.0: ("@faint", "square")}


def drawn(found: Identified) -> dict[str, Write]:
    """Draw what the data allow; return what writes each figure."""
    plots = {RESIDUAL: [_residual_plot(found, s) for s in (found.training, found.held_out) if len(s)]}
    if found.volume:
        plots[VOLUME] = [_volume_plot(found)]
    files = {name: partial(draw, each, columns=len(each)) for name, each in plots.items()}
    force = partial(force_figure(found).savefig, dpi=130)
    return {FORCE: force, **files}


def force_figure(found: Identified) -> Figure:
    """Force against contraction: measured and calculated at each pressure; and the surface."""
    figure = Figure(figsize=(12, 5), layout="constrained")
    curves, surface = figure.add_subplot(1, 2, 1), figure.add_subplot(1, 2, 2, projection="3d")
    draw_plot(curves, force_plot(found))
    _force_surface(surface, found)
    return figure


def _force_surface(axes: Any, found: Identified) -> None:
    box, s = found.box, found.data.samples
    x, p = np.meshgrid(
        np.linspace(box.minimum_contraction, box.maximum_contraction, 40),
        np.linspace(s.level.min(), box.maximum_pressure_gauge, 30),
    )
    force = found.force.model.towing(x, p)
    axes.plot_surface(x * 1e3, p / 1e5, np.where(force > 0, force, np.nan), alpha=0.5, cmap="viridis")
    axes.scatter(s.contraction * 1e3, s.pressure / 1e5, s.force, s=1, color="k")
    axes.set(xlabel="contraction / mm", ylabel="gauge pressure / bar", zlabel="force / N")
    axes.view_init(elev=22, azim=35)


def page(found: Identified, words: str) -> str:
    """Return the page; `words` are what the verb prints."""
    judged = found.errors(held_out=True) or found.errors(held_out=False)
    which = "pressures that were not fitted" if len(found.held_out) else "the fitted data; none were held out"
    headline = (
        f"The force is calculated within {judged['max']:.1f} N ({judged['rms']:.1f} N RMS), on {which}."
    )
    box = found.box
    meaning = [
        f"It holds for contractions of {box.minimum_contraction * 1e3:.1f} to"
        f" {box.maximum_contraction * 1e3:.1f} mm,"
        f" up to {box.maximum_pressure_gauge / 1e5:.2f} bar gauge; beyond, a polynomial is a guess."
    ]
    if not found.stiff:
        meaning.append("Caution: the force does not fall everywhere with the contraction.")
    parts = [
        Part("Force", plots=[force_plot(found)]),
        Part(
            "What is left",
            plots=[_residual_plot(found, found.held_out if len(found.held_out) else found.training)],
        ),
        *([Part("Volume", plots=[_volume_plot(found)])] if found.volume else []),
        Part("Errors", table=_errors(found)),
        Part("Coefficients of Eq. (14)", table=_coefficients(found), pre=words, more="as identify prints it"),
    ]
    tone = GOOD if found.stiff else NEUTRAL
    return Page(found.data.specimen, "identified", tone, headline, meaning, parts, "identified muscle").html()


def _levels(s: Samples) -> np.ndarray:
    levels = np.unique(s.level)
    return levels[:: -(-len(levels) // 6)]


def _thin(s: Samples) -> Samples:
    return s.where(slice(None, None, max(1, len(s) // 400)))


def force_plot(found: Identified) -> Plot:
    """Return measured and calculated force."""
    held, model, box = set(np.unique(found.held_out.level).tolist()), found.force.model, found.box
    x, data = np.linspace(box.minimum_contraction, box.maximum_contraction, 100), []
    for colour, level in zip(OF_ACTUATORS, _levels(found.data.samples), strict=False):
        part = _thin(found.data.samples.where(found.data.samples.level == level))
        force, name = model.towing(x, level), f"{level / 1e5:.1f} bar gauge"
        data.append(dots(part.contraction * 1e3, part.force, name, colour, 4.0) | {"showlegend": False})
        look = (f"{name} (held out)", colour, "dash") if level in held else (name, colour)
        data.append(line(x[force > 0] * 1e3, force[force > 0], *look))
    title = "Measured (dots) and calculated (lines)"
    alt = f"force over contraction at {len(data) // 2} pressures: it falls with the contraction, as Eq. (14)"
    return Plot(title, alt, "contraction / mm", "force / N", data, height=400)


def _residual_plot(found: Identified, s: Samples) -> Plot:
    data = []
    for sign, name in DIRECTIONS.items():
        side = _thin(s.where(s.direction == sign))
        if len(side):
            colour, symbol = LOOKS[sign]
            left = found.force.model.residual(side)
            data.append(dots(side.contraction * 1e3, left, name, colour, 5.0, symbol))
    alt = "measured less calculated force over contraction, by direction of motion"
    return Plot(
        "Measured less calculated: two branches are hysteresis", alt, "contraction / mm", "force / N", data
    )


def _volume_plot(found: Identified) -> Plot:
    points, fit, data = found.data.volumes, found.volume, []
    assert points is not None  # it is drawn where it was identified
    assert fit is not None
    levels = np.unique(np.round(points.pressure, -5))
    for colour, level in zip(cycle(OF_ACTUATORS), levels, strict=False):
        near = np.abs(points.pressure - level) < 0.5e5
        x = np.linspace(0, points.contraction[near].max(), 60)
        name = f"{level / 1e5:.0f} bar gauge"
        data.append(
            dots(points.contraction[near] * 1e3, points.volume[near] * 1e6, name, colour)
            | {"showlegend": False}
        )
        data.append(line(x * 1e3, fit.volume(x, level) * 1e6, name, colour))
    alt = "volume over contraction at each pressure, measured and calculated"
    return Plot("Measured (dots) and calculated (lines)", alt, "contraction / mm", "volume / cm³", data)


def _errors(found: Identified) -> Markup:
    rows = []
    for name, errors in (("fitted", found.errors(False)), ("held out", found.errors(True))):
        levels = errors.get("by_pressure_bar_gauge", {})
        rows += [(name, f"{level} bar", *_sizes(one)) for level, one in levels.items()]
        rows += [(name, "all", *_sizes(errors))] if errors else []
    return listed(("data", "pressure, gauge", "RMS / N", "maximum / N"), rows)


def _sizes(errors: Mapping[str, Any]) -> tuple[str, str]:
    return f"{errors['rms']:.2f}", f"{errors['max']:.2f}"


def _coefficients(found: Identified) -> Markup:
    fit = found.force
    names = [
        f"{kind}{i}" for kind, values in (("a", fit.model.a), ("b", fit.model.b)) for i in range(len(values))
    ]
    values = [*fit.model.a, *fit.model.b]
    columns = {"95 %": fit.half_width}
    if found.between is not None:
        columns["directions"] = found.between
    halves = zip(*([f"± {one:.2g}" for one in column] for column in columns.values()), strict=True)
    rows = [(n, f"{v:.6g}", *half) for n, v, half in zip(names, values, halves, strict=True)]
    return listed(("coefficient (SI)", "value", *columns), rows)
