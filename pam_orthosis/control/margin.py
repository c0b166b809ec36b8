# SPDX-License-Identifier: Apache-2.0
"""Margins of the closed loop: how far the hardware may change before the machine follows badly.

The emulated hardware is changed one thing at a time, away from what it is; the controllers keep their gains
and their nominal model. Each value is a run of the closed loop without ROS.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.delay import NANOSECONDS, computing_ns, line_ns
from pam_orthosis.model.deviations import DEVIATIONS
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant

SHARE = 0.1  # of a change to which a limit is found, or `FINEST` of the first step
FINEST = 0.125
MS, BAR = 1e-3, 1e5


@dataclass(frozen=True)
class Perturbation:
    """Something of the emulated hardware that changes.

    Attributes:
        nominal: its value in the hardware as it is, in `unit`.
        step: the first change that is tried; each further one is twice as large.
        least, most: where it ends.
        overrides: value -> parameters of the hardware that has it.
    """

    name: str
    unit: str
    meaning: str
    nominal: float
    step: float
    least: float
    most: float
    overrides: Callable[[float], dict[str, float]]

    def ladder(self, direction: str) -> list[float]:
        """Return the values to try, from the nominal one to the end of a direction, "more" or "less"."""
        end = self.most if direction == "more" else self.least
        way, change, values = abs(end - self.nominal), self.step, [self.nominal]
        while change < way:
            values.append(self.nominal + math.copysign(change, end - self.nominal))
            change *= 2
        return [*values, end] if way else values


class _Factor(NamedTuple):
    """Parameters of the hardware that change by one factor; value and unit of the first one count.

    Attributes:
        share: of the nominal value, the first step.
        low, high: factors between which they change, as far as their rows allow.
        size: where the first parameter is a factor: size and name of a unit, and the parameter of that unit.
    """

    name: str
    meaning: str
    keys: tuple[str, ...]
    share: float
    low: float
    high: float
    size: tuple[float, str, str] | None = None


DELAY = "delay"
FACTORS = (
    _Factor(
        "friction", "dry friction of the joint, the viscous in proportion",
        ("plant.effects.joint_friction.coulomb", "plant.effects.viscous_friction.viscosity"), 0.5, 0.0, 10.0,
    ),
    _Factor(
        "friction", "dry friction of the carriage, the viscous in proportion",
        tuple(f"plant.effects.carriage_friction.{name}" for name in ("coulomb", "viscosity")), 0.5, 0.0, 10.0,
    ),
    _Factor(
        "hysteresis", "half width of the muscles' force loop at 6 bar",
        ("plant.effects.muscle_hysteresis.half_width",), 0.5, 0.0, 10.0,
    ),
    _Factor(
        "valve frequency", "natural frequency of the valve's spool: less is slower",
        ("plant.effects.valve_lag.natural_frequency",), 0.1, 0.05, 2.0,
    ),
    _Factor(
        "supply", "supply pressure, absolute",
        ("plant.deviation.supply_pressure",), 0.05, 0.3, 1.5, (BAR, "bar", "valve.supply_pressure"),
    ),
    _Factor(
        "mass", "true / nominal mass of the apparatus, a person's in proportion",
        ("plant.deviation.moving_mass", "plant.deviation.person_mass"), 0.1, 0.5, 2.0,
    ),
)  # fmt: skip
NAMES = tuple(dict.fromkeys((DELAY, *(factor.name for factor in FACTORS))))
VALVE = "plant.delay.valve"
LINE = (VALVE, *(f"plant.delay.{part}" for part in ("computing", "converter", "hose_length")))


class Limit(NamedTuple):
    """Between which values the error reaches a threshold; `reached` is None if it does nowhere."""

    kept: float
    reached: float | None


def limits(
    error: Callable[[float], float], ladder: Sequence[float], thresholds: Sequence[float]
) -> tuple[list[Limit], dict[float, float]]:
    """Return the limit of each threshold, and all errors that were looked at, by value.

    The ladder is climbed until the highest threshold is reached; then each limit is bisected, with the errors
    that are known already, to the resolution that `SHARE` and `FINEST` give. Of several crossings the limit
    is the first that the ladder shows.

    Args:
        error: value -> error, infinite where there is none.
        ladder: monotonous values; the first is the nominal one.
    """
    nominal, known = ladder[0], {}
    for value in ladder:
        known[value] = error(value)
        if known[value] >= max(thresholds):
            break
    finest = FINEST * abs(ladder[1] - nominal) if len(ladder) > 1 else 0.0
    found = []
    for threshold in thresholds:
        while (limit := _bracket(known, nominal, threshold)).reached is not None:
            if abs(limit.reached - limit.kept) <= max(finest, SHARE * abs(limit.reached - nominal)):
                break
            middle = 0.5 * (limit.kept + limit.reached)
            known[middle] = error(middle)
        found.append(limit)
    return found, known


def _bracket(known: Mapping[float, float], nominal: float, threshold: float) -> Limit:
    kept = nominal
    for value in sorted(known, key=lambda value: abs(value - nominal)):
        if known[value] >= threshold:
            return Limit(kept, value)
        kept = value
    return Limit(kept, None)


def maximum_error(parameters: Parameters) -> float:
    """Return the maximum error of a run of `scenario.duration`, rad or m; infinite if the joint is lost.

    It is lost when the error is beyond `control.guard.tracking_error`, when a guard vents, and when the
    actuators cannot hold it at the start.
    """
    scenario = parameters.scenario
    try:
        plant = Plant(parameters, scenario.seed)
    except OrthosisError:
        return math.inf
    loop = ClosedLoop(parameters, scenario.seed, plant=plant)
    run = loop.run(round(scenario.duration / scenario.control_period))
    q = parameters.declared.coordinate.name
    worst = float(np.abs(run[f"reference_{q}"] - run[q]).max())
    vented = any(health["vented_samples"] for health in loop.health().values())
    return math.inf if vented or not worst <= parameters.control.guard.tracking_error else worst


def thresholds(parameters: Parameters, nominal: float) -> tuple[float, float]:
    """Return the errors at which the nominal one has doubled and at which the joint is lost."""
    lost = parameters.control.guard.tracking_error
    growth = 2.0  # of the maximum error: the first limit
    return min(growth * nominal, lost), lost


def perturbations(parameters: Parameters) -> dict[str, Perturbation]:
    """Return by name what is changed: those of `NAMES` of which the hardware has some."""
    modified = [_delay(parameters), *(_scaled(parameters, factor) for factor in FACTORS)]
    return {one.name: one for one in modified if one is not None}


def _scaled(parameters: Parameters, factor: _Factor) -> Perturbation | None:
    known, first = parameters.flat(), factor.keys[0]
    if not _present(known, first):
        return None
    keys = [key for key in factor.keys if _present(known, key)]
    bounds = {key: parameters.row(key).bounds for key in keys}
    low = max(factor.low, *(bounds[key][0] / known[key] for key in keys))
    high = min(factor.high, *(bounds[key][1] / known[key] for key in keys))
    size, unit, whole = factor.size or (1.0, parameters.row(first).unit, "")
    nominal = known[first] * known.get(whole, 1.0) / size

    def overrides(value: float) -> dict[str, float]:
        changed = {key: known[key] * (value / nominal) for key in keys}
        return {key: min(max(each, bounds[key][0]), bounds[key][1]) for key, each in changed.items()}

    step, least, most = (share * nominal for share in (factor.share, low, high))
    return Perturbation(factor.name, unit, factor.meaning, nominal, step, least, most, overrides)


def _present(known: Mapping[str, Any], key: str) -> bool:
    """Return whether the hardware has what a parameter says, or what a deviation changes."""
    branch, _, name = key.rpartition(".")
    changed = DEVIATIONS[name] if branch == "plant.deviation" else (key,)
    there = bool(known.get(key)) and any(each in known for each in changed)
    return there and known.get(f"{branch}.enabled", True)


def _delay(parameters: Parameters) -> Perturbation:
    """Return the dead time from a sample to the flow that answers it.

    More is more of the valve's; less is less of all parts but the sensors, in proportion.
    """
    known = parameters.flat()
    parts = {key: known[key] for key in LINE}
    line = (computing_ns(parameters) + line_ns(parameters)) / NANOSECONDS
    names = parameters.declared.names
    sensors = [f"plant.effects.{name}_pressure_delay.delay" for name in names]
    fixed = sum(known[key] for key in sensors if _present(known, key)) / len(names)
    if _present(known, key := "plant.effects.valve_delay.delay"):
        fixed += known[key]
    nominal, longest = (fixed + line) / MS, parameters.row(VALVE).bounds[1]

    def overrides(value: float) -> dict[str, float]:
        if value >= nominal:
            return {VALVE: min(parts[VALVE] + (value - nominal) * MS, longest)}
        share = max(value * MS - fixed, 0.0) / line
        return {key: share * part for key, part in parts.items()}

    meaning = "dead time of the loop: computing, converter, valve, hose, pressure sensors"
    longest_delay = 50.0  # ms
    most = max(nominal, min(longest_delay, nominal + (longest - parts[VALVE]) / MS))
    return Perturbation(DELAY, "ms", meaning, nominal, 1.0, fixed / MS, most, overrides)
