# SPDX-License-Identifier: Apache-2.0
"""Plots of the gap page: corrections of static maps, what the nominal model says against what was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pam_orthosis.discrepancy.curves import Curve
from pam_orthosis.report.plots import AFTER, BEFORE, OF_ACTUATORS, REFERENCE, Plot, Trace, line

DASHES = ("solid", "dash", "dot")


def plots(found: Sequence[Curve]) -> list[Plot]:
    """Return for each actuator what was found less the nominal model; first both, where that is not zero."""
    names = dict.fromkeys(curve.actuator for curve in found)
    groups = [[curve for curve in found if curve.actuator == name] for name in names]
    return [
        plot for own in groups for plot in ([_against(own[0])] if own[0].map.absolute else []) + [_less(own)]
    ]


def _against(curve: Curve) -> Plot:
    of = curve.map
    title = f"{_whose(curve)}: nominal model against what was found, with its 95 % interval"
    alt, name = f"{title}: {_spoken(curve)}", f"{of.what} / {of.unit}"
    return Plot(title, alt, f"{of.over} / %", name, _both(curve), (0.0,), height=340)


def _less(own: Sequence[Curve]) -> Plot:
    of, alone = own[0].map, len(own) == 1
    title = f"{_whose(own[0])}: found less the nominal model, which is the dashed line"
    data = _banded(own[0], AFTER, True) if alone else [_difference(k, one) for k, one in enumerate(own)]
    alt, name = f"{title}: {'; '.join(map(_spoken, own))}", f"{of.what}, difference / {of.unit}"
    return Plot(title, alt, f"{of.over} / %", name, data, (0.0,), height=340)


def _whose(curve: Curve) -> str:
    return f"{curve.actuator.capitalize()}, {curve.map.what}"


def _both(curve: Curve) -> list[Trace]:
    nominal = line(curve.places, curve.nominal, "nominal model", BEFORE, "dash", 2.0)
    return [nominal, *_banded(curve, AFTER)]


def _banded(curve: Curve, colour: str, less: bool = False) -> list[Trace]:
    """Return what was found between the ends of its interval; `less` the nominal value."""
    found = curve.found - curve.nominal if less else curve.found
    low, high = found - curve.half, found + curve.half
    return [
        line(curve.places, found, "found", colour, width=2.4),
        line(curve.places, low, "95 %, lower", REFERENCE, "dot"),
        line(curve.places, high, "95 %, upper", REFERENCE, "dot"),
    ]


def _difference(k: int, curve: Curve) -> Trace:
    sure = f"±{np.median(curve.half):.2g} {curve.map.unit}"
    name = f"at {curve.pressure:g} bar ({sure})"
    return line(curve.places, curve.found, name, OF_ACTUATORS[k], DASHES[k % len(DASHES)], 2.4)


def _spoken(curve: Curve) -> str:
    k, unit = curve.largest, curve.map.unit
    at = "" if curve.pressure is None else f"at {curve.pressure:g} bar "
    return (
        f"{at}{curve.found[k]:.3g} {unit} found, {curve.nominal[k]:.3g} {unit} nominal,"
        f" at {curve.places[k]:.3g} % {curve.map.over}"
    )
