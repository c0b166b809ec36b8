# SPDX-License-Identifier: Apache-2.0
"""A carriage on a rail, driven by a motor: a system of one's own.

`pam-orthosis gap carriage.csv --system motor_carriage.py`, with columns `time`, `encoder_mm` and `current`.
"""

import casadi as ca

from pam_orthosis.discrepancy.api import Channel, Effect, Input, Model, Parameter, Quantity, Source

SPEEDS = 1e-4, 0.1  # m/s, ends included: a friction that turns round at once is one too


def equations(s, p):
    """Return the rates of the states; effects enter where a signal is assigned."""
    s.force = p.motor * s.current - p.damping * s.velocity
    s.measured_position = s.position + p.position_offset
    return {"position": s.velocity, "velocity": s.force / p.mass}


friction = Effect(
    name="friction",
    stage="force",
    parameters=(
        Quantity("level", 3.0, "N", 0.0, 50.0, "dry friction of the guide", 0.0),
        Quantity(
            "speed", 0.005, "m/s", *SPEEDS, "where it has turned round", fitted=False, meaningful=SPEEDS
        ),
    ),
    expression=lambda s, p, own: -p.level * ca.tanh(s.velocity / p.speed),
    physics="The guide resists with a constant force against the motion.",
    source="assumption",
)
cogging = Effect(
    name="cogging",
    stage="force",
    parameters=(
        Quantity("level", 2.0, "N", -50.0, 50.0, "largest force of the magnets", 0.0),
        Quantity("pitch", 0.06, "m", 0.01, 0.5, "distance of two poles", fitted=False),
    ),
    expression=lambda s, p, own: -p.level * ca.sin(2 * ca.pi / p.pitch * s.position),
    physics="The motor's magnets prefer some positions.",
    source="assumption",
    coordinate="position",
)


def system():
    """Return the carriage as `gap` takes it."""
    return Model(
        name="motor-driven carriage",
        channels=[Channel("position", "position", "m", "mm", 1e3)],
        inputs=[Input("current", "A", noise=0.001)],
        states=["position", "velocity"],
        equations=equations,
        parameters=[
            Parameter("mass", 2.0, "kg", 0.06, "mass of the carriage"),
            Parameter("motor", 12.0, "N/A", 0.4, "force of the motor per current"),
            Parameter("damping", 5.0, "N s/m", 1.0, "viscous friction of the guide"),
            Parameter("position_offset", 0.0, "m", 1e-4, "zero of the encoder"),
        ],
        effects=[friction, cogging],
        sources={"position": Source(column="encoder_mm", factor=1e-3)},
    ).system()
