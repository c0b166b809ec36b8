# SPDX-License-Identifier: Apache-2.0
"""From what the gap workflow found to the controllers' nominal model."""

from collections.abc import Mapping, Sequence
from typing import Any

from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.machine import Machine
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import rounded


def learnable(machine: Machine) -> dict[str, Effect]:
    """Return the effects of a machine that its controllers can learn.

    What they cannot invert is left out: a curve of the valve hides its dead band, whose step the inverse
    valve model needs.
    """
    return {name: effect for name, effect in machine.catalogue.items() if name != "valve_curve_misfit"}


def named(nominal: Parameters, effects: Sequence[str], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the overrides that switch effects on with values (`effect.parameter` -> value)."""
    changes: dict[str, Any] = {}
    for name in effects:
        own = {q.name: values[f"{name}.{q.name}"] for q in nominal.declared.catalogue[name].parameters}
        changes |= _effect(nominal, name, own)
    return changes


def calibrated(nominal: Parameters, effects: Sequence[str], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the overrides that give nuisance parameters their calibrated values.

    Args:
        nominal: what the values deviate from, effects of earlier rounds included.
        effects: those that were found now: their own parameters are taken as found.
        values: calibration -> relative deviation or offset, `effect.parameter` -> value.
    """
    before = nominal.flat()
    changes: dict[str, Any] = {}
    for name, keys in DEVIATIONS.items():
        factor = 1 + values.get(name, 0.0)
        there = [key for key in keys if key in before and factor != 1]
        changes |= {key: _within(nominal, key, before[key] * factor) for key in there}

    def present(effect: str, parameter: str, off: float) -> float:
        if effect in effects:
            return values[f"{effect}.{parameter}"]
        return before[f"effects.{effect}.{parameter}"] if before[f"effects.{effect}.enabled"] else off

    machine = nominal.declared
    for actuator in machine.names:
        name, factor = f"{actuator}_force_scale", 1 + values[f"{actuator}_force"]
        changes |= _effect(nominal, name, {"scale": factor * present(name, "scale", 1.0)})
    for name in (f"{channel}_offset" for channel in machine.channels):
        if name in machine.catalogue:
            changes |= _effect(nominal, name, {"offset": values[name] + present(name, "offset", 0.0)})
    return changes | patch.limits(nominal, changes) | _shapes(nominal, effects, values)


def _shapes(nominal: Parameters, effects: Sequence[str], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the corrections of static maps that are no effect in their own right."""
    changes: dict[str, Any] = {}
    for name, effect in learnable(nominal.declared).items():
        keys = {q.name: f"{name}.{q.name}" for q in effect.parameters}
        if effect.shape and name not in effects and all(key in values for key in keys.values()):
            changes |= _effect(nominal, name, {own: values[key] for own, key in keys.items()})
    return changes


def _effect(nominal: Parameters, name: str, values: Mapping[str, float]) -> dict[str, Any]:
    path = f"effects.{name}"
    own = {f"{path}.{key}": _within(nominal, f"{path}.{key}", value) for key, value in values.items()}
    return {f"{path}.enabled": True, **own}


def _within(nominal: Parameters, key: str, value: float) -> float:
    """Return a value inside the bounds of its row, with the digits that a model file has."""
    low, high = nominal.row(key).bounds
    return rounded([min(max(value, low), high)])[0]
