# SPDX-License-Identifier: Apache-2.0
"""A rod with a mass, turned by a geared motor: a system of one's own for real recordings.

`pam-orthosis gap ddp.csv --held-out dircol.csv --system pendulum.py`, columns `time`, `position`, `torque`.
Values are those that the authors state for the bench (see `real/pendulum/SOURCE.txt`).
"""

import casadi as ca

from pam_orthosis.discrepancy.api import Channel, Effect, Input, Model, Parameter, Quantity, Source

MASS, LENGTH, ROD = 0.546, 0.5, 0.13  # kg, m, kg: point mass, its distance, rod and screws
ROTOR, GEAR = 6.0719e-5, 6  # kg m^2, -
GRAVITY = 9.81  # m/s^2
LATE = 0.0167  # s: by `--until check` with 0, the torque is stamped so much before it acts
INERTIA = MASS * LENGTH**2 + ROD * LENGTH**2 / 3 + ROTOR * GEAR**2
WEIGHT = (MASS + ROD / 2) * LENGTH * GRAVITY  # N m, horizontal


def equations(s, p):
    """Return the rates of the states; effects enter where a signal is assigned."""
    s.effort = s.torque - p.weight * ca.sin(s.angle) + p.torque_offset
    s.measured_angle = s.angle + p.angle_offset
    return {"angle": s.velocity, "velocity": s.effort / p.inertia}


friction = Effect(
    name="dry_friction",
    stage="effort",
    parameters=(
        Quantity("level", 0.2, "N m", 0.0, 3.0, "dry friction of motor and gear", 0.0),
        Quantity("speed", 0.1, "rad/s", 0.01, 1.0, "where it has turned round", fitted=False),
    ),
    expression=lambda s, p, own: -p.level * ca.tanh(s.velocity / p.speed),
    physics="Gear and bearings resist with a constant torque against the motion.",
    source="assumption",
)
viscous = Effect(
    name="viscous_friction",
    stage="effort",
    parameters=(Quantity("factor", 0.05, "N m s/rad", 0.0, 2.0, "viscous friction", 0.0),),
    expression=lambda s, p, own: -p.factor * s.velocity,
    physics="Bearings and air resist in proportion to the velocity.",
    source="assumption",
)
gear = Effect(
    name="gear_friction",
    stage="effort",
    parameters=(
        Quantity("share", 0.1, "-", 0.0, 0.9, "friction of the loaded teeth / torque", 0.0),
        Quantity("speed", 0.1, "rad/s", 0.01, 1.0, "where it has turned round", fitted=False),
    ),
    expression=lambda s, p, own: -p.share * ca.fabs(s.torque) * ca.tanh(s.velocity / p.speed),
    physics="Teeth that carry a torque rub the more.",
    source="assumption",
)


def system():
    """Return the pendulum as `gap` takes it."""
    return Model(
        name="motor-driven pendulum",
        channels=[Channel("angle", "angle", "rad", "deg", 57.29578)],
        inputs=[Input("torque", "N m", noise=0.01)],
        states=["angle", "velocity"],
        equations=equations,
        parameters=[
            Parameter("inertia", INERTIA, "kg m^2", 0.05 * INERTIA, "moment of inertia about the axis"),
            Parameter("weight", WEIGHT, "N m", 0.05 * WEIGHT, "torque of gravity, horizontal"),
            Parameter("torque_offset", 0.0, "N m", 0.03, "offset of the torque"),
            Parameter("angle_offset", 0.0, "rad", 0.01, "zero of the encoder"),
        ],
        effects=[friction, viscous, gear],
        gains={"angle": (20.0, 150.0)},  # 1/s, 1/s^2: upright it falls faster than weak ones follow
        late=LATE,
        sources={"angle": Source(column="position")},
    ).system()
