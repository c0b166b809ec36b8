# SPDX-License-Identifier: Apache-2.0
"""The orthosis' knee as a system of the gap workflow: how recordings show it, and how far it may be off."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from pam_orthosis.discrepancy.systems.machine_system import machine_system
from pam_orthosis.discrepancy.systems.suspects import MASSES as ALL_MASSES
from pam_orthosis.discrepancy.systems.suspects import OF_MASSES, VALVE, each, symbol
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.systems.view import Symbols, View, from_rows, graph_view
from pam_orthosis.model.components.muscle import polynomial
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.leg_table import MARGIN, LegTable, tabulated
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.mechanisms.base import Mechanics
from pam_orthosis.model.mechanisms.knee import Knee
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression

APPARATUS = ("leg.", "muscle.", "valve.", "effects.")  # keys of the nominal model that recordings share
# keys in which recordings that are used together must agree, whatever the user gives, and why
ALONE = {"leg.joint.locked": "a locked knee's recording cannot be used together with others: leave it out"}
# lengths and masses of the apparatus that may be wrong, with values between which the leg's mechanics are
# interpolated: shares of the nominal value, or m
MASSES, LENGTHS, HEIGHTS = (0.5, 1.5), (0.6, 0.8, 1.0, 1.2, 1.4), (-0.15, -0.07, 0.0, 0.07, 0.15)
LEG = {
    "leg.thigh.length": LENGTHS, "leg.shank.length": LENGTHS, "leg.bearing_height": HEIGHTS,
    "leg.thigh.mass": MASSES, "leg.shank.mass": MASSES, "leg.knee_mass": MASSES,
}  # fmt: skip
GEOMETRY = (
    "leg.cogwheel_diameter", "leg.symmetric_angle", "leg.symmetric_contraction", "muscle.dmsp_20.length",
)  # fmt: skip
SUSPECTS = each(*GEOMETRY) | OF_MASSES | each(*LEG, *VALVE)
LOCKED = "diagnostic-locked"  # the angle does not move, which leaves the torque equation nothing to fit
TABLE_ORDER, TABLE_NODES = 16, 200


def knee(
    parameters: Parameters, catalogue: Mapping[str, Effect] | None = None, external: bool = False
) -> System:
    """Return the orthosis as its parameters describe it; `plant` is not read.

    Args:
        parameters: the tree; effects that `effects.*` switches on belong to the nominal model.
        catalogue: effects that may be missing (all of the catalogue).
        external: a torque on the knee from outside is recorded too.
    """
    return machine_system(parameters.declared, parameters, _view, catalogue, external)


def _view(machine: Machine, nominal: Parameters) -> View:
    joint, leg, view = nominal.leg.joint, tabulated_leg(nominal), graph_view(machine, nominal)
    rows = {name: f"gap.tolerance.{name}" for name, _ in nominal.gap.tolerance.items()}
    if not nominal.leg.person.present:
        del rows["person_mass"]

    def mechanism(true: Parameters, symbols: Symbols) -> Knee:
        factor = symbol(symbols, ALL_MASSES)
        own = (1 + symbols["moving_mass"]) * (1.0 if factor is None else factor) - 1
        masses = own, symbols.get("person_mass", 0.0)
        wrong = next((key for key in LEG if symbol(symbols, key) is not None), "")
        return Knee(true.leg, leg(*masses, wrong, symbol(symbols, wrong)))

    return replace(
        view,
        calibrations=from_rows(nominal, rows),
        stiff=False,
        mechanism=mechanism,
        suspects=SUSPECTS,
        limits={**view.limits, "angle": (joint.minimum - MARGIN, joint.maximum + MARGIN)},
        unusable=(LOCKED,),
    )


def tabulated_leg(nominal: Parameters) -> Callable[..., Callable[..., Mechanics]]:
    """Return (deviations of the moving masses, of the person's mass, wrong key, its value) -> the mechanics.

    Inertia and gravity are sums of polynomials: of the apparatus, of the person, of 1 kg at the ankle. Those
    of a leg with a wrong parameter are interpolated between legs (Lagrange).
    """
    joint, values = nominal.leg.joint, nominal.flat()
    table = LegTable(joint.minimum, joint.maximum, TABLE_ORDER, TABLE_NODES)
    moving = {key: values[key] for key in DEVIATIONS["moving_mass"]}
    person = {"leg.person.mass": values["leg.person.mass"]}
    none = dict.fromkeys((*moving, *person), 0.0)

    def parts_of(wrong: Mapping[str, float]) -> list[list[list[float]]]:
        own = {key: wrong.get(key, value) for key, value in moving.items()}
        known = (({**none, **own}, 0.0), ({**none, **person}, 0.0), (none, 1.0))
        return [
            table.coefficients(nominal.substituted({**wrong, **masses}).leg, extra) for masses, extra in known
        ]

    def interpolated(key: str, value: Expression) -> list[list[list[Expression]]]:
        nodes = [node if LEG[key] is HEIGHTS else node * values[key] for node in LEG[key]]
        return _between(nodes, [parts_of({key: node}) for node in nodes], value)

    usual = parts_of({})

    def deviating(
        moving_mass: Expression, person_mass: Expression, wrong: str = "", value: Expression = None
    ) -> Callable[..., Mechanics]:
        parts = interpolated(wrong, value) if wrong else usual

        def terms(q: Expression, extra_foot_mass: Expression) -> tuple[Expression, Expression]:
            inertia, gravity = (
                (1 + moving_mass) * polynomial(a, table.place(q))
                + (1 + person_mass) * polynomial(b, table.place(q))
                + extra_foot_mass * polynomial(c, table.place(q))
                for a, b, c in zip(*parts, strict=True)
            )
            return inertia, gravity

        return tabulated(terms)

    return deviating


def _between(
    nodes: Sequence[float], tables: Sequence[list[list[list[float]]]], value: Expression
) -> list[list[list[Expression]]]:
    """Return the coefficients at a value between nodes, at each of which they are tabulated (Lagrange)."""
    shares = [math.prod((value - b) / (a - b) for b in nodes if b != a) for a in nodes]
    return [
        [
            [sum(s * c for s, c in zip(shares, many, strict=True)) for many in zip(*rows, strict=True)]
            for rows in zip(*parts, strict=True)
        ]
        for parts in zip(*tables, strict=True)
    ]
