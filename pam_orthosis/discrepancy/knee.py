# SPDX-License-Identifier: Apache-2.0
"""The orthosis as a system of the gap workflow: what is believed of it, and how far that may be off."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.system import Assembled, Calibration, Channel, Equation, System
from pam_orthosis.model import leg as leg_model
from pam_orthosis.model import orthosis
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects import CATALOGUE
from pam_orthosis.model.effects.base import enabled
from pam_orthosis.model.muscle import polynomial
from pam_orthosis.model.parameters import BELIEF, Section

APPARATUS = ("leg.", "muscle.", "valve.", "effects.")  # keys of the belief that recordings share
# keys in which recordings that are used together must agree, whatever the user gives, and why
ALONE = {"leg.joint.locked": "a locked knee's recording cannot be used together with others: leave it out"}
LOCKED = "diagnostic-locked"  # the angle does not move, which leaves the torque equation nothing to fit
MOST_SUPPLY = 1.5  # of what is believed, that a muscle can hold: beyond it the unit is another
TABLE_ORDER = 16
TABLE_MARGIN = 0.2  # rad beyond the joint's stops
CHANNELS = (
    Channel("angle", "angle", "rad", "deg", 57.29577951308232),
    Channel("extensor_pressure", "extensor_pressure", "Pa", "mbar", 0.01),
    Channel("flexor_pressure", "flexor_pressure", "Pa", "mbar", 0.01),
)


def knee(parameters, catalogue: Mapping | None = None) -> System:
    """Return the orthosis as the belief describes it; `plant` is not read.

    Args:
        parameters: the tree; effects that `effects.*` switches on belong to the nominal model.
        catalogue: effects that may be missing (all of the catalogue).
    """
    belief = parameters.only(*BELIEF, "gap")
    present = enabled(belief.effects)
    known = CATALOGUE if catalogue is None else catalogue
    settings = belief.gap.replay
    tables, joint = mass_tables(belief), belief.leg.joint
    pressures = [channel.name for channel in CHANNELS if channel.unit == "Pa"]
    return System(
        name="knee orthosis",
        channels=CHANNELS,
        inputs=("extensor_voltage", "flexor_voltage"),
        derived={"velocity": "angle"},
        equations=_equations(settings, {**CATALOGUE, **known}),
        calibrations=_calibrations(belief),
        catalogue={name: effect for name, effect in known.items() if name not in present},
        assemble=lambda effects: _assemble(belief, effects, tables),
        needs=dict.fromkeys(("gas", "valve", "supply"), ("extensor_voltage", "flexor_voltage")),
        simpler={name: partial(_without, parameters, name, catalogue) for name in present},
        limits={
            "angle": (joint.minimum - TABLE_MARGIN, joint.maximum + TABLE_MARGIN),
            **dict.fromkeys(pressures, (0.0, MOST_SUPPLY * belief.valve.supply_pressure)),
        },
        input_period="scenario.control_period",
        late=belief.valve.delay + sum(_lateness(belief).values()),
        unusable=(LOCKED,),
    )


def _without(parameters, effect: str, catalogue: Mapping | None) -> System:
    return knee(parameters.changed({f"effects.{effect}.enabled": False}), catalogue)


def _equations(settings, catalogue: Mapping) -> tuple[Equation, ...]:
    def held(channel: str) -> dict[str, float]:
        states = [one for effect in catalogue.values() for one in effect.held.items()]
        return {state: gains[channel] for state, gains in states if channel in gains}

    motion = {"angle": {"angle": settings.angle_gain, "velocity": settings.velocity_gain, **held("angle")}}
    pressures = ("extensor_pressure", "flexor_pressure")
    gas = {name: {name: settings.pressure_gain, **held(name)} for name in pressures}
    return (
        Equation("torque", ("angle", "velocity"), ("angle",), motion),
        Equation("gas", pressures, pressures, gas),
    )


def _calibrations(belief) -> tuple[Calibration, ...]:
    person = belief.leg.person.present
    rows = [belief.row(f"gap.tolerance.{name}") for name, _ in belief.gap.tolerance.items()]
    stated = tuple(
        Calibration(row.key.rsplit(".", 1)[1], row.value, row.unit, row.meaning)
        for row in rows
        if row.value and (person or not row.key.endswith("person_mass"))
    )
    row = belief.row("gap.learned.deviation")
    return stated + tuple(
        Calibration(name, row.value, row.unit, row.meaning)
        for effect in _learned(belief)
        for name in _deviations(effect).values()
    )


def _learned(belief) -> list:
    """Return the effects that the model has already and whose parameters are recalibrated with the others."""
    present = (CATALOGUE[name] for name in enabled(belief.effects))
    return [effect for effect in present if not effect.shape and effect.late is None]


def _lateness(belief) -> dict[str, float]:
    """Return the dead times that the model has learned beside its nominal one, by effect, s."""
    late = {name: CATALOGUE[name].late for name in enabled(belief.effects)}
    return {name: of(getattr(belief.effects, name)) for name, of in late.items() if of is not None}


def _deviations(effect) -> dict[str, str]:
    """Return, for each parameter of a learned effect, the name of its relative deviation."""
    return {q.name: f"{effect.name}_{q.name}" for q in effect.parameters}


def _assemble(belief, effects: tuple[str, ...], tables) -> Assembled:
    names = [one.name for one in _calibrations(belief)]
    own = [f"{name}.{q.name}" for name in effects for q in CATALOGUE[name].parameters]
    theta = ca.SX.sym("theta", len(names) + len(own))
    symbols = dict(zip([*names, *own], ca.vertsplit(theta), strict=True))
    assembly = orthosis.assemble(_hardware(belief, effects, symbols, tables))
    x, u, time = assembly.x, ca.SX.sym("u", 2), ca.SX.sym("time")
    voltages = u + ca.vertcat(symbols["extensor_closed_voltage"], symbols["flexor_closed_voltage"])
    given = {
        "external_torque": 0,
        "time": time,
        "extensor_voltage": voltages[0],
        "flexor_voltage": voltages[1],
    }
    inputs = ca.vertcat(*(given[name] for name in orthosis.INPUTS))
    offsets = {name: symbols[f"{name}_offset"] for name in (channel.name for channel in CHANNELS)}
    measured = [getattr(assembly.signals, f"measured_{name}") + offsets[name] for name in offsets]
    rates, *measured = ca.substitute([assembly.rates, *measured], [assembly.u], [inputs])
    return Assembled(
        assembly.states, x, u, time, theta, (*names, *own), rates, dict(zip(offsets, measured, strict=True))
    )


def _hardware(belief, effects, symbols, tables) -> orthosis.Hardware:
    values = belief.flat()
    deviating = {
        key: values[key] * (1 + symbols[name])
        for name, keys in DEVIATIONS.items()
        if name in symbols
        for key in keys
    }
    true = belief.substituted(deviating)
    mechanics = tabulated(belief.leg.joint, tables, symbols["moving_mass"], symbols.get("person_mass", 0.0))
    settings = dict(belief.effects.items())
    settings |= {name: Section(f"effects.{name}", {"enabled": False}) for name in _lateness(belief)}
    for effect in _learned(belief):
        own = {q: values[f"effects.{effect.name}.{q}"] for q in _deviations(effect)}
        moved = {q: own[q] * (1 + symbols[name]) for q, name in _deviations(effect).items()}
        settings[effect.name] = Section(f"effects.{effect.name}", {"enabled": True, **moved})
    for name in effects:
        own = {q.name: symbols[f"{name}.{q.name}"] for q in CATALOGUE[name].parameters}
        settings[name] = Section(f"effects.{name}", {"enabled": True, **own})
    laws = {name: _law(true.muscle.dmsp_20, symbols[f"{name}_force"]) for name in orthosis.MUSCLES}
    effects_on = Section("effects", settings)
    return orthosis.Hardware(true.leg, true.muscle.dmsp_20, true.valve, laws, effects_on, mechanics)


def tabulated(joint, tables, moving_mass, person_mass):
    """Return the leg's mechanics with inertia and gravity as Chebyshev fits over the joint's range.

    Both are linear in the masses and depend on the angle alone, so that a polynomial of order
    `TABLE_ORDER` gives Eq. (25) to 1e-9 of its size at a fraction of the cost; k is m'(q) q-dot^2 / 2.
    `moving_mass` and `person_mass` are relative deviations of the masses.
    """
    apparatus, person, foot = tables

    def mechanics(q, velocity, _leg, extra_foot_mass=0.0):
        inertia, gravity = (
            (1 + moving_mass) * polynomial(a, _scaled(q, joint))
            + (1 + person_mass) * polynomial(b, _scaled(q, joint))
            + extra_foot_mass * polynomial(c, _scaled(q, joint))
            for a, b, c in zip(apparatus, person, foot, strict=True)
        )
        slope = ca.jtimes(inertia, q, 1) if isinstance(q, ca.SX) else 0.0
        return leg_model.Mechanics(inertia, 0.5 * slope * velocity**2, gravity)

    return mechanics


def mass_tables(belief):
    """Return coefficients of inertia and gravity by the angle for apparatus, person, 1 kg at the ankle."""
    masses = [key for key in belief.flat() if key in DEVIATIONS["moving_mass"]]
    none = dict.fromkeys((*masses, "leg.person.mass"), 0.0)
    values = belief.flat()
    apparatus = {**none, **{key: values[key] for key in masses}}
    person = {**none, "leg.person.mass": values["leg.person.mass"]}
    return (
        _table(belief.substituted(apparatus), 0.0),
        _table(belief.substituted(person), 0.0),
        _table(belief.substituted(none), 1.0),
    )


def _table(belief, extra_foot_mass):
    q, velocity = ca.SX.sym("q"), ca.SX.sym("velocity")
    terms = leg_model.mechanics(q, velocity, belief.leg, extra_foot_mass)
    function = ca.Function("terms", [q], [terms.inertia, terms.gravity])
    joint = belief.leg.joint
    nodes = np.cos(np.pi * (np.arange(200) + 0.5) / 200)
    angles = 0.5 * (joint.maximum + joint.minimum) + nodes * (
        0.5 * (joint.maximum - joint.minimum) + TABLE_MARGIN
    )
    sampled = np.array(function.map(200)(angles[None, :])).reshape(2, 200)
    fits = [np.polynomial.chebyshev.chebfit(nodes, values, TABLE_ORDER) for values in sampled]
    return [np.polynomial.chebyshev.cheb2poly(fit).tolist() for fit in fits]


def _scaled(q, joint):
    return (q - 0.5 * (joint.maximum + joint.minimum)) / (
        0.5 * (joint.maximum - joint.minimum) + TABLE_MARGIN
    )


def _law(m, deviation) -> orthosis.MuscleLaw:
    law = orthosis.polynomial_law(m)
    return orthosis.MuscleLaw(lambda dl, p: (1 + deviation) * law.force(dl, p), law.volume)
