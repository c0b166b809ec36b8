# SPDX-License-Identifier: Apache-2.0
"""The page of the gap workflow: verdict, gaps, ranking, and two figures, in one HTML file."""

from __future__ import annotations

import base64
import io
from html import escape
from itertools import takewhile

import numpy as np
from matplotlib.figure import Figure

from pam_orthosis.discrepancy import structure
from pam_orthosis.discrepancy.judgement import Outcome
from pam_orthosis.discrepancy.structure import missing_rate, order
from pam_orthosis.report.html import document

WINDOW = 4.0  # s, shown of a recording: where the gap is largest
SLOW = 12.0  # Hz, of what the model misses
BINS = 24
PER_ORDER = ("", "/s", "/s²")
BEFORE, AFTER, MEASURED = "#d62728", "#1f77b4", "0.25"


def page(outcome: Outcome, words: str) -> str:
    """Return a page with everything inside, headed by the last line of `words`."""
    parts = [f"<h1>{escape(words.splitlines()[-1])}</h1>", f"<pre>{escape(words)}</pre>"]
    parts.append("<h2>Measured, before, after</h2>" + _image(_traces(outcome)))
    figure = _coordinate_figure(outcome)
    if figure is not None:
        parts.append("<h2>What the model misses</h2>" + _image(figure))
    parts += [_effect_words(outcome), _ranking(outcome)]
    return document("gap", "".join(parts))


