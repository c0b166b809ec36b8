# SPDX-License-Identifier: Apache-2.0
"""The live view's page, and what it shows of a leg: its newest whole sample, some 25 times a second."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.bag.topics import REFERENCE, SECOND_NS, Topics
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.report.page import rendered
from pam_orthosis.report.plots import MEASURED, OF_ACTUATORS, Plot, line
from pam_orthosis.report.run_data import BAR, rounded
from pam_orthosis.scene.messages import PERIOD_NS
from pam_orthosis.scene.sampled import FARTHEST
from pam_orthosis.scene.shapes import shape_of


class Input(NamedTuple):
    """A number of a leg: topic, its type, the field of its messages."""

    topic: str
    type: str
    field: str


def inputs(machine: Machine) -> tuple[Input, ...]:
    """Return what is shown of a leg: its coordinate, the reference of that, the pressures."""
    table = Topics(machine)
    fields = dict.fromkeys(table.sensors, "fluid_pressure")
    fields |= {table.sensors[0]: "position[0]", REFERENCE: "points[0].positions[0]"}
    return tuple(Input(topic, table.by_name[topic].type, field) for topic, field in fields.items())


class LiveLeg:
    """Joins what is measured of a leg and its reference by their stamps; draws the first of each period."""

    def __init__(self, parameters: Parameters):
        self.machine, self.parameters = parameters.declared, parameters
        self.shape = shape_of(parameters)
        self._topics = [one.topic for one in inputs(self.machine)]
        self._waiting: dict[int, dict[str, float]] = {}
        self._drawn_ns = -SECOND_NS

    def due(self, stamp_ns: int) -> bool:
        """Whether a message of an instant is of use; one that is a second older begins another run."""
        if stamp_ns < self._drawn_ns - SECOND_NS:
            self._waiting, self._drawn_ns = {}, -SECOND_NS
        return stamp_ns // PERIOD_NS > self._drawn_ns // PERIOD_NS

    def add(self, topic: str, stamp_ns: int, value: float) -> dict[str, Any] | None:
        """Take a number of an instant that is due; return what to draw once all of it are there."""
        there = self._waiting.setdefault(stamp_ns, {})
        there[topic] = value
        if len(there) < len(self._topics):
            if len(self._waiting) > 50:
                del self._waiting[min(self._waiting)]
            return None
        self._waiting = {stamp: one for stamp, one in self._waiting.items() if stamp > stamp_ns}
        self._drawn_ns = stamp_ns
        return self._picture(stamp_ns, *(there[name] for name in self._topics))

    def _picture(self, stamp_ns: int, *numbers: float) -> dict[str, Any] | None:
        """Return what to draw; nothing of numbers that the leg cannot have."""
        coordinate, *pressures, reference = numbers
        if not all(map(math.isfinite, numbers)) or abs(coordinate) > FARTHEST[self.machine.coordinate.unit]:
            return None
        factor = self.machine.coordinate.shown_factor
        sketch = self.shape.sketch(np.array([coordinate]))
        shown = {"measured": factor * coordinate, "reference": factor * reference}
        actuators = {
            name: {"upper": rounded(one.upper[0]), "lower": rounded(one.lower[0]),
                   "chain": rounded(one.chain[0]), "diameter": rounded(one.diameter[0]),
                   "bar": rounded(pressure / BAR)}
            for (name, one), pressure in zip(sketch.actuators.items(), pressures, strict=True)
        }  # fmt: skip
        return {
            "time": rounded(stamp_ns / SECOND_NS),
            **{name: rounded(value) for name, value in shown.items()},
            "error": rounded(shown["reference"] - shown["measured"]),
            "body": rounded(sketch.body[0]),
            "actuators": actuators,
        }


def live_page(leg: LiveLeg, names: Sequence[str]) -> str:
    """Return the page of legs of these names, which are alike."""
    machine, unit = leg.machine, leg.machine.coordinate.shown_unit
    low, high = np.array(machine.mechanism(leg.parameters).limits)  # the drawing stays in its place
    extent = leg.shape.sketch(np.linspace(low, high, 20)).extent
    drawing = {"extent": rounded(extent), "corners": leg.shape.corners, "names": machine.names}
    plots = [
        Plot(f"error: reference less measured, {unit}", f"error in {unit} over the last seconds",
             "time / s", f"error / {unit}", [line([], [], "error", MEASURED)], height=220),
        Plot("pressures, as the sensors measure them", "absolute pressures in bar over the last seconds",
             "time / s", "pressure / bar absolute",
             [line([], [], name, colour) for name, colour in zip(machine.names, OF_ACTUATORS, strict=False)],
             height=220),
    ]  # fmt: skip
    return rendered(
        "live.html", title=machine.name, script="live.js", machine=machine, unit=unit, legs=names,
        drawing=drawing, plots=plots, machines=True,
    )  # fmt: skip
