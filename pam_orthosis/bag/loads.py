# SPDX-License-Identifier: Apache-2.0
"""How well cushions load a body: peak and timing of each one's force over the last whole cycle of a bag.

What is set is what the position controller asks of the pressures, for the instant at which that acts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pam_orthosis.bag.read import Bag, aligned, read_bag
from pam_orthosis.bag.topics import SECOND_NS

Array = npt.NDArray[np.float64]

MOST_OFF = 0.10  # of the set peak
MOST_LATE = 0.030  # s
LEAST = 1.0  # N that a cushion is asked for in a cycle


@dataclass(frozen=True)
class Load:
    """Peaks of set and measured force, N, and how far apart in time both pass half of the set peak, ms.

    `late_ms` is the largest of these; None where the measured force passes it more or less often.
    """

    set_peak_N: float
    peak_N: float
    late_ms: float | None
    passed: bool


def compared(time: Array, asked: Array, force: Array) -> Load:
    """Compare forces over a cycle; time (n,) s, set and measured force (n,) N."""
    most, reached = float(asked.max()), float(force.max())
    wanted, there = (_crossings(time, one, 0.5 * most) for one in (asked, force))
    same = len(wanted) == len(there) > 0
    late = float(np.abs(there - wanted).max()) if same else None
    near = most >= LEAST and abs(reached - most) <= MOST_OFF * most
    return Load(
        most, reached, None if late is None else 1e3 * late, near and late is not None and late <= MOST_LATE
    )


def loads_of(bag: Bag, namespace: str) -> dict[str, Load]:
    """Return the load of each actuator of a bag's leg; none where the machine follows a position."""
    known = bag.parameters
    if known.get("control.position.feedback", True):
        return {}
    cycle, ahead = (
        known["scenario.cycle_time"],
        known["valve.delay"] + 0.5 * known["scenario.control_period"],
    )
    names = [f"{name}_{kind}" for name in bag.machine.names for kind in ("pressure", "pressure_reference")]
    signals, found = read_bag(bag.path, names, (), namespace), {}
    for one in bag.machine.actuators:
        stamps, values = aligned(
            *(signals[f"{one.name}_{kind}"] for kind in ("pressure", "pressure_reference"))
        )
        time = (stamps - stamps[0]) / SECOND_NS
        pressure, asked = (
            known[f"{one.parameters}.area"] * (p - known["valve.ambient_pressure"]) for p in values
        )
        last = time > time[-1] - cycle
        found[one.name] = compared(time[last], np.interp(time - ahead, time, asked)[last], pressure[last])
    return found


def _crossings(time: Array, force: Array, level: float) -> Array:
    """Return the instants at which a force passes a level, s."""
    before = np.flatnonzero(np.diff(force > level))
    share = (level - force[before]) / (force[before + 1] - force[before])
    return np.asarray(time[before] + share * (time[before + 1] - time[before]))
