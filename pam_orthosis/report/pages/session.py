# SPDX-License-Identifier: Apache-2.0
"""The page of a training session, in a therapist's words; an earlier session beside it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pam_orthosis.bag.session import Recorded, read_session
from pam_orthosis.control.activity import shares
from pam_orthosis.control.session import Event
from pam_orthosis.report.page import BAD, GOOD, NEUTRAL, Page, Part, listed
from pam_orthosis.report.plots import AFTER, BEFORE, Plot, Trace, line, packed

COLOURS = {"left": AFTER, "right": BEFORE}
MODES = {
    "position": "led",
    "impedance": "spring",
    "assist": "as needed",
    "transparent": "free",
}
SHARE = (
    "The share is the part of the torque of the motion that does not come from the muscles of the orthosis,"
    " in percent: 100 means that the person does all of it, 0 nothing; below 0 they work against it."
    " The figure behind ± is the standard error of one stride."
)
HELP = (
    "Help: led, the orthosis moves the leg; spring, it pulls softly to the path; as needed, it helps where"
    " the person does not; free, it follows the leg."
)
UNITS = {
    "range of motion": (180 / math.pi, "deg"),
    "speed": (180 / math.pi, "deg/s"),
    "torque": (1.0, "N m"),
    "force": (1.0, "N"),
    "pressure": (1e-5, "bar"),
    "spasm": (1.0, "N m"),
    "stale data": (1e3, "ms"),
    "command": (1.0, "V"),
}  # limit -> from SI, unit
NO_STRIDES = "No stride was completed."
Array = NDArray[np.float64]


class Strides(NamedTuple):
    """Of one leg, a value each stride: the person's share and its standard error, degrees off and moved."""

    share: Array
    error: Array
    off: Array
    range: Array

    def of(self, chosen: Sequence[int]) -> Strides:
        """Return some of them."""
        return Strides(*(one[list(chosen)] for one in self))


class Shown(NamedTuple):
    """A session and the strides of each leg."""

    session: Recorded
    legs: dict[str, Strides]

    @property
    def minutes(self) -> float:
        """How long it took."""
        return float(next(iter(self.session.signals.values()))["time"][-1]) / 60

    def stage(self, number: int) -> list[int]:
        """Return the strides of a stage."""
        return [index for index, one in enumerate(self.session.strides) if one.stage == number]


def page(now: Shown, earlier: Shown | None = None) -> str:
    """Return the page."""
    session, made = now.session, len(now.session.strides)
    answer, tone = ("ENDED EARLY", BAD) if session.ended else ("COMPLETED", GOOD)
    if session.trips and not session.ended:
        tone = NEUTRAL
    strides = f"{made} stride{'s' * (made != 1)} in {now.minutes:.1f} min"
    brought = " and ".join(f"{_share(one)} on the {leg}" for leg, one in now.legs.items())
    headline = (
        f"{strides}. The person brought {brought} of the torque of the motion."
        if made
        else f"{strides}. {NO_STRIDES}"
    )
    parts = [Part("Stages", (SHARE, HELP), listed(*_stages(now)))]
    if earlier:
        parts.append(Part(f"Compared with {earlier.session.name}", (), listed(*_compared(now, earlier))))
    if made:
        parts.append(Part("Stride by stride", plots=[*_plots(now, earlier)]))
    parts.append(_safety(now))
    about = "training session of an emulated person, no medical record"
    return Page(session.name, answer, tone, headline, [*_meaning(now)], parts, about).html()


def _meaning(now: Shown) -> Iterator[str]:
    if now.session.ended:
        yield f"The session ended early: {now.session.ended}."
    if now.session.strides:
        yield difference(now)
    trips = len(now.session.trips)
    stopped = (
        f"stopped the training {trips} time{'s' * (trips > 1)}; see below" if trips else "did not step in"
    )
    yield f"The safety monitor {stopped}."


def difference(now: Shown) -> str:
    """Return in words which leg did more."""
    left, right = now.legs["left"], now.legs["right"]
    points = 100 * float(np.mean(left.share - right.share))
    unsure = 100 * float(np.mean(np.hypot(left.error, right.error)))
    if abs(points) < 2 * unsure:  # standard errors
        return f"Both legs did about the same: they differ by {abs(points):.0f} ± {unsure:.0f} points."
    more, less = ("left", "right") if points > 0 else ("right", "left")
    return f"The {more} leg did more than the {less} one, by {abs(points):.0f} ± {unsure:.0f} points."


def _share(strides: Strides) -> str:
    if not len(strides.share):
        return "-"
    return f"{100 * np.mean(strides.share):.0f}\u00a0±\u00a0{100 * np.mean(strides.error):.0f}\u00a0%"


def _mean(values: Array) -> str:
    return f"{np.mean(values):.1f}" if len(values) else "-"


