# SPDX-License-Identifier: Apache-2.0
"""Do recorded values lie where values in their unit can? Neither a table nor a driver's bag names its units.

A logger that drops out writes a few single samples far outside, most often 0: they are bridged, and said.
"""

from collections.abc import Mapping

import numpy as np

from pam_orthosis.bag.read import PLAUSIBLE
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.errors import OrthosisError

LEAST_SHARE = 0.79  # of the ambient pressure, below which no actuator open to the air can fall
MOST_OUTSIDE = 0.01  # of the samples: more are no dropouts
LONGEST = 3  # samples of a jump
ABSURD, LARGEST = 1e9, 1e30  # times the range of the middle half of a signal of any unit; in any unit
TIMES = 10.0  # the deviation from the neighbours that all but a hundredth stay below
SHARE = 0.99


def in_range(
    name: str, system: System, signals: Mapping[str, np.ndarray], written: Mapping[str, str]
) -> tuple[dict[str, np.ndarray], tuple[str, ...]]:
    """Return signals with a few samples of channels bridged that are out of range, and remarks on them.

    `written`: signal -> its range in the unit that a table gives, if it gives one.

    Raises:
        OrthosisError: many samples are out of range, or some of an input; they may be in another unit.
    """
    inside, remarks = dict(signals), []
    for key in (one for one in signals if one != "time"):
        values = signals[key]
        least, most = _range(system, key, values)
        outside = (values < least) | (values > most)
        if not outside.any():
            continue
        first = int(np.argmax(outside)) + 1
        at = f"in {outside.sum()} of {len(values)} samples, the first in row {first} of numbers"
        if key in system.inputs or not _drops_out(values, outside):
            raise OrthosisError(f"{name}: {_refusal(system, key, values, at, written.get(key, ''))}")
        inside[key] = _bridged(values, outside)
        remarks.append(f"{name}: {key} leaves {least:g} to {most:g} {system.unit(key)} {at}: bridged")
    return inside, tuple(remarks)


def _range(system: System, key: str, values: np.ndarray) -> tuple[float, float]:
    least, most = system.limits.get(key) or PLAUSIBLE.get(system.unit(key)) or _measurable(values)
    return max(least, _least_pressure(system, key)), most


def _measurable(values: np.ndarray) -> tuple[float, float]:
    """Return between which values a signal can be that has most of these: no sensor resolves more."""
    known = values[~np.isnan(values)]
    if not len(known):
        return -LARGEST, LARGEST
    low, high = np.quantile(known, (0.25, 0.75))
    reach = min(ABSURD * (high - low) or LARGEST, LARGEST)
    return float(low - reach), float(high + reach)


def _least_pressure(system: System, key: str) -> float:
    """Return the least absolute pressure; -inf for what is none."""
    return LEAST_SHARE * system.ambient if system.is_absolute(key) else -np.inf


def _drops_out(values: np.ndarray, outside: np.ndarray) -> bool:
    """Return whether what is outside are a few short jumps, as no signal makes that is in another unit."""
    kept = np.flatnonzero(~outside)
    runs = np.diff(np.concatenate([[-1], kept, [len(values)]])) - 1
    if outside.sum() > MOST_OUTSIDE * np.isfinite(values).sum() or runs.max() > LONGEST:
        return False
    bridged = _bridged(values, outside)
    usual = np.nanquantile(np.abs(bridged[1:-1] - 0.5 * (bridged[:-2] + bridged[2:])), SHARE)
    return bool(np.abs(values - bridged)[outside].min() > TIMES * usual)


def _bridged(values: np.ndarray, outside: np.ndarray) -> np.ndarray:
    kept = np.flatnonzero(~outside & ~np.isnan(values))
    bridged: np.ndarray = values.copy()
    bridged[outside] = np.interp(np.flatnonzero(outside), kept, values[kept])
    return bridged


def _refusal(system: System, key: str, values: np.ndarray, at: str, written: str) -> str:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    said = f"{key} from {low:g} to {high:g}" + (f" {system.unit(key)} ({written})" if written else "")
    meant = "in another unit than that" if written else "in bar"
    if low < (bound := _least_pressure(system, key)):
        return (
            f"{said} is no absolute pressure in Pa {at}; it is {bound:g} or more where the ambient one is"
            f" {system.ambient:g}: {meant}, or gauge, or does the logger drop out? At altitude give the"
            " ambient pressure as valve.ambient_pressure in --model, as `ambient` of a system of your own"
        )
    least, most = _range(system, key, values)
    flipped = least <= -high and -low <= most
    sign = f", or turn its sign round by --columns {key}=-COLUMN" if flipped else ""
    wider = "" if key in system.limits or system.changed is None else ", or give the Model `limits` for it"
    range_ = f"{least:g} to {most:g} {system.unit(key)}"
    return f"{said} leaves {range_} {at}; check its unit and its zero{sign}{wider}"
