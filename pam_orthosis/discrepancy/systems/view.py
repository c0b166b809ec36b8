# SPDX-License-Identifier: Apache-2.0
"""How recordings show a machine, and what of it may be off: a view of it for the gap workflow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pam_orthosis.discrepancy.systems.suspects import Suspects
from pam_orthosis.discrepancy.systems.system import Calibration, Channel, Source
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.mechanisms.base import Mechanism
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.reach import check_lengths
from pam_orthosis.model.signals import Expression, Signals

Symbols = Mapping[str, Expression]
MOST_SUPPLY = 1.5  # of the nominal supply pressure, that a chamber can hold: beyond it the unit is another
MARGIN = 0.2  # of the range between the stops: farther out the unit or the zero is another


@dataclass(frozen=True)
class View:
    """How recordings show a machine, and what of it may be off.

    Attributes:
        title: of the system, in reports.
        equation: the mechanism's, in reports.
        channels: coordinate, whatever is measured beside, pressures in the order of the actuators.
        inputs: recorded voltage of each actuator, in their order.
        calibrations: parameters that may be off. `ACTUATOR_force` scales a static force,
            `ACTUATOR_closed_voltage` is added to a voltage, `STATE_offset` to what its sensor shows.
        multiplied: calibration -> keys of the parameters that it changes by a share.
        damped: actuators whose damping is off by a share of its own, `ACTUATOR_damping`.
        gains: observer gains of coordinate and velocity, 1/s and 1/s^2.
        added: calibration -> key of the parameter to which it is added.
        stiff: steps follow the fastest state.
        usual: sizes and places of the catalogue's effects, which are a knee's, are usual here.
        learns: effects that the model has already are recalibrated with it; delays among them, and that of
            the valves, let inputs act later.
        beside: (signals, calibrations) -> what is measured beside coordinate and pressures, by channel.
        neighbour: the coupled joint, whose angle is the last channel and drives the mechanism.
        mechanism: (parameters, calibrations) -> the mechanism, where it is not the machine's own.
        suspects: parameters that may be wrong.
        limits, unusable, sources: as for `System`.
        external: recorded effort from outside, an input beside the voltages; empty: none.
    """

    title: str
    equation: str
    channels: tuple[Channel, ...]
    inputs: tuple[str, ...]
    calibrations: tuple[Calibration, ...]
    multiplied: Mapping[str, tuple[str, ...]]
    gains: tuple[float, float]
    added: Mapping[str, str] = field(default_factory=dict)
    damped: tuple[str, ...] = ()
    stiff: bool = True
    usual: bool = True
    learns: bool = True
    beside: Callable[[Signals, Symbols], Mapping[str, Expression]] = lambda signals, symbols: {}
    neighbour: str = ""
    mechanism: Callable[[Parameters, Symbols], Mechanism] | None = None
    suspects: Suspects = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    unusable: tuple[str, ...] = ()
    sources: Mapping[str, Source] = field(default_factory=dict)
    external: str = ""


def graph_view(machine: Machine, nominal: Parameters) -> View:
    """Return how the graph records a machine, nothing being off."""
    check_lengths(machine, nominal)
    c, replay = machine.coordinate, nominal.gap.replay
    low, high = machine.mechanism(nominal).limits
    reach, supply = MARGIN * (high - low), nominal.valve.supply_pressure
    pressures, voltages = ([f"{name}_{kind}" for name in machine.names] for kind in ("pressure", "voltage"))
    lowest, highest = nominal.valve.minimum_voltage, nominal.valve.maximum_voltage
    volts = MARGIN * (highest - lowest)
    return View(
        title=machine.meaning,
        equation=c.effort,
        channels=(
            Channel(c.name, c.name, c.unit, c.shown_unit, c.shown_factor),
            *(Channel(name, name, "Pa", "mbar", 0.01) for name in pressures),
        ),
        inputs=tuple(voltages),
        calibrations=(),
        multiplied=DEVIATIONS,
        gains=(replay.angle_gain, replay.velocity_gain),
        limits={
            c.name: (low - reach, high + reach),
            **dict.fromkeys(pressures, (0.0, MOST_SUPPLY * supply)),
            **dict.fromkeys(voltages, (lowest - volts, highest + volts)),
        },
    )


def from_rows(
    nominal: Parameters, keys: Mapping[str, str], meanings: Mapping[str, str] | None = None
) -> tuple[Calibration, ...]:
    """Return calibrations (name -> key of the row with its standard deviation); with 0 they are exact."""
    found, given = [], meanings or {}
    for name, key in keys.items():
        row, sd = nominal.row(key), nominal.flat()[key]
        if sd:
            meaning = given.get(name, row.meaning)
            found.append(Calibration(name, sd, row.unit, meaning, row.unit == "-"))
    return tuple(found)