def _stages(now: Shown) -> tuple[list[str], list[list[str]]]:
    head = ["stage", "help", "s a stride", "strides", "share left", "share right",
            "off the path left, right / deg", "range left, right / deg"]  # fmt: skip
    rows = []
    for number, stage in enumerate(now.session.stages):
        if stage["pause"]:
            rows.append([stage["name"], f"rest of {stage['pause']:g} s", *["-"] * 6])
            continue
        chosen = now.stage(number)
        own = [one.of(chosen) for one in now.legs.values()]
        done = f"{len(chosen)}" if len(chosen) == stage["strides"] else f"{len(chosen)} of {stage['strides']}"
        off, moved = (", ".join(_mean(getattr(one, what)) for one in own) for what in ("off", "range"))
        row = [stage["name"], MODES[stage["mode"]], f"{stage['cycle_time']:g}", done]
        rows.append([*row, *map(_share, own), off, moved])
    return head, rows


def _compared(now: Shown, earlier: Shown) -> tuple[list[str], list[list[str]]]:
    rows = [
        [name, f"{before:.{digits}f}", f"{after:.{digits}f}", f"{after - before:+.{digits}f}"]
        for (name, before, digits), (_, after, _) in zip(_figures(earlier), _figures(now), strict=True)
    ]
    return ["", "earlier", "now", "change"], rows


def _figures(of: Shown) -> Iterator[tuple[str, float, int]]:
    """Yield name, value and digits of what sessions are compared by."""
    yield "strides", len(of.session.strides), 0
    yield "minutes", of.minutes, 1
    for leg, one in of.legs.items():
        if len(one.share):
            yield f"share, {leg} / %", 100 * float(np.mean(one.share)), 0
            yield f"uncertainty of a stride, {leg} / points", 100 * float(np.mean(one.error)), 0
            yield f"off the path, {leg} / deg", float(np.mean(one.off)), 1
            yield f"range, {leg} / deg", float(np.mean(one.range)), 1
    yield "trips", len(of.session.trips), 0


def _plots(now: Shown, earlier: Shown | None) -> Iterator[Plot]:
    yield _plot(now, earlier, "share", "the person's share", "share / %", 100.0)
    yield _plot(now, earlier, "off", "largest distance from the path", "distance / deg", 1.0)
    yield _plot(now, earlier, "range", "range of motion", "range / deg", 1.0)


def _plot(now: Shown, earlier: Shown | None, what: str, title: str, y: str, scale: float) -> Plot:
    data: list[Trace] = []
    for leg, one in now.legs.items():
        values = scale * getattr(one, what)
        drawn = line(np.arange(1, len(values) + 1), values, leg, COLOURS[leg]) | {"mode": "lines+markers"}
        if what == "share":
            drawn["error_y"] = {
                "type": "data",
                "array": packed(scale * one.error),
                "thickness": 0.8,
                "width": 0,
            }
        data.append(drawn)
    for leg, one in (earlier.legs if earlier else {}).items():
        values = scale * getattr(one, what)
        data.append(line(np.arange(1, len(values) + 1), values, f"{leg}, earlier", COLOURS[leg], "dot"))
    means = ", ".join(f"{leg} {scale * np.mean(getattr(one, what)):.1f}" for leg, one in now.legs.items())
    return Plot(title, f"mean {y} of {title}: {means}", "stride", y, data, shared="strides")


def _safety(now: Shown) -> Part:
    if not now.session.trips:
        return Part("Safety", ("No limit was exceeded.",))
    words = "After each trip both legs stopped, and the training went on once the limits allowed it."
    rows = [[f"{one.time:.1f}", one.leg, _in_words(one)] for one in now.session.trips]
    return Part("Safety", (words,), listed(["second", "leg", "what was exceeded"], rows))


def _in_words(trip: Event) -> str:
    scale, unit = UNITS.get(trip.limit, (1.0, ""))
    return f"{trip.limit}: {scale * trip.value:.1f} {unit}, allowed {scale * trip.allowed:.1f} {unit}"


def shown(path: Path) -> Shown:
    """Read a session; OrthosisError if the bag is none."""
    session = read_session(path)
    return Shown(session, {leg: _strides(session, leg) for leg in session.signals})


def _strides(session: Recorded, leg: str) -> Strides:
    signals, parameters = session.signals[leg], session.parameters[leg]
    name = parameters.declared.coordinate.name
    spans = [(one.first, one.end) for one in session.strides]
    found = shares(signals, parameters, spans)
    error, place = np.degrees(signals[f"reference_{name}"] - signals[name]), np.degrees(signals[name])
    return Strides(
        np.array([one.share for one in found]),
        np.array([one.error for one in found]),
        np.array([np.abs(error[first:end]).max() for first, end in spans]),
        np.array([np.ptp(place[first:end]) for first, end in spans]),
    )
