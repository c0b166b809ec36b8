# SPDX-License-Identifier: Apache-2.0
"""Rules between parameters that no single bound can express."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Any

# each chain must be strictly increasing
ORDERED = (
    ("valve.ambient_pressure", "control.position.minimum_pressure", "control.position.mean_pressure",
     "control.position.maximum_pressure", "valve.supply_pressure"),
    ("valve.minimum_voltage", "valve.closed_voltage", "valve.maximum_voltage"),
    ("leg.joint.minimum", "leg.joint.maximum"),
)  # fmt: skip


def broken_rules(values: Mapping[str, Any]) -> Iterator[str]:
    """Yield one sentence for each broken rule among the values that are there."""
    for chain in ORDERED:
        known = [key for key in chain if key in values]
        for low, high in pairwise(known):
            if not values[low] < values[high]:
                yield f"{low} = {values[low]} must be below {high} = {values[high]}"
    yield from _period_rule(values)


def _period_rule(values: Mapping[str, Any]) -> Iterator[str]:
    period, step = values.get("scenario.control_period"), values.get("plant.simulation.step")
    if period is None or step is None:
        return
    ratio = period / step
    if abs(ratio - round(ratio)) > 1e-9 * ratio or round(ratio) < 1:
        yield (
            f"scenario.control_period = {period} s must be a whole multiple of"
            f" plant.simulation.step = {step} s"
        )
