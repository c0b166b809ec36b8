# SPDX-License-Identifier: Apache-2.0
"""Valves: how their spools follow, and what their openings pass."""

import math
from dataclasses import replace

import casadi as ca

from pam_orthosis.model.components.muscle import polynomial
from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Expression

SMALL_OPENING = 0.04  # below it the knots lie evenly, above it in equal ratios
SPACING = 0.8  # of the knots on the scale asinh(opening / SMALL_OPENING)
SIDE = 5  # knots on each side of the closed position, the last beyond the wide open valve


def knot_name(index: int) -> str:
    """Return the name of a knot, -SIDE .. SIDE."""
    return "closed" if index == 0 else f"{'fill' if index > 0 else 'vent'}_{abs(index)}"


def relative_error(opening: Expression, coefficients: list[Expression]) -> Expression:
    """Return the sum of bumps exp(-(place - knot)^2); `coefficients` from the widest vent on.

    exp(-(x - k)^2) = exp(-x^2) exp(2 x)^k exp(-k^2): one exponential for all knots, and with asinh as a
    logarithm exp(2 x) is a power of its argument.
    """
    whole = opening / SMALL_OPENING
    ratio = whole + ca.sqrt(whole**2 + 1)
    place = ca.log(ratio) / SPACING
    growth = ratio**2 * ca.sqrt(ratio)  # exp(2 place): 2 / SPACING = 2.5
    upper = _series(coefficients[SIDE:], growth)
    lower = _series(coefficients[SIDE::-1], 1 / growth)
    return ca.exp(-(place**2)) * (upper + lower - coefficients[SIDE])


def _series(coefficients: list[Expression], ratio: Expression) -> Expression:
    """Return sum c_k exp(-k^2) ratio^k, by Horner's rule."""
    return polynomial([c * math.exp(-(k**2)) for k, c in enumerate(coefficients)], ratio)


