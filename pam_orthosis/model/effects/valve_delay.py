# SPDX-License-Identifier: Apache-2.0
"""Dead time between the voltage and the spool of both valves, beside the one that the model has already."""

from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _expression(s, p, states):
    """The delayed voltage replaces the voltage (states: deviations from the closed voltage)."""
    if isinstance(p.delay, float) and p.delay == 0.0:  # a divisor of the approximation
        return Contribution({}, (0.0,) * 6)
    extensor, flexor, closed = states[:3], states[3:], s.valve.closed_voltage
    return Contribution(
        {
            "extensor_voltage": pade.delayed(extensor) + closed - s.extensor_voltage,
            "flexor_voltage": pade.delayed(flexor) + closed - s.flexor_voltage,
        },
        (
            *pade.chain(extensor, s.extensor_voltage - closed, p.delay),
            *pade.chain(flexor, s.flexor_voltage - closed, p.delay),
        ),
    )


EFFECTS = [
    Effect(
        name="valve_delay",
        stage="command",
        parameters=(
            Quantity("delay", 4.0e-3, "s", -0.05, 0.05, "dead time beyond the nominal one, valve.delay", 0.0),
        ),
        expression=_expression,
        physics="Electronics, bus and coil answer only after a dead time. What is fitted is by how much "
        "it is longer than the nominal one (shorter, if negative). In differential equations the pure "
        "delay is represented by its Pade approximation (2, 3).",
        source="dead times of 2 to 5 ms of proportional valves (assumption)",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.2e-2}, {"delay": -2.0e-3}, {"delay": -6.0e-3}),
        coordinate="extensor_voltage",
        confounded_with=("valve_lag", "hose_resistance", "extensor_pressure_delay", "flexor_pressure_delay"),
        separated_by=("diagnostic-locked", "diagnostic-cocontraction"),
        late=lambda p: p.delay,
        fastest=lambda p: 0.24 * p.delay,
        states=tuple(f"{muscle}_delay_{k}" for muscle in ("extensor", "flexor") for k in "abc"),
        scales=(0.02,) * 6,
    )
]
