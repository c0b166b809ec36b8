# SPDX-License-Identifier: Apache-2.0
"""The boxes in which the maps of a machine's muscles were identified: beyond, they are held at the edge."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from pam_orthosis.model.machine import ActuatorOf, Machine
from pam_orthosis.model.parameters import Parameters

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.systems.system import Channel


@dataclass(frozen=True)
class Box:
    """One side of a box: the values of a quantity, from `low` to `high`, that a map knows.

    `channel`: that shows the quantity, by `quantity`; `report_unit`, `report_factor` as those of channels.
    """

    name: str
    channel: str
    low: float
    high: float
    report_unit: str
    report_factor: float
    quantity: Callable[[np.ndarray], np.ndarray]


def boxes(machine: Machine, nominal: Parameters, channels: Sequence[Channel]) -> Iterator[Box]:
    """Yield the sides of the boxes of a machine's muscles."""
    by_state, q = {one.state: one for one in channels}, ca.SX.sym("q")
    contractions = machine.mechanism(nominal).contractions(q)
    for one, contraction in zip(machine.actuators, contractions, strict=True):
        if one.kind == "muscle":
            yield _of_pressure(one, nominal, by_state[f"{one.name}_pressure"])
            shown = by_state[machine.coordinate.name].name
            yield _of_contraction(one, nominal, shown, ca.Function("contraction", [q], [contraction]))


def _of_pressure(one: ActuatorOf, nominal: Parameters, channel: Channel) -> Box:
    box, ambient = nominal.at(one.parameters).box, nominal.valve.ambient_pressure
    low, high = ambient + box.minimum_pressure_gauge, ambient + box.maximum_pressure_gauge
    name = channel.name
    return Box(name, name, low, high, channel.report_unit, channel.report_factor, lambda values: values)


def _of_contraction(one: ActuatorOf, nominal: Parameters, channel: str, law: ca.Function) -> Box:
    muscle = nominal.at(one.parameters)
    low, high = muscle.box.minimum_contraction, muscle.box.maximum_contraction
    scale = muscle.length / muscle.map_length

    def contraction(values: np.ndarray) -> np.ndarray:
        shown: np.ndarray = law(values[None, :]).full()[0]
        return shown

    return Box(f"{one.name} contraction", channel, scale * low, scale * high, "mm", 1e3, contraction)
