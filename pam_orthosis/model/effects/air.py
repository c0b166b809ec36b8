# SPDX-License-Identifier: Apache-2.0
"""Air: where it is lost, what holds it back, and its state."""

import casadi as ca

from pam_orthosis.model.components import pneumatics
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Expression, Signals

LEAK_AT = 3.0e5  # Pa gauge, where a gap and a hole pass the same
HOSE_AT = 2.0e-3  # kg/s, about 100 l/min of free air, where a laminar and a turbulent drop are the same
SECANTS, NO_FLOW = 2, 1e-9  # steps; kg/s


def throttled(s: ActuatorSignals, resistance: Expression, turbulent: Expression) -> Expression:
    """Return the flow m that fulfils m = flow(p + drop(m)), by secants from no flow to the last guess."""
    pressure = ca.SX.sym("p")
    flow = pneumatics.valve_flow(s.opening, pressure, s.air.supply_pressure, s.valve)
    guess = s.flow
    for _ in range(SECANTS):
        behind = s.pressure + _drop(guess, resistance, turbulent)
        wrong = ca.substitute(flow, pressure, behind) - guess
        guess /= 1 - wrong * s.flow / (s.flow**2 + NO_FLOW**2)
    return guess


def _drop(flow: Expression, resistance: Expression, turbulent: Expression) -> Expression:
    return resistance * flow * (1 - turbulent + turbulent * ca.fabs(flow) / HOSE_AT)


