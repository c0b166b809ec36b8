# SPDX-License-Identifier: Apache-2.0
"""Inverse valve model: from the wanted mass flow to the valve voltage, with dead-band compensation."""

import casadi as ca
import numpy as np

from pam_orthosis.control import effects
from pam_orthosis.control.effects import Sensors
from pam_orthosis.model.compiled import Compiled, compiled
from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Expression


def opening_for_flow(mass_flow: Expression, pressure: Expression, valve: Section) -> Expression:
    """Return the relative opening that gives a mass flow at a chamber's pressure: `valve_flow` inverted."""
    inflow = pneumatics.orifice_flow(1.0, valve.supply_pressure, pressure, valve)
    outflow = pneumatics.orifice_flow(1.0, pressure, valve.ambient_pressure, valve)
    least = 1.0  # kg/s per unit conductance: keeps the quotient finite at equal pressures
    fill = ca.fmax(mass_flow, 0) / ca.fmax(inflow, least)
    vent = ca.fmax(-mass_flow, 0) / ca.fmax(outflow, least)
    return _opening(fill, valve) - _opening(vent, valve)


def voltage_for_opening(
    opening: Expression, smoothing: Expression, dead_band: Expression, valve: Section
) -> Expression:
    """Return the voltage of a relative opening; about zero the dead band is faded in, V."""
    above = valve.maximum_voltage - valve.closed_voltage
    below = valve.closed_voltage - valve.minimum_voltage
    span = ca.if_else(opening >= 0, above, below)
    lift = dead_band * ca.tanh(opening / smoothing)
    voltage = valve.closed_voltage + span * opening + lift
    return ca.fmin(ca.fmax(voltage, valve.minimum_voltage), valve.maximum_voltage)


def voltage_function(nominal: Parameters, actuator: str) -> ca.Function:
    """Return (mass flow kg/s, absolute and supply pressure Pa) -> voltage V, the nominal effects inverted.

    Effects on opening and flow (gain, curve, leak, hose) are met by correcting the flow that is asked of
    the plain valve; the half width of a nominal dead band replaces `valve.dead_band`.
    """
    flow, pressure, supply = (ca.SX.sym(name) for name in ("flow", "pressure", "supply"))
    opening = opening_with_effects(flow, pressure, supply, nominal, actuator)
    smoothing = nominal.control.inverse_valve.dead_band_smoothing
    voltage = voltage_for_opening(opening, smoothing, dead_band(nominal), nominal.valve)
    return ca.Function(f"{actuator}_inverse_valve", [flow, pressure, supply], [voltage])


def opening_with_effects(
    mass_flow: Expression, pressure: Expression, supply: Expression, nominal: Parameters, actuator: str
) -> Expression:
    """Return the relative opening that gives a mass flow through valve, hose and the nominal effects."""
    valve = nominal.substituted({"valve.supply_pressure": supply}).valve

    def plain(flow: Expression) -> Expression:
        return opening_for_flow(flow, pressure, valve)

    if not effects.known(nominal, "opening", "flow"):
        return plain(mass_flow)
    passed = effects.flow_of_opening(nominal, actuator)
    return effects.corrected(plain, lambda opening: passed(opening, pressure, supply), mass_flow)


def dead_band(nominal: Parameters) -> float:
    """Return the half width of the dead band to compensate, V: learned, or `valve.dead_band`."""
    known: float = nominal.valve.dead_band
    if "valve_dead_band" in effects.known(nominal, "spool"):
        known = effects.values(nominal, "valve_dead_band").half_width
    return known


class InverseValveModel:
    """Inverse model of the valve of an actuator; knows the nominal model only."""

    def __init__(self, parameters: Parameters, actuator: str):
        nominal = parameters.nominal()
        self._voltage = compiled(voltage_function(nominal, actuator))
        self._sensors, self._channel = Sensors(nominal), f"{actuator}_pressure"
        self._supply: float = nominal.valve.supply_pressure
        after = effects.supply_after(nominal, actuator)
        self._after = None if after is None else compiled(after)
        self._drawn = np.zeros(0 if after is None else after.size1_in(0))
        self._asked: float | None = None

    def step(self, mass_flow: float, pressure: float, periods: int = 1) -> float:
        """Return the valve voltage, V, for a mass flow, kg/s, at an absolute pressure, Pa.

        The sample is so many control periods later than the last one. A supply that sags in the nominal model
        does so by the flows that were asked for: it is in no loop.
        """
        if self._after is not None and self._asked is not None:
            self._draw(self._after, self._asked, periods)
        pressure = self._sensors.true(self._channel, pressure)
        voltage = float(self._voltage(mass_flow, pressure, self._supply)[0][0])
        self._asked = mass_flow
        return voltage

    def _draw(self, after: Compiled, asked: float, periods: int) -> None:
        """Let the supply sag by the flow that was asked for last, so long ago."""
        for _ in range(periods):
            self._drawn[:], supply = after(self._drawn, asked)
            self._supply = float(supply[0])


def _opening(conductance: Expression, valve: Section) -> Expression:
    """Return the opening of the valve that makes valve and hose in series this conductance."""
    # a valve behind a hose cannot pass more than the hose: beyond this share it counts as fully open
    hose_share = 0.999
    possible = ca.fmin(conductance, hose_share * valve.hose.conductance)
    alone = possible / (1 - (possible / valve.hose.conductance) ** 3) ** (1 / 3)
    return ca.fmin(alone / valve.conductance, 1)
