# SPDX-License-Identifier: Apache-2.0
"""Supply pressure that sags when air is drawn."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(_s, p, states):
    """The state is the sag, Pa; it follows the flow drawn by both valves, which later stages know."""
    (sag,) = states

    def rates(s):
        drawn = ca.fmax(s.extensor_flow, 0) + ca.fmax(s.flexor_flow, 0)
        return ((p.resistance * drawn - sag) / p.time_constant,)

    return Contribution({"supply_pressure": -sag}, rates)


EFFECTS = [
    Effect(
        name="supply_sag",
        stage="supply",
        parameters=(
            Quantity("resistance", 2.0e7, "Pa s/kg", 0.0, 1.0e9, "sag per mass flow drawn", 0.0),
            Quantity(
                "time_constant",
                0.05,
                "s",
                0.002,
                20.0,
                "time constant of the supply line",
                meaningful=(0.002, 10.0),  # slower, the supply falls and does not recover
            ),
        ),
        expression=_expression,
        physics="Regulator, line and reservoir cannot hold the pressure while both valves draw air; it "
        "falls in proportion to the flow and recovers.",
        source="measured: 5.65 to 5.11 bar over repeated cycles of a muscle rig",
        minimum_effect=1.0e6,
        starts=({"time_constant": 0.01}, {"time_constant": 0.5}),
        coordinate="extensor_flow",
        confounded_with=("valve_dead_band", "valve_curve_misfit"),
        separated_by=("diagnostic-cocontraction",),
        fastest=lambda p: p.time_constant,
        states=("supply_sag",),
        scales=(1.0e4,),
    )
]