def _hose_resistance(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """The hose throttles the flow, and the sensor at its valve end reads p + drop(m)."""
    flow = throttled(s, p.resistance, p.turbulent)
    return Contribution({"flow": flow - s.flow, "line_drop": _drop(flow, p.resistance, p.turbulent)})


def _leak(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    """Through a gap and a hole that pass as much as each other at the gauge pressure of LEAK_AT."""
    ambient = s.valve.ambient_pressure
    hole = pneumatics.orifice_flow(1.0, s.pressure, ambient, s.valve)
    hole *= LEAK_AT / pneumatics.orifice_flow(1.0, ambient + LEAK_AT, ambient, s.valve)
    return Contribution({"flow": -p.coefficient * ((1 - p.hole) * s.gauge + p.hole * hole)})


def _supply_sag(_s: Signals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """The state is the sag, Pa; it follows the flow drawn by all valves, which later stages know."""
    (sag,) = states

    def rates(s: Signals) -> tuple[Expression, ...]:
        drawn = sum(ca.fmax(one.flow, 0) for one in s.actuators.values())
        return ((p.resistance * drawn - sag) / p.time_constant,)

    return Contribution({"supply_pressure": -sag}, rates)


EFFECTS = [
    Effect(
        name="{actuator}_dead_volume",
        of="actuator",
        stage="gas",
        parameters=(Quantity("volume", 3.0e-5, "m^3", -2.5e-5, 1.0e-3, "additional dead volume", 0.0),),
        expression=lambda _s, p, _states: Contribution({"dead_volume": p.volume}),
        physics="A longer hose, a fitting or a sensor cavity at the {actuator}: the same air changes the "
        "pressure less, and the muscle becomes a softer gas spring.",
        source="1 m of hose of 4 mm bore holds 12.6 cm^3, of 6 mm bore 28 cm^3",
        minimum_effect=1.2e-5,
        starts=({"volume": -1.0e-5},),
        coordinate="{actuator}_contraction",
        confounded_with=("{actuator}_valve_gain", "polytropic_exponent"),
        within="volume_misfit",
        separated_by=("diagnostic-locked", "diagnostic-decay"),
    ),
    Effect(
        name="hose_resistance",
        of="actuators",
        stage="flow",
        parameters=(
            Quantity("resistance", 1.5e6, "Pa s/kg", 0.0, 1.0e8, "pressure drop per mass flow at 2 g/s", 0.0),
            Quantity("turbulent", 0.0, "-", 0.0, 1.0, "share of that drop that grows with the flow's square",
                     fitted=False, meaningful=(0.0, 1.0)),
        ),
        expression=_hose_resistance,
        physics="A long, thin or kinked hose drops pressure: in proportion to the flow where it is laminar, "
        "with its square where it is turbulent. The sensor sits at the valve: while air flows, it reads "
        "more or less than the muscle has.",
        source="hose formula of ISO 6358 linearised: 1 m of 4 mm bore about 0.01 bar/(g/s) (assumption)",
        minimum_effect=1.0e5,
        coordinate="{actuator}_flow",
        confounded_with=("valve_delay", "valve_lag", "{actuator}_pressure_delay"),
        separated_by=("diagnostic-cocontraction", "diagnostic-locked"),
    ),
    Effect(
        name="{actuator}_leak",
        of="actuator",
        stage="flow",
        parameters=(
            Quantity("coefficient", 1.0e-10, "kg/(s Pa)", 0.0, 2.0e-8, "flow over gauge pressure", 0.0),
            Quantity("hole", 0.0, "-", 0.0, 1.0, "share of it through a hole, the rest through a narrow gap",
                     fitted=False, meaningful=(0.0, 1.0)),
        ),
        expression=_leak,
        physics="A fitting or a crack of the {actuator} loses air, the more the higher the pressure: a "
        "narrow gap in proportion, as its flow is laminar, a hole as an orifice.",
        source="measured decay of a closed muscle: 200 s with a bad fitting, 5000 s when tight; ISO 6358",
        minimum_effect=1.0e-12,
        coordinate="{actuator}_pressure",
        confounded_with=("valve_dead_band", "{actuator}_pressure_gain"),
        separated_by=("diagnostic-hold",),
    ),
    Effect(
        name="polytropic_exponent",
        of="air",
        stage="gas",
        parameters=(
            Quantity("shift", 0.1, "-", -0.2, 0.4, "true - nominal exponent of Eq. (3)", 0.0),
        ),
        expression=lambda _s, p, _states: Contribution({"polytropic_exponent": p.shift}),
        physics="Heat exchange with rubber and fittings decides where the gas lies between isothermal "
        "(n = 1) and adiabatic (n = 1.4): small chambers and slow strokes are nearer to isothermal.",
        source="paper, Eq. (3); published values 1.0 to 1.4, charging above discharging",
        minimum_effect=0.02,
        starts=({"shift": -0.08},),
        coordinate="{actuator}_pressure",
        confounded_with=("{actuator}_dead_volume", "{actuator}_valve_gain"),
        separated_by=("diagnostic-decay", "diagnostic-locked"),
    ),
    Effect(
        name="supply_sag",
        of="air",
        stage="supply",
        parameters=(
            Quantity("resistance", 2.0e7, "Pa s/kg", 0.0, 1.0e9, "sag per mass flow drawn", 0.0),
            Quantity("time_constant", 0.05, "s", 0.002, 20.0, "time constant of the supply line",
                     meaningful=(0.002, 10.0)),  # slower, the supply falls and does not recover
        ),
        expression=_supply_sag,
        physics="Regulator, line and reservoir cannot hold the pressure while both valves draw air; it "
        "falls in proportion to the flow and recovers.",
        source="measured: 5.65 to 5.11 bar over repeated cycles of a muscle rig",
        minimum_effect=1.0e6,
        starts=({"time_constant": 0.01}, {"time_constant": 0.5}),
        coordinate="{actuator}_flow",
        confounded_with=("valve_dead_band", "valve_curve_misfit"),
        separated_by=("diagnostic-cocontraction",),
        states=("supply_sag",),
        scales=(1.0e4,),
    ),
    Effect(
        name="temperature_drift",
        of="air",
        stage="gas",
        parameters=(
            Quantity("rise", 15.0, "K", -60.0, 80.0, "final rise of the gas temperature", 0.0),
            Quantity("time_constant", 20.0, "s", 0.5, 3600.0, "time constant of the warming"),
        ),
        expression=lambda s, p, _states: Contribution(
            {"temperature": p.rise * (1 - ca.exp(-s.time / p.time_constant))}
        ),
        physics="Cyclic work and friction warm muscle and hose from the first stroke on, and so the air "
        "that comes in: the same mass flow then raises the pressure more, Eq. (6). Enclosed air is not.",
        source="a muscle warms by 10 to 20 K in cyclic work (assumption)",
        minimum_effect=2.0,
        starts=({"rise": -15.0}, {"time_constant": 100.0}),
        coordinate="time",
        confounded_with=("{actuator}_valve_gain",),
        separated_by=("diagnostic-locked",),
    ),
]  # fmt: skip
