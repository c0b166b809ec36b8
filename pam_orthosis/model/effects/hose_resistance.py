# SPDX-License-Identifier: Apache-2.0
"""Resistance of the hoses between valves and muscles, with the pressure sensors at the valves."""

import casadi as ca

from pam_orthosis.model import pneumatics
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def throttled(s, muscle: str, resistance):
    """Return the flow m that fulfils m = flow(p + R m), by one Newton step from the flow without hose."""
    pressure = ca.SX.sym("p")
    flow = pneumatics.valve_flow(getattr(s, f"{muscle}_opening"), pressure, s.supply_pressure, s.valve)
    slope = ca.substitute(ca.gradient(flow, pressure), pressure, getattr(s, f"{muscle}_pressure"))
    return getattr(s, f"{muscle}_flow") / (1 - resistance * slope)


def _expression(s, p, _states):
    """The hose throttles the flow, and the sensor at its valve end reads p + R m."""
    added = {}
    for muscle in ("extensor", "flexor"):
        flow = throttled(s, muscle, p.resistance)
        added[f"{muscle}_flow"] = flow - getattr(s, f"{muscle}_flow")
        added[f"{muscle}_line_drop"] = p.resistance * flow
    return Contribution(added)


EFFECTS = [
    Effect(
        name="hose_resistance",
        stage="flow",
        parameters=(
            Quantity("resistance", 1.5e6, "Pa s/kg", 0.0, 1.0e8, "pressure drop per mass flow", 0.0),
        ),
        expression=_expression,
        physics="A long, thin or kinked hose drops pressure in proportion to the flow. The sensor sits at "
        "the valve: while air flows, it reads more or less than the muscle has.",
        source="hose formula of ISO 6358 linearised: 1 m of 4 mm bore about 0.01 bar/(g/s) (assumption)",
        minimum_effect=1.0e5,
        coordinate="extensor_flow",
        confounded_with=("valve_delay", "valve_lag", "extensor_pressure_delay", "flexor_pressure_delay"),
        separated_by=("diagnostic-cocontraction", "diagnostic-locked"),
    )
]
