# SPDX-License-Identifier: Apache-2.0
"""Which parameters a fit may move: steps, bounds, and the priors that hold them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pam_orthosis.discrepancy.systems.system import System, Values
from pam_orthosis.model.effects.base import Quantity

LOOSE = 2.0  # typical values: sd of an effect's details about them
SHAPE_SCALES = (0.05, 0.3, 1.0)  # of the shape corrections' priors: how good may the maps be?
WIDTHS = (2.0, 4.0, 8.0, 16.0)  # times its priors: what a shape correction may be once it is named
MORE = 1.01  # what is equal but for rounding is not wider


@dataclass(frozen=True)
class Free:
    """A free parameter: scale of its steps, bounds, sd (inf: none) and centre of its prior."""

    name: str
    scale: float
    lower: float
    upper: float
    sd: float
    centre: float = 0.0

    def deviation(self, values: Values) -> float:
        """Return how far the parameter is from the centre of its prior, in standard deviations."""
        return (values[self.name] - self.centre) / self.sd


def free_parameters(
    system: System, effects: Sequence[str], refined: Sequence[str] = (), scales: Values | None = None
) -> list[Free]:
    """Return nuisance parameters and those of effects.

    Args:
        refined: effects whose details are free.
        scales: shape correction -> multiple of its priors (1).
    """
    free = with_scales(system, nuisance(system), scales or {})
    for name in effects:
        if name not in system.shapes:
            free += of_effect(system, name, name in refined)
    return free


def with_scales(system: System, free: Sequence[Free], scales: Values) -> list[Free]:
    """Return free parameters with the priors of shape corrections scaled."""
    changed = []
    for one in free:
        shape, _, quantity = one.name.partition(".")
        if shape in scales:
            changed.append(replace(one, sd=scales[shape] * _prior(system, shape, quantity)))
        else:
            changed.append(one)
    return changed


def scales_of(system: System, free: Sequence[Free]) -> dict[str, float]:
    """Return the scales of the shape corrections' priors."""
    scales = {}
    for one in free:
        shape, _, quantity = one.name.partition(".")
        if shape in system.shapes:
            scales[shape] = one.sd / _prior(system, shape, quantity)
    return scales


def with_wider_shapes(system: System, free: Sequence[Free]) -> list[Free]:
    """Return free parameters with the next wider priors of shape corrections, where there are any.

    How wide they are is estimated from the coefficients that recordings show; others may be larger.
    """
    wider = {
        name: next((one for one in SHAPE_SCALES if one > MORE * scale), scale)
        for name, scale in scales_of(system, free).items()
    }
    return with_scales(system, free, wider)


def nuisance(system: System) -> list[Free]:
    """Return calibrations and shape coefficients: held by their tolerances."""
    free = [Free(one.name, one.sd, -np.inf, np.inf, one.sd) for one in system.calibrations]
    for name in system.shapes:
        for q in system.catalogue[name].parameters:
            prior = _prior(system, name, q.name)
            free.append(Free(f"{name}.{q.name}", prior, q.minimum, q.maximum, prior))
    return free


def _prior(system: System, shape: str, quantity: str) -> float:
    """Return the standard deviation of a coefficient of a shape correction; each has one."""
    prior = next(q.prior for q in system.catalogue[shape].parameters if q.name == quantity)
    assert prior is not None
    return prior


def of_effect(system: System, name: str, refined: bool = False) -> list[Free]:
    """Return the parameters of an effect that are estimated.

    Refined, the details of its shape are free too, loosely held at their typical values.
    """
    effect = system.catalogue[name]
    free = []
    for q in effect.parameters:
        if refined and not q.fitted:
            size = abs(q.typical) or q.maximum - q.minimum
            held = (q.minimum, q.maximum, LOOSE * size, q.typical)
            free.append(Free(f"{name}.{q.name}", 0.3 * size, *held))
    return free + [Free(f"{name}.{q.name}", _scale(q), q.minimum, q.maximum, np.inf) for q in effect.fitted]


def _scale(quantity: Quantity) -> float:
    """Return a typical step of an effect's parameter: the typical distance from off, or the value."""
    typical = abs(quantity.typical - (quantity.neutral or 0.0))
    return typical or 0.05 * (quantity.maximum - quantity.minimum)
