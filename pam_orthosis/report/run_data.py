# SPDX-License-Identifier: Apache-2.0
"""What the page of a run shows: its signals in degrees, bar, V and N m, thinned honestly where too many."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pam_orthosis.bag.read import Bag, Series, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS

BAR = 1e5  # Pa
MOST_POINTS = 3000  # of a curve
NEEDED = ("angle", "reference_angle")
MUSCLES = ("extensor", "flexor")
USEFUL = (
    "estimate_angle",
    "disturbance",
    *(f"{m}_{kind}" for kind in ("pressure", "pressure_reference", "voltage") for m in MUSCLES),
)


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
    """A recorded run: bag, its panels, and whether a curve was thinned."""

    bag: Bag
    panels: list[Panel]

    @property
    def thinned(self) -> bool:
        """Whether a curve shows fewer points than there are samples."""
        return any(len(c.time) < c.samples for panel in self.panels for c in panel.curves)


def read_run(path: Path, namespace: str = "") -> RunData:
    """Read what a bag holds of the panels' signals.

    Raises:
        OrthosisError: the bag is unusable.
    """
    bag = read_bag(path, NEEDED, USEFUL, namespace)
    start = int(bag["angle"].stamp_ns[0])
    error = Series(*_error(bag))
    panels = [
        Panel("knee angle / deg", [
            _curve("reference", bag["reference_angle"], start, np.degrees),
            _curve("measured", bag["angle"], start, np.degrees),
            *_curves(bag, ["estimate_angle"], start, np.degrees),
        ]),
        Panel("error / deg", [_curve("error", error, start, np.degrees)]),
        Panel("pressure / bar absolute", _curves(
            bag, [f"{m}_pressure{kind}" for m in MUSCLES for kind in ("", "_reference")], start, _bar)),
        Panel("valve voltage / V", _curves(bag, [f"{m}_voltage" for m in MUSCLES], start)),
        Panel("estimated disturbance / N m", _curves(bag, ["disturbance"], start)),
    ]  # fmt: skip
    return RunData(bag, [panel for panel in panels if panel.curves])


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


def _error(bag: Bag) -> tuple[np.ndarray, np.ndarray]:
    stamps, (reference, angle) = aligned(bag["reference_angle"], bag["angle"])
    return stamps, reference - angle


def _curves(bag: Bag, names: list[str], start_ns: int, convert=np.asarray) -> list[Curve]:
    return [
        _curve(name.replace("_", " "), bag[name], start_ns, convert) for name in names if name in bag.series
    ]


def _curve(name: str, series: Series, start_ns: int, convert=np.asarray) -> Curve:
    time, value = thinned((series.stamp_ns - start_ns) / SECOND_NS, convert(series.value))
    return Curve(name, time, value, len(series.value))


def _bar(pressure: np.ndarray) -> np.ndarray:
    return pressure / BAR
