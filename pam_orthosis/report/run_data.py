# SPDX-License-Identifier: Apache-2.0
"""What pictures of a run show: its signals in degrees or mm, bar and V, thinned honestly; the machine."""

from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from pam_orthosis.bag.read import Bag, Series, aligned, read_bag, recorded_machine
from pam_orthosis.bag.topics import SECOND_NS
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import load
from pam_orthosis.scene.shape import Shape, Sketch
from pam_orthosis.scene.shapes import shape_of

BAR = 1e5  # Pa
MOST_POINTS = 2000  # of a curve
DRAWN = 3  # panels, where not all are: coordinate, error, pressures
KINDS = "pressure", "pressure_reference", "voltage"  # of an actuator


class Curve(NamedTuple):
    """A curve: name, seconds since the start (n,), values (n,), and how many samples it stands for."""

    name: str
    time: np.ndarray
    value: np.ndarray
    samples: int


class Panel(NamedTuple):
    """Curves over one axis, with the axis' label."""

    label: str
    curves: list[Curve]


class RunData(NamedTuple):
    """A recorded run: bag, machine, its panels (coordinate and error first), its first stamp."""

    bag: Bag
    machine: Machine
    panels: list[Panel]
    start_ns: int

    @property
    def thinned(self) -> bool:
        """Whether a curve shows fewer points than there are samples."""
        return any(len(c.time) < c.samples for panel in self.panels for c in panel.curves)

    @property
    def measured(self) -> Series:
        """The measured coordinate."""
        return self.bag[self.machine.coordinate.name]

    @property
    def time(self) -> np.ndarray:
        """Instants of the measured coordinate since the start, s."""
        return (self.measured.stamp_ns - self.start_ns) / SECOND_NS

    @property
    def last_cycle(self) -> float:
        """Length of the last cycle, s: of all that there is, where it is shorter."""
        end = float(self.time[-1])
        cycle: float = self.bag.parameters.get("scenario.cycle_time", end)
        return min(cycle, end)


class View(NamedTuple):
    """The machine at some instants: seconds (n,), its shape, its side view, pressures (n,) bar or None."""

    time: np.ndarray
    shape: Shape
    sketch: Sketch
    pressures: dict[str, np.ndarray | None]


def read_run(path: Path, namespace: str = "") -> RunData:
    """Read what a bag holds of the panels' signals; OrthosisError if it is unusable."""
    machine = recorded_machine(path, namespace)
    name = machine.coordinate.name
    by_actuator = [f"{one}_{kind}" for one in machine.names for kind in KINDS]
    useful = (f"estimate_{name}", "disturbance", *by_actuator)
    return run_data(read_bag(path, (name, f"reference_{name}"), useful, namespace))


def run_data(bag: Bag) -> RunData:
    """Return the panels of a bag that is read or made of arrays; OrthosisError without a reference."""
    machine = bag.machine
    name, pressures = machine.coordinate.name, [f"{one}_pressure" for one in machine.names]
    voltages = [f"{one}_voltage" for one in machine.names]
    references = [f"{one}_reference" for one in pressures]
    if f"reference_{name}" not in bag.series:
        raise OrthosisError(f"{bag.path}: there is no reference to draw the {name} against")
    stamps, (reference, measured) = aligned(bag[f"reference_{name}"], bag[name])
    if len(stamps) < 2:
        raise OrthosisError(f"{bag.path}: {name} and reference share no stamps")
    unit, shown = machine.coordinate.shown_unit, machine.coordinate.shown_factor
    start = int(bag[name].stamp_ns[0])

    def curves(names: list[str], factor: float = 1.0) -> list[Curve]:
        there = [one for one in names if one in bag.series]
        return [_curve(one.replace("_", " "), bag[one], start, factor) for one in there]

    by_muscle = [one for pair in zip(pressures, references, strict=True) for one in pair]
    panels = [
        Panel(f"{machine.name} {name} / {unit}", [
            _curve("reference", bag[f"reference_{name}"], start, shown),
            _curve("measured", bag[name], start, shown),
            *curves([f"estimate_{name}"], shown),
        ]),
        Panel(f"error / {unit}", [_curve("error", Series(stamps, reference - measured), start, shown)]),
        Panel("pressure / bar absolute", curves(by_muscle, 1 / BAR)),
        Panel("valve voltage / V", curves(voltages)),
        Panel(f"estimated disturbance / {machine.coordinate.effort_unit}", curves(["disturbance"])),
    ]  # fmt: skip
    return RunData(bag, machine, [panel for panel in panels if panel.curves], start)


def view(run: RunData, picked: np.ndarray) -> View:
    """Return the machine at some samples of its coordinate, by their numbers; each pressure is the newest."""
    series = run.measured
    parameters = load({}, run.machine)
    drawn = parameters.only("leg", "muscle", "machine").flat()
    known = {key: value for key, value in run.bag.parameters.items() if key in drawn}
    shape = shape_of(parameters.changed(known))

    def held(name: str) -> np.ndarray | None:
        if name not in run.bag.series:
            return None
        stamps, value = run.bag[name]
        newest = np.searchsorted(stamps, series.stamp_ns[picked], side="right") - 1
        return np.asarray(value[np.maximum(newest, 0)] / BAR)

    pressures = {name: held(f"{name}_pressure") for name in run.machine.names}
    return View(run.time[picked], shape, shape.sketch(series.value[picked]), pressures)


def rounded(values: npt.ArrayLike) -> Any:
    """Return places in m, angles in degrees and pressures in bar for a script that draws them."""
    return np.round(np.asarray(values), 4).tolist()


def thinned(time: np.ndarray, value: np.ndarray, most: int = MOST_POINTS) -> tuple[np.ndarray, np.ndarray]:
    """Return at most `most` samples: of each of equal groups the smallest and the largest, in order.

    No peak is lost; what is in between is.
    """
    if len(time) <= most:
        return time, value
    edges = np.linspace(0, len(time), most // 2 + 1).astype(int)
    groups = [np.arange(a, b) for a, b in pairwise(edges)]
    kept = np.unique([g[pick(value[g])] for g in groups for pick in (np.argmin, np.argmax)])
    return time[kept], value[kept]


def _curve(name: str, series: Series, start_ns: int, factor: float) -> Curve:
    time, value = thinned((series.stamp_ns - start_ns) / SECOND_NS, factor * series.value)
    return Curve(name, time, value, len(series.value))
