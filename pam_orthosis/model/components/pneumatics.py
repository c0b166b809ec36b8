# SPDX-License-Identifier: Apache-2.0
"""Gas in a chamber and its proportional valve. Pressures absolute, Pa; mass flows inwards, kg/s."""

import casadi as ca

from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import Air, Expression

GAS_CONSTANT = 287.06  # J/(kg K), dry air


def pressure_rate(
    pressure: Expression,
    mass_flow: Expression,
    contraction_rate: Expression,
    volume: Expression,
    volume_by_pressure: Expression,
    volume_by_contraction: Expression,
    gas: Section | Air,
) -> Expression:
    """Return dp/dt of Eq. (6), Pa/s: with Eq. (5) the total derivative, Eq. (4), of the polytropic Eq. (3).

    `volume_by_contraction * contraction_rate` is the paper's dV/d(dL) d(dL)/dx_S x_S-dot.
    """
    n = gas.polytropic_exponent
    supplied = GAS_CONSTANT * gas.temperature * mass_flow
    displaced = volume_by_contraction * contraction_rate * pressure
    return n / (volume + n * volume_by_pressure * pressure) * (supplied - displaced)


def required_mass_flow(
    pressure: Expression,
    rate: Expression,
    contraction_rate: Expression,
    volume: Expression,
    volume_by_pressure: Expression,
    volume_by_contraction: Expression,
    gas: Section | Air,
) -> Expression:
    """Return the mass flow that gives a pressure rate: Eq. (6) solved for the flow, kg/s."""
    n = gas.polytropic_exponent
    stored = rate * (volume + n * volume_by_pressure * pressure) / n
    displaced = volume_by_contraction * contraction_rate * pressure
    return (stored + displaced) / (GAS_CONSTANT * gas.temperature)


def flow_function(ratio: Expression, critical_ratio: Expression) -> Expression:
    """Return the ISO 6358 flow function psi of the ratio downstream / upstream: 1 when choked."""
    # above this pressure ratio the flow is taken as laminar (linear): the exact law has an infinite slope
    laminar_ratio = 0.995
    r = ca.fmin(ratio, laminar_ratio)
    depth = ca.fmax(r - critical_ratio, 0) / (1 - critical_ratio)
    subsonic = ca.sqrt(1 - depth**2)
    return subsonic * ca.fmin((1 - ratio) / (1 - laminar_ratio), 1)


def orifice_flow(
    conductance: Expression, upstream: Expression, downstream: Expression, valve: Section
) -> Expression:
    """Return the mass flow from upstream to downstream by ISO 6358, kg/s; negative if it reverses.

    `conductance` is the sonic conductance C in m^3/(s Pa).
    """
    high, low = ca.fmax(upstream, downstream), ca.fmin(upstream, downstream)
    psi = flow_function(low / high, valve.critical_ratio)
    reference_temperature = 293.15  # K, ISO 6358 reference atmosphere
    heat = ca.sqrt(reference_temperature / valve.temperature)
    reference_density = 1.185  # kg/m^3, ISO 6358 reference atmosphere
    return ca.sign(upstream - downstream) * conductance * reference_density * high * heat * psi


def relative_opening(voltage: Expression, valve: Section) -> Expression:
    """Return the spool's relative opening, -1 (vent) .. 0 (closed) .. 1 (fill)."""
    above = (voltage - valve.closed_voltage) / (valve.maximum_voltage - valve.closed_voltage)
    below = (voltage - valve.closed_voltage) / (valve.closed_voltage - valve.minimum_voltage)
    return ca.fmin(ca.fmax(ca.if_else(voltage >= valve.closed_voltage, above, below), -1), 1)


def series_conductance(first: Expression, second: Expression) -> Expression:
    """Return the sonic conductance of two restrictions in series, 1/C^3 = 1/C1^3 + 1/C2^3."""
    small = 1e-30  # a closed valve has conductance zero: keeps the quotient finite
    return first * second / (first**3 + second**3 + small**3) ** (1 / 3)


def valve_flow(
    opening: Expression, pressure: Expression, supply_pressure: Expression, valve: Section
) -> Expression:
    """Return the mass flow into a muscle through valve and hose at a relative opening, kg/s."""
    fill = series_conductance(ca.fmax(opening, 0) * valve.conductance, valve.hose.conductance)
    vent = series_conductance(ca.fmax(-opening, 0) * valve.conductance, valve.hose.conductance)
    return orifice_flow(fill, supply_pressure, pressure, valve) - orifice_flow(
        vent, pressure, valve.ambient_pressure, valve
    )
