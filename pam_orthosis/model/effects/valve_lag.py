# SPDX-License-Identifier: Apache-2.0
"""Lag of the valve's spool behind the voltage."""

import casadi as ca

from pam_orthosis.model.effects.base import Contribution, Effect, Quantity


def _spool(position, speed, voltage, p):
    """Return the rates of a second-order lag (position in volts of its command)."""
    natural = 2 * ca.pi * p.natural_frequency
    return speed, natural**2 * (voltage - position) - 2 * p.damping_ratio * natural * speed


def _expression(s, p, states):
    """The spool's position, expressed as the voltage that it would hold, replaces the command."""
    xe, ve, xf, vf = states  # deviations from the closed position, zero at rest
    closed = s.valve.closed_voltage
    return Contribution(
        {
            "extensor_voltage": xe + closed - s.extensor_voltage,
            "flexor_voltage": xf + closed - s.flexor_voltage,
        },
        (
            *_spool(xe, ve, s.extensor_voltage - closed, p),
            *_spool(xf, vf, s.flexor_voltage - closed, p),
        ),
    )


EFFECTS = [
    Effect(
        name="valve_lag",
        stage="command",
        parameters=(
            Quantity("natural_frequency", 100.0, "Hz", 5.0, 1000.0, "natural frequency of the spool"),
            Quantity(
                "damping_ratio",
                0.8,
                "-",
                0.3,
                2.0,
                "damping ratio of the spool",
                fitted=False,
                meaningful=(0.3, 2.0),
            ),
        ),
        expression=_expression,
        physics="The spool is moved by a position loop on the valve; it follows the voltage like a damped "
        "second-order system, with a step time of about 5 ms.",
        source="valve class data: critical frequency 70 to 120 Hz",
        minimum_effect=1.0,
        starts=({"natural_frequency": 30.0}, {"natural_frequency": 12.0}),
        coordinate="extensor_voltage",
        confounded_with=("valve_delay", "hose_resistance"),
        separated_by=("diagnostic-locked",),
        fastest=lambda p: 0.16 / p.natural_frequency,
        states=("extensor_spool", "extensor_spool_speed", "flexor_spool", "flexor_spool_speed"),
        scales=(1.0, 600.0, 1.0, 600.0),
    )
]
