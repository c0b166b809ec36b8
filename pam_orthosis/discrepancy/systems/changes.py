# SPDX-License-Identifier: Apache-2.0
"""What a model file changes in a model that a user wrote: effects and curves that it has then, values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

from pam_orthosis.discrepancy.systems.implied import parameter_of
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Effect, Quantity
from pam_orthosis.reading import check_keys, shown

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.systems.builder import Model, Parameter

ON = "enabled"
UNKNOWN = "unknown_"  # before the name of a channel
MOST_PLACES = 200  # of a curve: more take a compiler minutes


class Curve(NamedTuple):
    """What is described and has no name: straight lines over a state, an input or `time`, constant beyond.

    It is added to the last rate of a channel that the model has, in its unit: of the velocity, or else of the
    channel itself.
    """

    coordinate: str
    places: Sequence[float]
    values: Sequence[float]


def changed(model: Model, changes: Mapping[str, Any]) -> Model:
    """Return a model with what a file says of it.

    Args:
        changes: `effects.NAME.enabled`, `effects.NAME.PARAMETER` and `PARAMETER` -> value; of what is
            unknown in a channel NAME is `unknown_CHANNEL`, and has the fields of a `Curve`.

    Raises:
        OrthosisError: the model has no such effect or parameter, or it cannot have this value.
    """
    values: dict[str, Any] = {}
    found: dict[str, dict[str, Any]] = {}
    for key, value in changes.items():
        branch, _, rest = key.partition(".")
        if branch == System.branch:
            name, _, quantity = rest.partition(".")
            found.setdefault(name, {})[quantity] = value
        else:
            values[key] = value
    unknown = {f"{UNKNOWN}{one.name}": one.name for one in model.channels}
    _check_found(model, found, unknown)
    curves = {unknown[name]: _curve(name, found.pop(name)) for name in [*found] if name in unknown}
    check_keys(values, [one.name for one in model.parameters], model.name)
    return replace(
        model,
        parameters=[_valued(one, values.get(one.name, one.value)) for one in model.parameters],
        present={**model.present, **found},
        curves={**model.curves, **curves},
    )


def check_numbers(model: Model) -> None:
    """Check a model's values and tolerances, and what inputs hold; OrthosisError: one is no such value."""
    _number("late", model.late)
    for given in model.inputs:
        if not isinstance(given.held, bool):
            raise OrthosisError(f"input {given.name}: held is {shown(given.held)}; give True or False")
    for one in model.parameters:
        _number(f"parameter {one.name}: its value", one.value)
        _number(f"parameter {one.name}: its tolerance, in {one.unit},", one.tolerance)


def check_known(model: Model) -> None:
    """Check the effects and curves that a model has already; OrthosisError: it cannot have one of them."""
    for what in ("present", "curves"):
        if not isinstance(getattr(model, what), Mapping):
            raise OrthosisError(f"`{what}` is {shown(getattr(model, what))}; give a mapping from names")
    check_keys(model.curves, [one.name for one in model.channels if one.state is not None], "`curves`")
    for channel, curve in model.curves.items():
        _check_curve(model, f"{System.branch}.{UNKNOWN}{channel}", curve)
    effects = _effects(model)
    check_keys(model.present, effects, f"the catalogue of {model.name}")
    for name, given in model.present.items():
        where, quantities = f"{System.branch}.{name}", {q.name: q for q in effects[name].parameters}
        if not isinstance(given, Mapping):
            raise OrthosisError(f"{where} is {shown(given)}; give a mapping from {', '.join(quantities)}")
        check_keys(given, quantities, where)
        for own, q in quantities.items():
            _check_quantity(f"{where}.{own}", q, given)


def _check_found(model: Model, found: Mapping[str, dict[str, Any]], unknown: Mapping[str, str]) -> None:
    """Check that what a file has of effects is of some that there are, and take out that they are on."""
    if "" in found:
        given = shown(found[""].get(""))
        raise OrthosisError(f"{System.branch} is {given}; give {System.branch}.NAME.{ON}, and its parameters")
    for name in found:
        if wrong := next((p for p in model.implied if p.name == name and parameter_of(p)), None):
            raise OrthosisError(f"{name} is no effect: give {parameter_of(wrong)}: VALUE")
    check_keys(found, [*_effects(model), *unknown], f"the catalogue of {model.name}")
    for name, own in found.items():
        if own.pop(ON, None) is not True:
            key = f"{System.branch}.{name}"
            raise OrthosisError(f"{key} is not on: give {key}.{ON}: true, or leave out what is of it")


def _valued(one: Parameter, given: Any) -> Parameter:
    value = _number(one.name, given)
    if one.calibration.ratio and value * one.value <= 0:
        raise OrthosisError(
            f"{one.name} = {value:.6g}: by its tolerance it keeps the sign of {one.value:.6g}"
        )
    return replace(one, value=value)


def _curve(name: str, given: Mapping[str, Any]) -> Curve:
    check_keys(given, Curve._fields, f"{System.branch}.{name}")
    if missing := [one for one in Curve._fields if one not in given]:
        raise OrthosisError(f"{System.branch}.{name}.{missing[0]} is missing: a curve needs it")
    return Curve(**given)


def _effects(model: Model) -> dict[str, Effect]:
    return {one.name: one for one in (*model.effects, *model.implied) if not parameter_of(one)}


def _check_quantity(key: str, q: Quantity, given: Mapping[str, Any]) -> None:
    if q.name not in given:
        raise OrthosisError(f"{key} is missing: an effect needs all of its parameters")
    value = _number(key, given[q.name])
    if not q.minimum <= value <= q.maximum:
        bounds = f"{q.minimum:.6g} .. {q.maximum:.6g} {q.unit}"
        raise OrthosisError(f"{key} = {value:.6g} is outside of {bounds}")


def _check_curve(model: Model, where: str, curve: Curve) -> None:
    if not isinstance(curve, Curve):
        raise OrthosisError(f"{where} is {shown(curve)}; give a Curve")
    signals = [*model.states, *(one.name for one in model.inputs), "time"]
    if not isinstance(curve.coordinate, str):
        raise OrthosisError(
            f"{where}.coordinate is {shown(curve.coordinate)}; give one of {', '.join(signals)}"
        )
    check_keys([curve.coordinate], signals, f"{where}.coordinate")
    for key in ("places", "values"):
        row = getattr(curve, key)
        if not isinstance(row, list | tuple) or not 1 < len(row) == len(curve.places) <= MOST_PLACES:
            raise OrthosisError(f"{where}.{key}: give 2 to {MOST_PLACES} numbers, places as many as values")
        for number in row:
            _number(f"{where}.{key}", number)
    if not all(after > before for before, after in pairwise(curve.places)):
        raise OrthosisError(f"{where}.places have to rise")


def _number(key: str, value: Any) -> float:
    """Return a number as Python has it; OrthosisError if it is none, or beyond all bounds."""
    try:
        number = float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise OrthosisError(f"{key} is {shown(value)}, no finite number")
    return number
