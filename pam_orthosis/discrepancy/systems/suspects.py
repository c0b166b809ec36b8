# SPDX-License-Identifier: Apache-2.0
"""Parameters of the apparatus that may be wrong: candidates of the search, as effects are.

A nuisance parameter is off by its tolerance. A sprocket of another size, or a supply set to another pressure,
is a mistake in the nominal model; the search names it, with the value that the recordings ask for.
"""

from collections.abc import Mapping, Sequence
from typing import cast

from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.rows import Row
from pam_orthosis.model.signals import Expression

VALVE = ("valve.supply_pressure", "valve.conductance", "valve.hose.volume")
TYPICAL = 0.2  # of the nominal value, or of `SPANS`: a mistake to look for
REACH = 3.0  # times as small or as large as the nominal value, within the row's bounds
LEAST = 0.03  # of the nominal value, or of the span: a smaller mistake is not worth a name
ASSEMBLED = ".contraction"  # of an actuator where the coordinate is zero, m
# sizes of the values that may be zero or of any sign, by the ends of their keys
SPANS = {"leg.symmetric_angle": 1.0, "leg.bearing_height": 0.2, ASSEMBLED: 0.05}
MASSES, ARMS = "leg.masses", "machine.arms"
OF_MASSES = {MASSES: DEVIATIONS["moving_mass"]}
WITHIN = {"valve.conductance": "valve_curve_misfit", "valve.hose.volume": "volume_misfit"}
VALUE = "value"

# what may be wrong -> keys of the parameters that it multiplies; none: it is the key of the one
Suspects = Mapping[str, Sequence[str]]


def each(*keys: str) -> dict[str, tuple[str, ...]]:
    """Return suspects that are one parameter each."""
    return dict.fromkeys(keys, ())


def name_of(key: str) -> str:
    """Return the candidate's name of a parameter."""
    return key.replace(".", "_")


def suspects(nominal: Parameters, wrong: Suspects) -> dict[str, Effect]:
    """Return candidates by name for parameters that may be wrong."""
    return {name_of(key): _suspect(nominal, key, of) for key, of in wrong.items()}


def meant(wrong: Suspects) -> dict[str, str]:
    """Return what each candidate takes to be wrong, in words."""

    def several(of: Sequence[str]) -> str:
        return f"common factor of {', '.join(of[:-1])} and {of[-1]}"

    return {name_of(key): several(of) if of else key for key, of in wrong.items()}


def common(nominal: Parameters, wrong: Suspects) -> dict[str, dict[str, float]]:
    """Return the nominal values of the parameters of each candidate that multiplies several."""
    values = nominal.flat()
    return {name_of(key): {one: float(values[one]) for one in of} for key, of in wrong.items() if of}


def corrected(
    values: Mapping[str, float], symbols: Mapping[str, Expression], wrong: Suspects
) -> dict[str, Expression]:
    """Return key -> expression of the parameters that are taken to be wrong."""
    found: dict[str, Expression] = {}
    for key, of in wrong.items():
        value = symbol(symbols, key)
        if value is not None:
            found |= {one: value * values[one] for one in of} if of else {key: value}
    return found


def symbol(symbols: Mapping[str, Expression], key: str) -> Expression | None:
    """Return the symbol of a parameter that is taken to be wrong, None if it is not."""
    return symbols.get(f"{name_of(key)}.{VALUE}")


def _row(nominal: Parameters, key: str, of: Sequence[str]) -> Row:
    """Return the row of a parameter, or of the factor of several."""
    if not of:
        return nominal.row(key)
    source = nominal.row(of[0]).source
    return Row(key, 1.0, "-", None, None, "by which all of them are larger", source)


def _suspect(nominal: Parameters, key: str, of: Sequence[str]) -> Effect:
    row = _row(nominal, key, of)
    value = cast(float, row.value)
    span = next((size for end, size in SPANS.items() if key.endswith(end)), None)
    size = abs(value) if span is None else span
    low, high = (value - size, value + size) if span else sorted((value / REACH, value * REACH))
    quantity = Quantity(
        VALUE,
        value + TYPICAL * size,
        row.unit,
        max(low, row.minimum if row.minimum is not None else low),
        min(high, row.maximum if row.maximum is not None else high),
        row.meaning,
        neutral=value,
    )
    shrunk = {VALUE: value - TYPICAL * size}
    return Effect(
        name_of(key),
        "torque" if key.startswith(("leg.", "muscle.", "machine.")) else "gas",
        (quantity,),
        lambda *_: Contribution({}),  # it enters as a parameter
        physics=f"The nominal model has another value of {key}: {row.meaning}.",
        source=row.source,
        starts=(shrunk,),
        minimum_effect=LEAST * size,
        within=WITHIN.get(key, ""),
    )