def _valve_curve_misfit(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    values = dict(p.items())
    coefficients = [values[knot_name(k)] for k in range(-SIDE, SIDE + 1)]
    return Contribution({"opening": s.opening * relative_error(s.opening, coefficients)})


def _coefficient(index: int) -> Quantity:
    place = SMALL_OPENING * math.sinh(index * SPACING)
    meaning = f"relative error of the opening about {place:+.2f}"
    q = Quantity(knot_name(index), 0.03, "-", -0.5, 0.5, meaning, 0.0, prior=0.03)
    # no valve opens as far as the last knot, of which only the flank is seen: its bound says nothing
    return replace(q, meaningful=(q.minimum, q.maximum)) if abs(index) == SIDE else q


def opened(deviation: Expression, half_width: Expression) -> Expression:
    """Return the deviation from the closed voltage that opens the valve: zero inside the band."""
    return ca.fmax(deviation - half_width, 0) + ca.fmin(deviation + half_width, 0)


def _valve_dead_band(s: ActuatorSignals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
    closed = s.valve.closed_voltage
    return Contribution({"voltage": opened(s.voltage - closed, p.half_width) - (s.voltage - closed)})


def _valve_delay(s: ActuatorSignals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """The delayed voltage replaces the voltage (states: deviations from the closed voltage)."""
    if isinstance(p.delay, float) and p.delay == 0.0:  # a divisor of the approximation
        return Contribution({}, (0.0,) * 3)
    closed = s.valve.closed_voltage
    return Contribution(
        {"voltage": pade.delayed(states) + closed - s.voltage},
        pade.chain(states, s.voltage - closed, p.delay),
    )


def _valve_lag(s: ActuatorSignals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    """The spool's position, expressed as the voltage that it would hold, replaces the command."""
    position, speed = states  # deviations from the closed position, zero at rest
    closed, natural = s.valve.closed_voltage, 2 * ca.pi * p.natural_frequency
    behind = (s.voltage - closed) - position
    push = natural**2 * behind - 2 * p.damping_ratio * natural * speed
    return Contribution({"voltage": position + closed - s.voltage}, (speed, push))


EFFECTS = [
    Effect(
        name="valve_curve_misfit",
        of="actuators",
        separate=True,
        stage="opening",
        parameters=tuple(_coefficient(index) for index in range(-SIDE, SIDE + 1)),
        expression=_valve_curve_misfit,
        physics="The opening of a valve is not proportional to the spool's stroke: edges, notches and flow "
        "forces bend the curve by some per cent, differently for filling and venting. A closed valve stays "
        "closed.",
        source="valve class data: opening about linear, smoothed at small strokes; magnitude: assumption",
        minimum_effect=0.01,
        coordinate="{actuator}_voltage",
        confounded_with=("valve_dead_band", "{actuator}_valve_gain"),
        separated_by=("diagnostic-cocontraction", "diagnostic-locked"),
        shape=True,
    ),
    # evaluated after the lag: the spool's edges, not its drive, have the overlap
    Effect(
        name="valve_dead_band",
        of="actuators",
        stage="spool",
        parameters=(Quantity("half_width", 0.15, "V", 0.0, 2.0, "half width of the dead band", 0.0),),
        expression=_valve_dead_band,
        physics="The lands of the spool overlap the ports: about the closed position a change of the "
        "voltage opens nothing.",
        source="published identified values 0.1 to 0.3 V",
        minimum_effect=0.005,
        starts=({"half_width": 0.03},),
        coordinate="{actuator}_voltage",
        confounded_with=("valve_curve_misfit", "supply_sag"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="valve_delay",
        of="actuators",
        stage="command",
        parameters=(
            Quantity("delay", 4.0e-3, "s", -0.05, 0.05, "dead time beyond the nominal one, valve.delay", 0.0),
        ),
        expression=_valve_delay,
        physics="Electronics, bus and coil answer only after a dead time. What is fitted is by how much "
        "it is longer than the nominal one (shorter, if negative). In differential equations the pure "
        "delay is represented by its Pade approximation (2, 3).",
        source="dead times of 2 to 5 ms of proportional valves (assumption)",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.2e-2}, {"delay": -2.0e-3}, {"delay": -6.0e-3}),
        coordinate="{actuator}_voltage",
        confounded_with=("valve_lag", "hose_resistance", "{actuator}_pressure_delay"),
        separated_by=("diagnostic-locked", "diagnostic-cocontraction"),
        late=lambda p: p.delay,
        states=("{actuator}_delay_a", "{actuator}_delay_b", "{actuator}_delay_c"),
        scales=(0.02,) * 3,
    ),
    Effect(
        name="{actuator}_valve_gain",
        of="actuator",
        stage="opening",
        parameters=(Quantity("gain", 0.85, "-", 0.1, 3.0, "true / nominal opening", 1.0),),
        expression=lambda s, p, _states: Contribution({"opening": (p.gain - 1) * s.opening}),
        physics="A narrow fitting, a dirty screen or another valve size: every opening of the {actuator}'s "
        "valve passes more or less air by the same factor.",
        source="ISO 6358 (sonic conductance); data sheets of the valve class state 10 %",
        minimum_effect=0.02,
        starts=({"gain": 1.15},),
        coordinate="{actuator}_voltage",
        confounded_with=("{actuator}_dead_volume", "polytropic_exponent"),
        within="valve_curve_misfit",
        separated_by=("diagnostic-locked",),
    ),
    Effect(
        name="valve_lag",
        of="actuators",
        stage="command",
        parameters=(
            Quantity("natural_frequency", 100.0, "Hz", 5.0, 1000.0, "natural frequency of the spool"),
            Quantity("damping_ratio", 0.8, "-", 0.3, 5.0, "damping ratio of the spool", fitted=False,
                     meaningful=(0.31, 5.0)),  # at 5 it is a lag of the first order
        ),
        expression=_valve_lag,
        physics="The spool is moved by a position loop on the valve; it follows the voltage like a damped "
        "second-order system, with a step time of about 5 ms.",
        source="valve class data: critical frequency 70 to 120 Hz",
        minimum_effect=1.0,
        starts=({"natural_frequency": 30.0}, {"natural_frequency": 12.0}),
        coordinate="{actuator}_voltage",
        confounded_with=("valve_delay", "hose_resistance"),
        separated_by=("diagnostic-locked",),
        lag=lambda p: p.damping_ratio / (math.pi * p.natural_frequency),
        states=("{actuator}_spool", "{actuator}_spool_speed"),
        scales=(1.0, 600.0),
    ),
]  # fmt: skip
