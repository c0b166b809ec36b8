# SPDX-License-Identifier: Apache-2.0
"""What sensors show that is not so: gains, offsets, delays."""

from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Expression


def _pressure_delay(s: ActuatorSignals, p: Section, states: tuple[Expression, ...]) -> Contribution:
    a, b, c = states
    seen = a, b, c + s.line_drop / p.delay  # its rate is not known: it enters the chain as a step does
    return Contribution({"measured": -pade.lost(seen, p.delay)}, pade.chain(seen, s.pressure_rate, p.delay))


EFFECTS = [
    Effect(
        name="angle_delay",
        of="rotation",
        stage="sensor",
        parameters=(Quantity("delay", 3.0e-3, "s", 5.0e-4, 0.05, "age of the value"),),
        expression=lambda s, p, states: Contribution(
            {"measured": -pade.lost(states, p.delay)}, pade.chain(states, s.velocity, p.delay)
        ),
        physics="Filter, bus or driver deliver the angle late; the pure delay is represented by its Pade "
        "approximation (2, 3), driven by the velocity.",
        source="assumption, 1 to 10 ms",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.0e-2}),
        confounded_with=("{actuator}_pressure_delay",),
        separated_by=("diagnostic-locked", "diagnostic-hold"),
        advance=lambda p: {"angle": p.delay},
        states=("angle_delay_a", "angle_delay_b", "angle_delay_c"),
        scales=(0.05, 0.05, 0.05),
    ),
    Effect(
        name="angle_gain",
        of="rotation",
        stage="sensor",
        parameters=(Quantity("gain", 1.02, "-", 0.5, 1.5, "measured / true angle", 1.0),),
        expression=lambda s, p, _states: Contribution({"measured": (p.gain - 1) * s.measured}),
        physics="A gear or a lever between joint and encoder, or a potentiometer's slope, is a little off.",
        source="assumption, 1 to 3 %",
        minimum_effect=3.0e-3,
        starts=({"gain": 0.98},),
        coordinate="angle",
        confounded_with=("parallel_elasticity", "angle_offset"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="angle_offset",
        of="rotation",
        stage="sensor",
        parameters=(Quantity("offset", 0.02, "rad", -0.5, 0.5, "measured - true angle", 0.0),),
        expression=lambda _s, p, _states: Contribution({"measured": p.offset}),
        physics="The encoder's zero was set at another angle than the straight leg: force, inertia and "
        "gravity are all taken at a wrong angle.",
        source="assumption, 0.5 to 3 degrees of mounting error",
        minimum_effect=2.0e-3,
        starts=({"offset": -0.02},),
        coordinate="angle",
        confounded_with=("constant_torque", "parallel_elasticity"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="{actuator}_pressure_delay",
        of="actuator",
        stage="sensor",
        parameters=(Quantity("delay", 3.0e-3, "s", 5.0e-4, 0.05, "age of the value"),),
        expression=_pressure_delay,
        physics="Damping screen, filter or bus deliver the {actuator}'s pressure late; the pure delay is "
        "represented by its Pade approximation (2, 3), driven by the pressure's rate.",
        source="1 to 2 ms lag of the sensor class; more with filters (assumption)",
        minimum_effect=3.0e-4,
        starts=({"delay": 1.0e-3}, {"delay": 1.0e-2}),
        coordinate="{actuator}_pressure_rate",
        confounded_with=("valve_delay", "hose_resistance", "angle_delay"),
        separated_by=("diagnostic-locked", "diagnostic-cocontraction"),
        advance=lambda p: {"{actuator}_pressure": p.delay},
        states=tuple(f"{{actuator}}_pressure_delay_{k}" for k in "abc"),
        scales=(1.0e4,) * 3,
    ),
    Effect(
        name="{actuator}_pressure_gain",
        of="actuator",
        stage="sensor",
        parameters=(Quantity("gain", 1.03, "-", 0.5, 1.5, "measured / true gauge pressure", 1.0),),
        expression=lambda s, p, _states: Contribution({"measured": (p.gain - 1) * s.gauge}),
        physics="The slope of the {actuator}'s pressure sensor is off by some per cent; at gauge "
        "pressure zero it is right.",
        source="data sheets of 10 bar sensors: 0.5 to 1 %; a wrong range or amplifier: more",
        minimum_effect=5.0e-3,
        starts=({"gain": 0.97},),
        coordinate="{actuator}_pressure",
        confounded_with=("{actuator}_force_scale", "{actuator}_pressure_offset"),
        separated_by=("diagnostic-cocontraction",),
    ),
    Effect(
        name="{actuator}_pressure_offset",
        of="actuator",
        stage="sensor",
        parameters=(Quantity("offset", 8.0e3, "Pa", -1.0e5, 1.0e5, "measured - true pressure", 0.0),),
        expression=lambda _s, p, _states: Contribution({"measured": p.offset}),
        physics="The zero of the {actuator}'s pressure sensor has drifted, by temperature or "
        "because it was set at another barometric pressure.",
        source="data sheets of 10 bar sensors: 0.5 to 1 % of the span",
        minimum_effect=1.0e3,
        starts=({"offset": -8.0e3},),
        coordinate="{actuator}_pressure",
        confounded_with=("constant_torque", "{actuator}_pressure_gain"),
        separated_by=("diagnostic-cocontraction", "diagnostic-hold"),
    ),
]  # fmt: skip
