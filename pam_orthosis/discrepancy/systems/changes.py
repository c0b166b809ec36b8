# SPDX-License-Identifier: Apache-2.0
"""What a model file changes in a model that a user wrote: effects and curves that it has then, values."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

from pam_orthosis.discrepancy.systems.implied import parameter_of
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.reading import check_keys, shown

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.systems.builder import Model

ON = "enabled"
UNKNOWN = "unknown_"  # before the name of a channel


class Curve(NamedTuple):
    """What is described and has no name: straight lines over a state, an input or `time`.

    It is added to the last rate of a channel that the model has: of its velocity, or else of itself.
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
    values: dict[str, float] = {}
    found: dict[str, dict[str, Any]] = {}
    for key, value in changes.items():
        branch, _, rest = key.partition(".")
        if branch == System.branch:
            name, _, quantity = rest.partition(".")
            found.setdefault(name, {})[quantity] = value
        else:
            values[key] = _number(key, value)
    check_keys(values, [one.name for one in model.parameters], model.name)
    unknown = {f"{UNKNOWN}{one.name}": one.name for one in model.channels}
    check_keys(found, [*_effects(model), *unknown], f"the catalogue of {model.name}")
    for name, own in found.items():
        if own.pop(ON, None) is not True:
            key = f"{System.branch}.{name}"
            raise OrthosisError(f"{key} is not on: give {key}.{ON}: true, or leave out what is of it")
    curves = {unknown[name]: _curve(name, found.pop(name)) for name in [*found] if name in unknown}
    return replace(
        model,
        parameters=[replace(one, value=values.get(one.name, one.value)) for one in model.parameters],
        present={**model.present, **found},
        curves={**model.curves, **curves},
    )


def _curve(name: str, given: Mapping[str, Any]) -> Curve:
    check_keys(given, Curve._fields, f"{System.branch}.{name}")
    if missing := [one for one in Curve._fields if one not in given]:
        raise OrthosisError(
            f"{System.branch}.{name}.{missing[0]} is missing: a curve needs all of its fields"
        )
    return Curve(**given)


def check_present(model: Model) -> None:
    """Check the effects and curves that a model has already; OrthosisError: it cannot have one of them."""
    for channel, curve in model.curves.items():
        check_keys([channel], [one.name for one in model.channels if one.state is not None], "`curves`")
        _check_curve(model, f"{System.branch}.{UNKNOWN}{channel}", curve)
    effects = _effects(model)
    check_keys(model.present, effects, f"the catalogue of {model.name}")
    for name, given in model.present.items():
        where, quantities = f"{System.branch}.{name}", {q.name: q for q in effects[name].parameters}
        check_keys(given, quantities, where)
        for own, q in quantities.items():
            key = f"{where}.{own}"
            if own not in given:
                raise OrthosisError(f"{key} is missing: an effect needs all of its parameters")
            if not q.minimum <= _number(key, given[own]) <= q.maximum:
                bounds = f"{q.minimum:.6g} .. {q.maximum:.6g} {q.unit}"
                raise OrthosisError(f"{key} = {given[own]:.6g} is outside of {bounds}")


def _effects(model: Model) -> dict[str, Effect]:
    return {one.name: one for one in (*model.effects, *model.implied) if not parameter_of(one)}


def _check_curve(model: Model, where: str, curve: Curve) -> None:
    signals = [*model.states, *(one.name for one in model.inputs), "time"]
    check_keys([curve.coordinate], signals, f"{where}.coordinate")
    for key in ("places", "values"):
        row = getattr(curve, key)
        if not isinstance(row, list | tuple) or not 1 < len(row) == len(curve.places):
            raise OrthosisError(
                f"{where}.{key} is {shown(row)}; it needs two numbers or more, places as many as values"
            )
        for number in row:
            _number(f"{where}.{key}", number)
    if not all(after > before for before, after in pairwise(curve.places)):
        raise OrthosisError(f"{where}.places have to rise")


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise OrthosisError(f"{key} is {shown(value)}, no finite number")
    return float(value)