def _image(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    data = base64.b64encode(buffer.getvalue()).decode()
    return f'<p><img alt="" src="data:image/png;base64,{data}"></p>'


def _effect_words(outcome: Outcome) -> str:
    words = [
        f"<h2>{escape(one.name.replace('_', ' '))}</h2><p>{escape(effect.physics)}</p>"
        f"<p>Source: {escape(effect.source)}</p>"
        for one in outcome.effects
        for effect in [outcome.system.catalogue[one.name]]
    ]
    return "".join(words)


def _ranking(outcome: Outcome) -> str:
    rows = [
        f"<tr><td>{number + 1}</td><td>{escape(name)}</td><td>{evidence:.0f}</td></tr>"
        for number, step in enumerate(outcome.steps)
        for name, evidence in step.ranked
    ]
    if not rows:
        return ""
    return (
        "<h2>Evidence of the effects that were fitted</h2><table><tr><th>round<th>effect<th>evidence</tr>"
        f"{''.join(rows)}</table>"
    )


def residuals_of(outcome: Outcome, run, equation, which) -> np.ndarray:
    """Return recorded minus predicted of one equation on one held-out run, (n, channels)."""
    model = outcome.selection.null if which == "before" else outcome.selection.final
    return outcome.held_out.replay.residuals(run, equation, model.effects, model.values)


def _traces(outcome: Outcome) -> Figure:
    channels = [(e, i, name) for e in outcome.system.equations for i, name in enumerate(e.channels)]
    figure = Figure(figsize=(10, 3.0 * len(channels)), layout="constrained")
    axes = figure.subplots(len(channels), 2, squeeze=False)
    for (equation, i, name), (left, right) in zip(channels, axes, strict=True):
        _trace(outcome, equation, i, outcome.system.channel(name), left, right)
    axes[0, 0].legend(loc="upper right", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    return figure


def _trace(outcome: Outcome, equation, i, channel, left, right) -> None:
    """Draw one channel where its gap was largest: signals on the left, residuals on the right."""
    found = []
    for one in outcome.held_out.scored:
        pair = [residuals_of(outcome, one.run, equation, which)[:, i] for which in ("before", "after")]
        found.append((one, *pair))
    one, before, after = max(found, key=lambda item: _worst(item[0], item[1])[1])
    start, _ = _worst(one, before)
    part = slice(start, start + round(WINDOW / one.run.period))
    time = np.arange(len(before))[part] * one.run.period
    measured = one.run.recording.signals[channel.name][part]
    factor = channel.report_factor
    left.plot(time, measured * factor, color=MEASURED, lw=2.5, label="measured")
    left.plot(time, (measured - before[part]) * factor, color=BEFORE, lw=1, label="before")
    left.plot(time, (measured - after[part]) * factor, color=AFTER, lw=1, label="after")
    left.set_ylabel(f"{channel.name.replace('_', ' ')} [{channel.report_unit}]")
    right.plot(time, before[part] * factor, color=BEFORE, lw=1)
    right.plot(time, after[part] * factor, color=AFTER, lw=1)
    right.set_ylabel(f"measured - model [{channel.report_unit}]")


def _worst(one, residual: np.ndarray) -> tuple[int, float]:
    """Return where the window with the largest residuals starts, and their mean square."""
    length = min(round(WINDOW / one.run.period), len(residual) - one.warm_up)
    sums = np.concatenate([[0.0], np.cumsum(residual[one.warm_up :] ** 2)])
    power = (sums[length:] - sums[:-length]) / length
    return one.warm_up + int(np.argmax(power)), float(power.max())


def _coordinate_figure(outcome: Outcome) -> Figure | None:
    """Draw what the model misses over the signals in which the effects live that were found."""
    panels = [] if outcome.verdict == "none" else _panels(outcome)
    if not panels:
        return None
    figure = Figure(figsize=(10, 4 * len(panels)), layout="constrained")
    rows = figure.subfigures(len(panels), 1, squeeze=False)[:, 0]
    for row, (title, equation, channels, name) in zip(rows, panels, strict=True):
        row.suptitle(title)
        for axis, channel in zip(row.subplots(1, len(channels), squeeze=False)[0], channels, strict=True):
            _panel(outcome, equation, channel, name, axis)
    figure.axes[0].legend(fontsize="small")
    return figure


def _panels(outcome: Outcome) -> list[tuple]:
    """Return title, equation, channels and signal of pictures: where effects live, else where the gap is."""
    if not outcome.effects:
        equation = _equation(outcome.system, outcome.where[0].equation)
        signals = list(outcome.where[0].coordinates)[:1]
        return [("", equation, equation.channels, name) for name in signals]
    titles: dict[tuple, list[str]] = {}
    for one in outcome.effects:
        place = _where(outcome, one.name)
        name = _coordinate(outcome, one.name, place)
        if name is not None:
            titles.setdefault((place.equation, name), []).append(one.name.replace("_", " "))
    panels = []
    for (place, name), words in titles.items():
        equation = _equation(outcome.system, place)
        panels.append((" and ".join(words), equation, _concerned(equation, name), name))
    return panels


def _equation(system, name: str):
    return next(equation for equation in system.equations if equation.name == name)


def _where(outcome: Outcome, effect: str):
    """Return the equation's gap in which an effect shows: its own, or the one of those it enters."""
    touched = outcome.held_out.replay.touched(effect)
    places = [place for place in outcome.where if place.equation in touched] or list(outcome.where)
    own = outcome.system.equation_of(effect)
    return next((place for place in places if place.equation == own), places[0])


def _concerned(equation, name: str) -> tuple[str, ...]:
    """Return the channels whose names begin with most words of a signal's: those of its muscle; else all."""
    common = [_common_words(channel, name) for channel in equation.channels]
    return tuple(c for c, count in zip(equation.channels, common, strict=True) if count == max(common))


def _common_words(one: str, other: str) -> int:
    pairs = zip(one.split("_"), other.split("_"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _panel(outcome: Outcome, equation, channel: str, name: str, axis) -> None:
    for which, colour in (("before", BEFORE), ("after", AFTER)):
        _missing(outcome, equation, equation.channels.index(channel), which, name, axis, colour)
    axis.set_xlabel(name.replace("_", " ") + _unit(outcome.system, name))
    per, unit = PER_ORDER[order(outcome.system, channel)], outcome.system.channel(channel).unit
    axis.set_ylabel(f"missing in {channel.replace('_', ' ')} [{unit}{per}]")


def _unit(system, name: str) -> str:
    """Return the unit of a signal in brackets behind a blank; nothing for one whose unit is not declared."""
    unit = system.unit(name)
    return f" [{unit}]" if unit else ""


def _coordinate(outcome: Outcome, effect: str, place) -> str | None:
    """Return the recorded signal that stands for the one in which an effect lives."""
    wanted = outcome.system.catalogue[effect].coordinate
    if wanted in place.coordinates:
        return wanted
    for ending, stand_in in _stand_ins(outcome.system):
        if wanted.endswith(ending):
            return stand_in
    return next(iter(place.coordinates), None)


def _stand_ins(system) -> list[tuple[str, str]]:
    """Return endings of signals of an effect with the recorded signals that stand for these."""
    if not system.derived:
        return []
    velocity, position = next(iter(system.derived.items()))
    channel = next(c.name for c in system.channels if c.state == position)
    return [("_contraction", channel), ("_rate", velocity), ("_stretch", channel)]


def _missing(outcome: Outcome, equation, i, which, name, axis, colour) -> None:
    """Draw mean and scatter of the missing rate: the residual with the observer undone, slow part."""
    channel = equation.channels[i]
    over, rates = [], []
    for one in outcome.held_out.scored:
        signals = structure.signals_of(outcome.system, one)
        if name not in signals:  # nothing repeats itself in this one
            continue
        residual = residuals_of(outcome, one.run, equation, which)[:, i]
        missing = missing_rate(outcome.system, equation, channel, residual, one.run.period, SLOW)
        over.append(signals[name])
        rates.append(missing[one.warm_up :])
    x, y = np.concatenate(over), np.concatenate(rates)
    thin = slice(None, None, max(1, len(x) // 3000))
    axis.plot(x[thin], y[thin], ".", ms=2, alpha=0.25, color=colour)
    edges = np.unique(np.quantile(x, np.linspace(0, 1, BINS + 1)))
    place = np.clip(np.searchsorted(edges, x) - 1, 0, len(edges) - 2)
    filled = np.unique(place)
    middle = [np.mean(x[place == k]) for k in filled]
    axis.plot(middle, [np.mean(y[place == k]) for k in filled], color=colour, lw=2, label=which)
