# SPDX-License-Identifier: Apache-2.0
"""A closed chamber that should hold its pressure: a system of one's own for real recordings.

`pam-orthosis gap first.csv --held-out later.csv --system chamber.py --columns time=t_s pressure=p_bar_gauge`
"""

import casadi as ca

from pam_orthosis.discrepancy.api import Channel, Effect, Model, Parameter, Quantity

AMBIENT, CRITICAL = 1.013e5, 0.3  # Pa; -, pressure ratio below which a sharp orifice is choked
UNIT = 1.0e5  # Pa
ZERO = 3.5e3  # Pa: what the same sensor shows in the end on the empty chamber Ultimaker_020


def equations(s, p):
    """Return the rate of the pressure; a leak enters where it is assigned, in bar/s."""
    s.loss = 0 * s.pressure
    s.measured_pressure = s.pressure + p.pressure_offset
    return {"pressure": UNIT * s.loss}


def _squares(s):
    """Return the difference of the squared pressures, bar^2, which drives a flow through pores."""
    return (s.pressure / UNIT) ** 2 - (AMBIENT / UNIT) ** 2


def _orifice(s, p, own):
    ratio = AMBIENT / s.pressure
    depth = ca.fmax(ratio - CRITICAL, 0) / (1 - CRITICAL)
    return -p.rate * s.pressure / UNIT * ca.sqrt(ca.fmax(1 - depth**2, 1e-6))


def _pores(s, p, own):
    squares = ca.fmax(_squares(s), 0)
    return -2 * squares / (p.viscous + ca.sqrt(p.viscous**2 + 4 * p.inertial * squares))


orifice = Effect(
    name="orifice",
    stage="loss",
    parameters=(Quantity("rate", 0.05, "1/s", 0.0, 2.0, "conductance of the hole over the volume", 0.0),),
    expression=_orifice,
    physics="Air leaves through a hole: choked at first, then by ISO 6358.",
    source="ISO 6358-1",
)
laminar = Effect(
    name="laminar_leak",
    stage="loss",
    parameters=(
        Quantity("rate", 0.01, "1/(bar s)", 0.0, 2.0, "conductance of the pores over the volume", 0.0),
    ),
    expression=lambda s, p, own: -p.rate * _squares(s),
    physics="Air creeps through narrow pores: by Darcy's law the flow follows the squared pressures.",
    source="Darcy's law for a gas",
)
pores = Effect(
    name="porous_leak",
    stage="loss",
    parameters=(
        Quantity("viscous", 80.0, "bar s", 1.0, 1.0e6, "resistance of the pores to a slow flow", 1.0e6),
        Quantity("inertial", 140.0, "s^2", 0.0, 1.0e6, "resistance that grows with the flow"),
    ),
    expression=_pores,
    physics="Through wider pores the flow also loses its momentum: the squared pressures are a sum of a"
    " linear and a quadratic term of the flow.",
    source="Forchheimer's equation",
)


def system():
    """Return the chamber as `gap` takes it."""
    return Model(
        name="closed chamber",
        channels=[Channel("pressure", "pressure", "Pa", "bar", 1e-5)],
        inputs=[],
        states=["pressure"],
        equations=equations,
        parameters=[Parameter("pressure_offset", ZERO, "Pa", 300.0, "zero of the sensor")],
        effects=[orifice, laminar, pores],
        gains={"pressure": (0.05,)},  # 1/s: slow, as the leak is
    ).system()
