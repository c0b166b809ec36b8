# SPDX-License-Identifier: Apache-2.0
"""Signals of a machine: expressions of its states and inputs, in SI units, set stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any, TypeAlias

from pam_orthosis.model.rows import Section

Expression: TypeAlias = Any  # of CasADi (which has no types), or a number


@dataclass
class Air:
    """What all chambers of a machine share: supply pressure, gas temperature, polytropic exponent."""

    supply_pressure: Expression
    temperature: Expression
    polytropic_exponent: Expression


@dataclass
class ActuatorSignals:
    """Signals of one actuator with its chamber, valve and pressure sensor.

    A contraction is the displacement in which the chamber does work: a muscle's shortening, a cylinder's
    stroke. `gauge` is the pressure above the ambient, `length` the nominal length.
    """

    voltage: Expression
    pressure: Expression
    gauge: Expression
    contraction: Expression
    rate: Expression
    dead_volume: Expression
    length: Expression
    valve: Section
    air: Air
    line_drop: Expression = 0.0
    opening: Expression = field(init=False)
    flow: Expression = field(init=False)
    volume: Expression = field(init=False)
    volume_by_pressure: Expression = field(init=False)
    volume_by_contraction: Expression = field(init=False)
    pressure_rate: Expression = field(init=False)
    force: Expression = field(init=False)
    tension: Expression = field(init=False)
    measured: Expression = field(init=False)


@dataclass
class Signals:
    """Signals of a machine.

    `external` holds the inputs of the mechanism by name, `parameters` its section; `extra_mass` is what an
    effect adds to the load, kg; `effort` is the sum of the forces or torques on the coordinate.
    """

    coordinate: Expression
    velocity: Expression
    time: Expression
    external: Mapping[str, Expression]
    parameters: Section
    air: Air
    actuators: dict[str, ActuatorSignals]
    extra_mass: Expression = 0.0
    effort: Expression = field(init=False)
    acceleration: Expression = field(init=False)
    measured: Expression = field(init=False)

    def copy(self) -> Signals:
        """Return signals that can be set anew without changing these."""
        same = copy(self)
        same.air = copy(self.air)
        same.actuators = {name: copy(one) for name, one in self.actuators.items()}
        for one in same.actuators.values():
            one.air = same.air
        return same

    def named(self, coordinate: str, effort: str) -> dict[str, Expression]:
        """Return all signals by the names that outputs and effects have for them."""
        own = {
            coordinate: self.coordinate, effort: self.effort, f"measured_{coordinate}": self.measured,
            "velocity": self.velocity, "acceleration": self.acceleration, "time": self.time,
        }  # fmt: skip
        for name, one in self.actuators.items():
            own |= {f"{name}_{f.name}": getattr(one, f.name) for f in fields(one)}
            own[f"measured_{name}_pressure"] = own.pop(f"{name}_measured")
        return own
