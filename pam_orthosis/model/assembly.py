# SPDX-License-Identifier: Apache-2.0
"""A machine as one set of equations: valves, gas, actuators, mechanism, sensors and effects.

The same assembly serves the emulated hardware, the controllers' model and the gap workflow; they
differ in parameters, in the actuators' laws and in the effects that are on.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.components.actuator import Actuator, volume_terms
from pam_orthosis.model.effects.base import ActiveEffects
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.mechanisms.base import Mechanism, acceleration
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Air, Expression, Signals


@dataclass(frozen=True)
class Hardware:
    """What an assembly is built from: a machine's parts with their parameters, and effect settings."""

    machine: Machine
    mechanism: Mechanism
    valve: Section
    actuators: Mapping[str, Actuator]
    effects: Section


@dataclass(frozen=True)
class Assembly:
    """State-space form: names, symbols and expressions (x, u -> rates, outputs)."""

    machine: Machine
    states: tuple[str, ...]
    x: ca.SX
    u: ca.SX
    rates: ca.SX
    outputs: ca.SX
    signals: Signals = field(repr=False)

    @property
    def measured(self) -> Expression:
        """What noise-free sensors would show: coordinate, pressures."""
        return ca.vertcat(self.signals.measured, *(a.measured for a in self.signals.actuators.values()))

    def function(self, name: str) -> ca.Function:
        """Return the CasADi function (x, u) -> (rates, outputs)."""
        return ca.Function(name, [self.x, self.u], [self.rates, self.outputs])


def nominal(machine: Machine, parameters: Parameters, effects: Section) -> Hardware:
    """Return a machine as its parameters describe it, with these settings of effects."""
    actuators = {one.name: one.built(parameters) for one in machine.actuators}
    return Hardware(machine, machine.mechanism(parameters), parameters.valve, actuators, effects)


def check_strokes(hardware: Hardware) -> None:
    """Refuse, by OrthosisError, cylinders shorter than the mechanism moves them between its stops."""
    machine, limits = hardware.machine, hardware.mechanism.parameters
    cylinders = [i for i, one in enumerate(machine.actuators) if one.kind == "cylinder"]
    if not cylinders:
        return
    q = ca.SX.sym("q")
    strokes = ca.Function("strokes", [q], [ca.vertcat(*hardware.mechanism.contractions(q))])
    places = 21  # between the stops at which strokes are looked at
    moved = strokes(np.linspace(limits.minimum, limits.maximum, places)[None, :]).full()
    play = 1e-6  # m, of numbers that are rounded
    for i in cylinders:
        name, most = machine.actuators[i].name, moved[i].max()
        length = hardware.actuators[name].length
        if most > length + play:
            raise OrthosisError(
                f"between the stops of the {machine.name} the stroke of {name} reaches {most:.4g} m, and its"
                f" cylinder has {length:.4g} m: mend its length or transmission"
            )


def assemble(hardware: Hardware) -> Assembly:
    """Return the equations of motion and gas with all effects that are on."""
    machine, mechanism = hardware.machine, hardware.mechanism
    effects = ActiveEffects(machine.possible | machine.tissue, hardware.effects)
    names = (*machine.states, *effects.states)
    x, u = ca.SX.sym("x", len(names)), ca.SX.sym("u", len(machine.inputs))
    effects.bind(ca.vertsplit(x)[len(machine.states) :])
    s = _signals(x, u, hardware)
    effects.stages(s, "body", "supply", "command", "spool")
    for a in s.actuators.values():
        a.opening = pneumatics.relative_opening(a.voltage, a.valve)
    effects.stages(s, "opening")
    set_flows(s)
    effects.stages(s, "flow")
    for name, a in s.actuators.items():
        law = hardware.actuators[name].volume
        a.volume, a.volume_by_pressure, a.volume_by_contraction = volume_terms(law, a.contraction, a.gauge)
    effects.stages(s, "gas")
    set_pressure_rates(s)
    effects.stages(s, "rate")
    for name, a in s.actuators.items():
        a.force = hardware.actuators[name].force(a.contraction, a.gauge)
    effects.stages(s, "force")
    for name, a in s.actuators.items():
        a.tension = hardware.actuators[name].tension(a.force, a.rate)
    s.effort = mechanism.effort(s)
    effects.stages(s, "torque")
    terms = mechanism.terms(s.coordinate, s.velocity, s.extra_mass)
    s.acceleration = ca.SX(0) if mechanism.locked else acceleration(s.effort, terms)
    s.measured = s.coordinate
    for a in s.actuators.values():
        a.measured = a.pressure + a.line_drop
    effects.stages(s, "sensor")
    rates = [s.velocity, s.acceleration, *(a.pressure_rate for a in s.actuators.values()), *effects.rates(s)]
    known = s.named(machine.coordinate.name, machine.coordinate.effort)
    outputs = ca.vertcat(*(known[name] for name in machine.outputs))
    return Assembly(machine, names, x, u, ca.vertcat(*rates), outputs, s)


def set_flows(s: Signals) -> None:
    """Set the mass flows, kg/s, that the openings pass."""
    for a in s.actuators.values():
        a.flow = pneumatics.valve_flow(a.opening, a.pressure, a.air.supply_pressure, a.valve)


def set_pressure_rates(s: Signals) -> None:
    """Set the rates of the pressures, Pa/s, from the mass flows."""
    for a in s.actuators.values():
        volume = a.volume + a.dead_volume
        slopes = a.volume_by_pressure, a.volume_by_contraction
        a.pressure_rate = pneumatics.pressure_rate(a.pressure, a.flow, a.rate, volume, *slopes, a.air)


def _signals(x: ca.SX, u: ca.SX, hardware: Hardware) -> Signals:
    machine, valve = hardware.machine, hardware.valve
    q, velocity = x[0], x[1]
    air = Air(valve.supply_pressure, valve.temperature, valve.polytropic_exponent)
    actuators = {}
    contractions = hardware.mechanism.contractions(q)
    for i, (one, contraction) in enumerate(zip(machine.actuators, contractions, strict=True)):
        actuators[one.name] = ActuatorSignals(
            voltage=u[i],
            pressure=x[2 + i],
            gauge=x[2 + i] - valve.ambient_pressure,
            contraction=contraction,
            rate=ca.jtimes(contraction, q, velocity),
            dead_volume=valve.hose.volume,
            length=hardware.actuators[one.name].length,
            valve=valve,
            air=air,
        )
    inputs = dict(zip(machine.inputs, ca.vertsplit(u), strict=True))
    carried = inputs.get("weight", 0.0)  # what hangs on it moves too
    return Signals(
        q, velocity, inputs["time"], inputs, hardware.mechanism.parameters, air, actuators, carried
    )
