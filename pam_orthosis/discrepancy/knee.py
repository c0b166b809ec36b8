# SPDX-License-Identifier: Apache-2.0
"""The orthosis' knee as a system of the gap workflow: how recordings show it, and how far it may be off."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from pam_orthosis.discrepancy.machine_system import Symbols, View, from_rows, graph_view, machine_system
from pam_orthosis.discrepancy.system import System
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
LOCKED = "diagnostic-locked"  # the angle does not move, which leaves the torque equation nothing to fit
TABLE_ORDER, TABLE_NODES = 16, 200


def knee(parameters: Parameters, catalogue: Mapping[str, Effect] | None = None) -> System:
    """Return the orthosis as its parameters describe it; `plant` is not read.

    Args:
        parameters: the tree; effects that `effects.*` switches on belong to the nominal model.
        catalogue: effects that may be missing (all of the catalogue).
    """
    return machine_system(parameters.declared, parameters, _view, catalogue)


def _view(machine: Machine, nominal: Parameters) -> View:
    joint, leg, view = nominal.leg.joint, tabulated_leg(nominal), graph_view(machine, nominal)
    rows = {name: f"gap.tolerance.{name}" for name, _ in nominal.gap.tolerance.items()}
    if not nominal.leg.person.present:
        del rows["person_mass"]

    def mechanism(true: Parameters, symbols: Symbols) -> Knee:
        masses = symbols["moving_mass"], symbols.get("person_mass", 0.0)
        return Knee(true.leg, leg(*masses))

    return replace(
        view,
        calibrations=from_rows(nominal, rows),
        stiff=False,
        mechanism=mechanism,
        limits={**view.limits, "angle": (joint.minimum - MARGIN, joint.maximum + MARGIN)},
        unusable=(LOCKED,),
    )


def tabulated_leg(nominal: Parameters) -> Callable[[Expression, Expression], Callable[..., Mechanics]]:
    """Return (relative deviations of the moving masses, of the person's mass) -> the leg's mechanics.

    Inertia and gravity are sums of polynomials: of the apparatus, of the person, of 1 kg at the ankle.
    """
    joint, values = nominal.leg.joint, nominal.flat()
    table = LegTable(joint.minimum, joint.maximum, TABLE_ORDER, TABLE_NODES)
    moving = {key: values[key] for key in DEVIATIONS["moving_mass"]}
    person = {"leg.person.mass": values["leg.person.mass"]}
    none = dict.fromkeys((*moving, *person), 0.0)
    known = (({**none, **moving}, 0.0), ({**none, **person}, 0.0), (none, 1.0))
    parts = [table.coefficients(nominal.substituted(masses).leg, extra) for masses, extra in known]

    def deviating(moving_mass: Expression, person_mass: Expression) -> Callable[..., Mechanics]:
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
