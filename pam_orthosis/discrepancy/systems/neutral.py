# SPDX-License-Identifier: Apache-2.0
"""Does an effect vanish at the neutral value of its size, so that without it the nominal model is left?"""

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.systems.system import Assembled, System
from pam_orthosis.model.effects.base import Effect

TRIES = 4  # points of a model; at some it may have no finite number
SAME = 1e-9  # of two predictions


def remains(system: System, effect: Effect, bare: Assembled, found: Assembled) -> bool:
    """Return whether an effect surely changes what is predicted where all that has a neutral value has it.

    `bare`: the expressions without effects; `found`: those with this one. What depends on states of the
    effect itself is left out: a sensor that lags by 0 s has one that it cannot leave.
    """
    random = np.random.default_rng(0)
    without, with_effect = _predicted(system, bare, bare), _predicted(system, bare, found)
    known = np.zeros(len(system.calibrations))
    own = [q.typical if q.neutral is None else q.neutral for q in effect.parameters]
    for _ in range(TRIES):
        place, rest = random.normal(size=len(bare.states)), (random.normal(size=bare.u.numel()), 1.0)
        states = [_state(bare, found, place, random) for _ in range(2)]
        usual = without(place, *rest, known).full()
        changed = [with_effect(state, *rest, [*known, *own]).full() for state in states]
        if _shifted(usual, *changed):
            return True
    return False


def _shifted(usual: np.ndarray, one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two predictions have a finite number that is the same, but not the usual one."""
    with np.errstate(invalid="ignore"):
        near = SAME * (1 + np.abs(usual))
        return bool(np.any((np.abs(one - other) <= near) & (np.abs(one - usual) > near)))


def _predicted(system: System, bare: Assembled, one: Assembled) -> ca.Function:
    """Return the rates of the model's own states, and what is measured."""
    rates = [one.rates[one.states.index(name)] for name in bare.states]
    measured = [one.measured[channel.name] for channel in system.channels]
    return ca.Function("predicted", [one.x, one.u, one.time, one.theta], [ca.vertcat(*rates, *measured)])


def _state(bare: Assembled, found: Assembled, place: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Return a place with the effect's own states anywhere."""
    known = dict(zip(bare.states, place, strict=True))
    return np.array([known[name] if name in known else random.normal() for name in found.states])
