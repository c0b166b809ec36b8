# SPDX-License-Identifier: Apache-2.0
"""Plots of the gap page: measured and predicted where the gap is largest, what the model misses, maps."""

from collections.abc import Sequence
from itertools import takewhile

import numpy as np

from pam_orthosis.discrepancy.answer.curves import Curve
from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.fitting.measure import Gap
from pam_orthosis.discrepancy.fitting.signals import signals_of
from pam_orthosis.discrepancy.fitting.structure import Where, missing_rate, order
from pam_orthosis.discrepancy.replay.problem import Scored
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.search.findings import QUANTILE
from pam_orthosis.discrepancy.systems.system import Channel, Equation, System
from pam_orthosis.discrepancy.unknown.description import Description
from pam_orthosis.report.plots import AFTER, BEFORE, OF_ACTUATORS, REFERENCE, Plot, Trace, bars, dots, line
from pam_orthosis.report.run_data import thinned

WINDOW = 4.0  # s, shown of a recording: where the gap is largest
MOST = 800  # points of a curve, dots of a cloud
PER_ORDER = ("", "/s", "/s²")
LOOKS = {"before": (BEFORE, "dash"), "after": (AFTER, "solid")}
DASHES = ("solid", "dash", "dot")


def residuals_of(outcome: Outcome, run: Run, equation: Equation, which: str) -> np.ndarray:
    """Return recorded minus predicted of one equation on one held-out run, (n, channels)."""
    model = outcome.selection.null if which == "before" else outcome.selection.final
    return outcome.held_out.replay.residuals(run, equation, model.effects, model.values)


def sizes(outcome: Outcome) -> Plot:
    """Return the gap of each channel as multiples of its noise."""
    channels = [c.name for c in outcome.system.channels if c.name in outcome.after.white]
    names = [spoken(name) for name in channels]

    def over(gap: Gap) -> list[float]:
        return [gap.white[name] / outcome.floor.white[name] for name in channels]

    before, after = over(outcome.before), over(outcome.after)
    alt = ", ".join(
        f"{n} {b:.1f} before, {a:.1f} after" for n, b, a in zip(names, before, after, strict=True)
    )
    data = [
        bars(names, before, "before: recalibrated model", BEFORE, "/"),
        bars(names, after, "after: with what was found", AFTER),
    ]
    title = "The gap on held-out recordings; the dashed line is noise alone"
    wide = max(before + after) > 10.0
    return Plot(title, f"gap over noise: {alt}", "", "gap / noise", data, (1.0,), log=wide)


def ranking(outcome: Outcome) -> Plot | None:
    """Return the evidence of the effects that were fitted in the first round."""
    if not outcome.steps or not outcome.steps[0].ranked:
        return None
    best = list(outcome.steps[0].ranked)[:8][::-1]
    names, values = [spoken(name) for name, _ in best], [float(value) for _, value in best]
    trace = bars(names, values, "evidence", AFTER) | {"orientation": "h", "x": values, "y": names}
    alt = ", ".join(f"{name} {value:.0f}" for name, value in zip(names[::-1], values[::-1], strict=True))
    title = "Evidence of each effect alone; the longer, the better it fits"
    height = 90 + 26 * len(best)
    return Plot(title, f"evidence: {alt}", "evidence", "", [trace], height=height)


def traces(outcome: Outcome) -> list[Plot]:
    """Return signals and residuals of each channel where its gap was largest."""
    channels = [(e, i, name) for e in outcome.system.equations for i, name in enumerate(e.channels)]
    return [
        plot
        for equation, i, name in channels
        for plot in _traces(outcome, equation, i, outcome.system.channel(name))
    ]


def missing(outcome: Outcome) -> list[Plot]:
    """Return what the model misses over the signals in which the effects live that were found."""
    panels = [] if outcome.verdict == "none" else _panels(outcome)
    return [
        _panel(outcome, title, equation, channel, name)
        for title, equation, channels, name in panels
        for channel in channels
    ]


def unknown(outcome: Outcome) -> list[Plot]:
    """Return the curves that describe what nothing explains, between the ends of their 95 % intervals."""
    return [_curve(outcome, one) for one in outcome.unknown.descriptions] if outcome.unknown else []


def _curve(outcome: Outcome, one: Description) -> Plot:
    x, half = one.places, QUANTILE * one.spread
    data = _banded(x, one.shape, half, "curve, without what may be recalibration")
    over = spoken(one.coordinate)
    size = f"half of its range is {one.amplitude[0]:.3g} {one.unit}"
    title = f"Unknown in {spoken(one.entry.name or one.channel)}, over {over}"
    axis = over + _unit(outcome.system, one.coordinate)
    return Plot(title, f"{title}: {size}", axis, f"unknown / {one.unit}", data, (0.0,), height=340)


