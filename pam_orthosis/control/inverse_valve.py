# SPDX-License-Identifier: Apache-2.0
"""Inverse valve model: from the wanted mass flow to the valve voltage, with dead-band compensation."""

from __future__ import annotations

import casadi as ca

from pam_orthosis.model import pneumatics
from pam_orthosis.model.compiled import compiled

# a valve behind a hose cannot pass more than the hose: beyond this share it counts as fully open
HOSE_SHARE = 0.999


def opening_for_flow(mass_flow, pressure, valve):
    """Return the relative opening that gives a mass flow at a muscle pressure: `valve_flow` inverted."""
    inflow = pneumatics.orifice_flow(1.0, valve.supply_pressure, pressure, valve)
    outflow = pneumatics.orifice_flow(1.0, pressure, valve.ambient_pressure, valve)
    least = 1.0  # kg/s per unit conductance: keeps the quotient finite at equal pressures
    fill = ca.fmax(mass_flow, 0) / ca.fmax(inflow, least)
    vent = ca.fmax(-mass_flow, 0) / ca.fmax(outflow, least)
    return _opening(fill, valve) - _opening(vent, valve)


def voltage_for_opening(opening, smoothing, valve):
    """Return the voltage of a relative opening; about zero the dead band is faded in, V."""
    above = valve.maximum_voltage - valve.closed_voltage
    below = valve.closed_voltage - valve.minimum_voltage
    span = ca.if_else(opening >= 0, above, below)
    lift = valve.dead_band * ca.tanh(opening / smoothing)
    voltage = valve.closed_voltage + span * opening + lift
    return ca.fmin(ca.fmax(voltage, valve.minimum_voltage), valve.maximum_voltage)


def voltage_function(belief) -> ca.Function:
    """Return (mass flow kg/s, absolute pressure Pa) -> voltage V."""
    flow, pressure = ca.SX.sym("flow"), ca.SX.sym("pressure")
    opening = opening_for_flow(flow, pressure, belief.valve)
    smoothing = belief.control.inverse_valve.dead_band_smoothing
    voltage = voltage_for_opening(opening, smoothing, belief.valve)
    return ca.Function("inverse_valve", [flow, pressure], [voltage])


class InverseValveModel:
    """Inverse model of one valve; knows the belief only."""

    def __init__(self, parameters):
        self._voltage = compiled(voltage_function(parameters.belief()))

    def step(self, mass_flow: float, pressure: float) -> float:
        """Return the valve voltage, V, for a mass flow, kg/s, at an absolute muscle pressure, Pa."""
        return float(self._voltage(mass_flow, pressure)[0][0])


def _opening(conductance, valve):
    """Return the opening of the valve that makes valve and hose in series this conductance."""
    possible = ca.fmin(conductance, HOSE_SHARE * valve.hose.conductance)
    alone = possible / (1 - (possible / valve.hose.conductance) ** 3) ** (1 / 3)
    return ca.fmin(alone / valve.conductance, 1)
