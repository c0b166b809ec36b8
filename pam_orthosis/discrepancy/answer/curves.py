# SPDX-License-Identifier: Apache-2.0
"""Corrections of static maps that were found, as curves beside the nominal model."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.answer.judgement import Outcome
from pam_orthosis.discrepancy.search.findings import QUANTILE, Named, covariance
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.effects.muscles import WHOLE_STROKE
from pam_orthosis.model.rows import Section
from pam_orthosis.model.signals import ActuatorSignals, Air

POINTS = 81
PASCAL_PER_BAR = 1e5
SEEN = 1.0  # of the interval that priors alone leave: where no more is known, recordings say nothing of a map


class Map(NamedTuple):
    """A static map of an actuator, as it is shown: what, over what; units; factor to the unit shown.

    `absolute`: the nominal value is what it is a map of, not zero. `pressures` are gauge, Pa.
    """

    what: str
    unit: str
    factor: float
    over: str
    ends: tuple[float, float]
    pressures: tuple[float, ...] = (0.0,)
    absolute: bool = False


CONTRACTION = "contraction of the nominal length"
# signal to which an effect adds -> the map that it corrects; places and ends are shares
MAPS = {
    "opening": Map("valve opening", "%", 100.0, "opening by the nominal model", (-1.0, 1.0), absolute=True),
    "force": Map("static force", "N", 1.0, CONTRACTION, (0.0, WHOLE_STROKE), (1e5, 3e5, 5e5)),
    "volume": Map("volume", "%", 100.0, CONTRACTION, (0.0, WHOLE_STROKE), (3e5,)),
}


@dataclass(frozen=True)
class Curve:
    """A correction of one actuator's map at one pressure, in the units of its map.

    Attributes:
        effect, actuator: whose.
        map: what it corrects.
        pressure: gauge, bar; None where it does not matter.
        places: %, of `Map.over`.
        nominal: value of the nominal model; zeros where the correction alone is shown.
        found: value with the correction.
        half: half of its 95 % interval.
    """

    effect: str
    actuator: str
    map: Map
    pressure: float | None
    places: np.ndarray
    nominal: np.ndarray
    found: np.ndarray
    half: np.ndarray

    @property
    def largest(self) -> int:
        """The place of the largest change that is certain."""
        return int(np.argmax(np.abs(self.found - self.nominal) - self.half))


def curves(outcome: Outcome, one: Named) -> list[Curve]:
    """Return the curves of an effect that corrects a map; none if it is no such effect."""
    effect = outcome.system.catalogue[one.name]
    if not (effect.shape and effect.on):
        return []
    final, names = outcome.selection.final, [free.name for free in outcome.selection.final.free]
    spread = covariance(outcome.selection.final_problem, final)
    scales = np.array([free.scale for free in final.free])
    priors = {f"{one.name}.{q.name}": q.prior for q in effect.parameters}
    found = []
    for actuator in effect.on:
        keys = [f"{one.name}.{name}" for name in _coefficients(effect, actuator)]
        index, values = [names.index(key) for key in keys], np.array([final.values[key] for key in keys])
        own = spread[np.ix_(index, index)] * np.outer(scales[index], scales[index])
        found += drawn(effect, actuator, values, own, np.array([priors[key] for key in keys]))
    return found


def drawn(
    effect: Effect, actuator: str, values: np.ndarray, own: np.ndarray, sizes: np.ndarray
) -> list[Curve]:
    """Return the curves of one actuator where recordings say something of them.

    Args:
        values: of its coefficients.
        own: their covariance.
        sizes: standard deviations that they have without recordings.
    """
    signal, slopes = _slopes(effect, actuator)
    of = MAPS[signal]
    x, result = np.linspace(*of.ends, POINTS), []
    for pressure in of.pressures:
        rows = of.factor * np.vstack([np.array(slopes(place, pressure)) for place in x])
        nominal = of.factor * x if of.absolute else np.zeros(POINTS)
        half, prior = _half(rows, own), _half(rows, np.diag(sizes**2))
        (seen,) = np.nonzero(half < SEEN * prior)
        if len(seen) < 2:
            continue
        part = slice(seen[0], seen[-1] + 1)
        at = pressure / PASCAL_PER_BAR if len(of.pressures) > 1 else None
        numbers = (100 * x, nominal, nominal + rows @ values, half)
        result.append(Curve(effect.name, actuator, of, at, *(one[part] for one in numbers)))
    return result


def _half(rows: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """Return half the 95 % interval of sums of coefficients."""
    half: np.ndarray = QUANTILE * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", rows, spread, rows), 0.0))
    return half


def in_words(found: Sequence[Curve]) -> list[str]:
    """Return for each actuator the largest change that is certain."""
    words = []
    for actuator in dict.fromkeys(curve.actuator for curve in found):
        own = [curve for curve in found if curve.actuator == actuator]
        worst = max(own, key=_certain)
        words.append(f"{actuator}: {_change(worst)}" if _certain(worst) > 0 else f"{actuator}: hardly any")
    return words


def _certain(curve: Curve) -> float:
    k = curve.largest
    return float(abs(curve.found[k] - curve.nominal[k]) - curve.half[k])


def _change(curve: Curve) -> str:
    k, unit = curve.largest, curve.map.unit
    sure = f"(±{curve.half[k]:.2g} {unit})"
    if curve.map.absolute:
        return f"{curve.map.what} {curve.found[k]:.3g} {unit} {sure} instead of {curve.nominal[k]:.3g} {unit}"
    at = "" if curve.pressure is None else f" and {curve.pressure:g} bar"
    where = f"at {curve.places[k]:.2g} % contraction{at}"
    return f"{curve.map.what} {curve.found[k]:+.3g} {unit} {sure} {where}"


def _coefficients(effect: Effect, actuator: str) -> list[str]:
    return [q.name for q in effect.parameters if q.name.startswith(f"{actuator}_")]


def _slopes(effect: Effect, actuator: str) -> tuple[str, ca.Function]:
    """Return which map an effect corrects, and (place, pressure) -> the correction by each coefficient."""
    names = [name.removeprefix(f"{actuator}_") for name in _coefficients(effect, actuator)]
    x, y, p = ca.SX.sym("x"), ca.SX.sym("y"), ca.SX.sym("p", len(names))
    nothing = Section("", {})
    signals = ActuatorSignals(0.0, 0.0, y, x, 0.0, 0.0, 1.0, nothing, Air(0.0, 0.0, 0.0))
    signals.opening, signals.volume = x, 1.0
    signals.volume_by_pressure = signals.volume_by_contraction = 0.0
    values = Section(effect.name, {name: p[k] for k, name in enumerate(names)})
    added = effect.expression(signals, values, ()).add
    signal = next(name for name in added if name in MAPS)
    return signal, ca.Function("slopes", [x, y], [ca.jacobian(added[signal], p)])
