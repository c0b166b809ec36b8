# SPDX-License-Identifier: Apache-2.0
"""Torque of the nominal model's effects over a cycle: settled, and how it differs at the start of a run."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pam_orthosis.control.effects import EffectTorque
from pam_orthosis.control.trajectory import Reference
from pam_orthosis.planning.problem import Cycle

SAME_TORQUE = 1.0e-2  # N m by which it may differ from one cycle to the next
LONGEST = 60  # cycles after which it is taken for settled
EARLY = 0.75  # of a cycle behind the start, where most gaits ask for most: there the first one is planned


class Torque(NamedTuple):
    """Torque of the nominal model's effects between the N instants of a cycle, (N,) N m each.

    Attributes:
        settled: when creep has found its cycle.
        early: in the first cycle, begun from long rest; the same if nothing creeps.
        settling: cycles in which the difference falls by a factor e; None: there is none.
    """

    settled: np.ndarray
    early: np.ndarray
    settling: float | None


def along(nominal, angle: np.ndarray, velocity: np.ndarray, pressures: Cycle) -> Torque:
    """Return the torque of the effects along a motion, (N,) rad and rad/s, at the pressures of a cycle."""
    step, count = nominal.scenario.control_period, len(angle)
    samples = round(nominal.scenario.cycle_time / step)
    at, middles = np.arange(samples) * count / samples, (np.arange(count) + 0.5) / count

    def between(values: np.ndarray) -> np.ndarray:
        return np.interp(at, np.arange(count + 1), np.append(values, values[0]))

    columns = angle, velocity, pressures.extensor_pressure, pressures.flexor_pressure
    rows, law = list(zip(*map(between, columns), strict=True)), EffectTorque(nominal)

    def of_a_cycle() -> np.ndarray:
        torque = [law.step(Reference(q, rate, 0.0), extensor, flexor) for q, rate, extensor, flexor in rows]
        return np.interp(middles * samples, np.arange(samples + 1), [*torque, torque[0]])

    of_a_cycle()  # dry friction and play find their cycle in it
    cycles = [of_a_cycle(), of_a_cycle()]
    while np.abs(cycles[-1] - cycles[-2]).max() > SAME_TORQUE and len(cycles) < LONGEST:
        cycles.append(of_a_cycle())
    settled = cycles[-1]
    second, third = (each - settled for each in cycles[:2])
    left = float(second @ third) / float(second @ second) if len(cycles) > 2 else 0.0  # a cycle later
    if not 0.0 < left < 1.0:
        return Torque(settled, settled, None)
    settling = -1.0 / np.log(left)
    return Torque(settled, settled + second * np.exp((1.0 + middles - EARLY) / settling), settling)