def spoken(name: str) -> str:
    """Return a name in words."""
    return name.replace("_", " ")


def _traces(outcome: Outcome, equation: Equation, i: int, channel: Channel) -> tuple[Plot, Plot]:
    found = []
    for scored in outcome.held_out.scored:
        pair = [residuals_of(outcome, scored.run, equation, which)[:, i] for which in LOOKS]
        found.append((scored, pair[0], pair[1]))
    one, before, after = max(found, key=lambda item: _worst(item[0], item[1])[1])
    start, _ = _worst(one, before)
    part = slice(start, start + round(WINDOW / one.run.period))
    time, factor = np.arange(len(before))[part] * one.run.period, channel.report_factor
    measured = one.run.recording.signals[channel.name][part]
    left = {"before": factor * before[part], "after": factor * after[part]}
    curves = [line(*thinned(time, measured * factor, MOST), "measured", REFERENCE, width=2.4)]
    for which, look in LOOKS.items():
        curves.append(line(*thinned(time, measured * factor - left[which], MOST), which, *look))
    residuals = [line(*thinned(time, left[which], MOST), which, *look) for which, look in LOOKS.items()]
    name, unit = spoken(channel.name), channel.report_unit
    rms = ", ".join(f"RMS {np.sqrt(np.mean(left[which] ** 2)):.3g} {unit} {which}" for which in LOOKS)
    return (
        Plot(f"{name}: measured, and predicted by both models", f"{name} in {unit} over 4 s; gap: {rms}",
             "time / s", f"{name} / {unit}", curves, (), f"{name} time"),
        Plot(f"{name}: measured less predicted", f"residual in {unit}: {rms}", "time / s",
             f"residual / {unit}", residuals, (), f"{name} time"),
    )  # fmt: skip


def _worst(one: Scored, residual: np.ndarray) -> tuple[int, float]:
    """Return where the window with the largest residuals starts, and their mean square."""
    length = min(round(WINDOW / one.run.period), len(residual) - one.warm_up)
    sums = np.concatenate([[0.0], np.cumsum(residual[one.warm_up :] ** 2)])
    power = (sums[length:] - sums[:-length]) / length
    return one.warm_up + int(np.argmax(power)), float(power.max())


def _panels(outcome: Outcome) -> list[tuple[str, Equation, Sequence[str], str]]:
    """Return title, equation, channels and signal of pictures: where effects live, else where the gap is."""
    if not outcome.effects:
        equation = _equation(outcome.system, outcome.where[0].equation)
        signals = list(outcome.where[0].coordinates)[:1]
        return [("", equation, equation.channels, name) for name in signals]
    titles: dict[tuple[str, str], list[str]] = {}
    for one in outcome.effects:
        place = _where(outcome, one.name)
        name = _coordinate(outcome, one.name, place)
        if name is not None:
            titles.setdefault((place.equation, name), []).append(spoken(one.name))
    panels: list[tuple[str, Equation, Sequence[str], str]] = []
    for (of, name), words in titles.items():
        equation = _equation(outcome.system, of)
        panels.append((" and ".join(words), equation, _concerned(equation, name), name))
    return panels


def _equation(system: System, name: str) -> Equation:
    return next(equation for equation in system.equations if equation.name == name)


def _where(outcome: Outcome, effect: str) -> Where:
    """Return the equation's gap in which an effect shows: its own, or the one of those it enters."""
    touched = outcome.held_out.replay.touched(effect)
    places = [place for place in outcome.where if place.equation in touched] or list(outcome.where)
    own = outcome.system.equation_of(effect)
    return next((place for place in places if place.equation == own), places[0])


def _concerned(equation: Equation, name: str) -> tuple[str, ...]:
    """Return the channels whose names begin with most words of a signal's: those of its muscle; else all."""
    common = [_common_words(channel, name) for channel in equation.channels]
    return tuple(c for c, count in zip(equation.channels, common, strict=True) if count == max(common))


