# SPDX-License-Identifier: Apache-2.0
"""Dead band of the valve around its closed position."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def opened(deviation, half_width):
    """Return the deviation from the closed voltage that opens the valve: zero inside the band."""
    return ca.fmax(deviation - half_width, 0) + ca.fmin(deviation + half_width, 0)


def _expression(s, p, _states):
    closed = s.valve.closed_voltage

    def lost(voltage):
        return opened(voltage - closed, p.half_width) - (voltage - closed)

    return Contribution(
        {
            "extensor_voltage": lost(s.extensor_voltage),
            "flexor_voltage": lost(s.flexor_voltage),
        }
    )


# evaluated after the lag: the spool's edges, not its drive, have the overlap
EFFECTS = [
    Effect(
        name="valve_dead_band",
        stage="spool",
        parameters=(Quantity("half_width", 0.15, "V", 0.0, 2.0, "half width of the dead band", 0.0),),
        expression=_expression,
        physics="The lands of the spool overlap the ports: about the closed position a change of the "
        "voltage opens nothing.",
        source="published identified values 0.1 to 0.3 V",
        minimum_effect=0.005,
        starts=({"half_width": 0.03},),
        coordinate="extensor_voltage",
        confounded_with=("valve_curve_misfit", "supply_sag"),
        separated_by=("diagnostic-cocontraction",),
    )
]
