# SPDX-License-Identifier: Apache-2.0
"""Effort of the nominal model's effects over a cycle: settled, and how it differs at the start of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pam_orthosis.control.effects import AddedEffort
from pam_orthosis.control.reference import Reference
from pam_orthosis.planning.problem import Cycle

SAME_EFFORT = 1.0e-2  # N m or N by which it may differ from one cycle to the next
LONGEST = 60  # cycles after which it is taken for settled
EARLY = 0.75  # of a cycle behind the start, where most gaits ask for most: there the first one is planned


class Effort(NamedTuple):
    """Torque or force of the nominal model's effects between the N instants of a cycle, (N,) each.

    Attributes:
        settled: when creep has found its cycle.
        early: in the first cycle, begun from long rest; the same if nothing creeps.
        settling: cycles in which the difference falls by a factor e; None: there is none.
    """

    settled: np.ndarray
    early: np.ndarray
    settling: float | None


def along(nominal, position: np.ndarray, velocity: np.ndarray, cycle: Cycle) -> Effort:
    """Return the effort of the effects along a motion, (N,) and its rate, at the pressures of a cycle."""
    step, count = nominal.scenario.control_period, len(position)
    samples = round(nominal.scenario.cycle_time / step)
    at, middles = np.arange(samples) * count / samples, (np.arange(count) + 0.5) / count

    def between(values: np.ndarray) -> np.ndarray:
        return np.interp(at, np.arange(count + 1), np.append(values, values[0]))

    columns = position, velocity, *cycle.pressures
    rows, law = list(zip(*map(between, columns), strict=True)), AddedEffort(nominal)

    def of_a_cycle() -> np.ndarray:
        effort = [law.step(Reference(q, rate, 0.0), pressures) for q, rate, *pressures in rows]
        return np.interp(middles * samples, np.arange(samples + 1), [*effort, effort[0]])

    of_a_cycle()  # dry friction and play find their cycle in it
    cycles = [of_a_cycle(), of_a_cycle()]
    while np.abs(cycles[-1] - cycles[-2]).max() > SAME_EFFORT and len(cycles) < LONGEST:
        cycles.append(of_a_cycle())
    settled = cycles[-1]
    second, third = (each - settled for each in cycles[:2])
    left = float(second @ third) / float(second @ second) if len(cycles) > 2 else 0.0  # a cycle later
    if not 0.0 < left < 1.0:
        return Effort(settled, settled, None)
    settling = -1.0 / np.log(left)
    return Effort(settled, settled + second * np.exp((1.0 + middles - EARLY) / settling), settling)