def _common_words(one: str, other: str) -> int:
    pairs = zip(one.split("_"), other.split("_"), strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _unit(system: System, name: str) -> str:
    """Return the unit of a signal behind a stroke; nothing for one whose unit is not declared."""
    unit = system.unit(name)
    return f" / {unit}" if unit else ""


def _coordinate(outcome: Outcome, effect: str, place: Where) -> str | None:
    """Return the recorded signal that stands for the one in which an effect lives."""
    wanted = outcome.system.catalogue[effect].coordinate
    if wanted in place.coordinates:
        return wanted
    for ending, stand_in in _stand_ins(outcome.system):
        if wanted.endswith(ending):
            return stand_in
    return next(iter(place.coordinates), None)


def _stand_ins(system: System) -> list[tuple[str, str]]:
    """Return endings of signals of an effect with the recorded signals that stand for these."""
    if not system.derived:
        return []
    velocity, position = next(iter(system.derived.items()))
    channel = next(c.name for c in system.channels if c.state == position)
    return [("_contraction", channel), ("_rate", velocity), ("_stretch", channel)]


def _panel(outcome: Outcome, title: str, equation: Equation, channel: str, name: str) -> Plot:
    per, unit = PER_ORDER[order(outcome.system, channel)], outcome.system.channel(channel).unit
    data = [trace for which in LOOKS for trace in _missing(outcome, equation, channel, which, name)]
    what, over = f"missing in {spoken(channel)}", spoken(name)
    head = f"{title}: {what}, over {over}" if title else f"{what}, over {over}"
    alt = f"{what} over {over}: means before and after what was found is added"
    return Plot(
        head, alt, over + _unit(outcome.system, name), f"{what} / {unit}{per}", data, (0.0,), height=340
    )


def _missing(outcome: Outcome, equation: Equation, channel: str, which: str, name: str) -> list[Trace]:
    """Return scatter and mean of the missing rate: the residual with the observer undone, slow part."""
    i, over, rates = equation.channels.index(channel), [], []
    for one in outcome.held_out.scored:
        signals = signals_of(outcome.system, one)
        if name not in signals:  # nothing repeats itself in this one
            continue
        residual = residuals_of(outcome, one.run, equation, which)[:, i]
        rate = missing_rate(outcome.system, equation, channel, residual, one.run.period, 12.0)
        over.append(signals[name])
        rates.append(rate[one.warm_up :])
    x, y = np.concatenate(over), np.concatenate(rates)
    thin = slice(None, None, max(1, len(x) // MOST))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, 25)))
    place = np.clip(np.searchsorted(edges, x) - 1, 0, len(edges) - 2)
    filled = np.unique(place)
    middle, mean = ([float(np.mean(values[place == k])) for k in filled] for values in (x, y))
    colour, dash = LOOKS[which]
    cloud = dots(x[thin], y[thin], which, colour, 3.0) | {
        "opacity": 0.3,
        "showlegend": False,
        "hoverinfo": "skip",
    }
    return [cloud, line(middle, mean, f"{which}: mean", colour, dash, 3.0)]


def maps(found: Sequence[Curve]) -> list[Plot]:
    """Return for each actuator what was found less the nominal model; first both, where that is not zero."""
    names = dict.fromkeys(curve.actuator for curve in found)
    groups = [[curve for curve in found if curve.actuator == name] for name in names]
    return [
        plot for own in groups for plot in ([_against(own[0])] if own[0].map.absolute else []) + [_less(own)]
    ]


def _against(curve: Curve) -> Plot:
    of = curve.map
    title = f"{_whose(curve)}: nominal model against what was found, with its 95 % interval"
    alt, name = f"{title}: {_in_words(curve)}", f"{of.what} / {of.unit}"
    nominal = line(curve.places, curve.nominal, "nominal model", BEFORE, "dash", 2.0)
    data = [nominal, *_banded(curve.places, curve.found, curve.half)]
    return Plot(title, alt, f"{of.over} / %", name, data, (0.0,), height=340)


def _less(own: Sequence[Curve]) -> Plot:
    (one, *more), of = own, own[0].map
    title = f"{_whose(own[0])}: found less the nominal model, which is the dashed line"
    alone = [] if more else _banded(one.places, one.found - one.nominal, one.half)
    data = alone or [_difference(k, one) for k, one in enumerate(own)]
    alt, name = f"{title}: {'; '.join(map(_in_words, own))}", f"{of.what}, difference / {of.unit}"
    return Plot(title, alt, f"{of.over} / %", name, data, (0.0,), height=340)


def _whose(curve: Curve) -> str:
    return f"{curve.actuator.capitalize()}, {curve.map.what}"


def _banded(x: np.ndarray, y: np.ndarray, half: np.ndarray, name: str = "found") -> list[Trace]:
    """Return a curve between the ends of its interval, half of which is given."""
    return [
        line(x, y, name, AFTER, width=2.4),
        line(x, y - half, "95 %, lower", REFERENCE, "dot"),
        line(x, y + half, "95 %, upper", REFERENCE, "dot"),
    ]


def _difference(k: int, curve: Curve) -> Trace:
    sure = f"±{np.median(curve.half):.2g} {curve.map.unit}"
    name = f"at {curve.pressure:g} bar ({sure})"
    return line(curve.places, curve.found, name, OF_ACTUATORS[k], DASHES[k % len(DASHES)], 2.4)


def _in_words(curve: Curve) -> str:
    k, unit = curve.largest, curve.map.unit
    at = "" if curve.pressure is None else f"at {curve.pressure:g} bar "
    return (
        f"{at}{curve.found[k]:.3g} {unit} found, {curve.nominal[k]:.3g} {unit} nominal,"
        f" at {curve.places[k]:.3g} % {curve.map.over}"
    )
