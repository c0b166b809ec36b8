# SPDX-License-Identifier: Apache-2.0
"""What is left, in words and as the contract of `gap.json`."""

from typing import Any

from pam_orthosis.discrepancy.description import Description, holder, unit_of
from pam_orthosis.discrepancy.system import System
from pam_orthosis.discrepancy.unknown import Unknown

MOST_EVENTS = 4  # in one line


def short(system: System, unknown: Unknown) -> str:
    """Return what is unknown, in a few words."""
    one = unknown.description
    if one is not None:
        period = "" if one.period is None else f"period {_with_unit(system, one, one.period)}, "
        size = f"{one.amplitude[0]:.3g} {one.unit}"
        return f"{_name(system, one)} of {one.coordinate.replace('_', ' ')} ({period}{size})"
    times = [f"{event.time:.1f} s" for event in unknown.events[:MOST_EVENTS]]
    more = len(unknown.events) - len(times)
    return f"{len(unknown.events)} pushes ({', '.join(times)}" + (f" and {more} more)" if more > 0 else ")")


def unknown_words(system: System, unknown: Unknown) -> list[str]:
    """Return lines on what is left in an equation."""
    one, where = unknown.description, f"in the {unknown.equation} equation"
    if one is not None:
        _, low, high = one.amplitude
        ends = " and ".join(_with_unit(system, one, end) for end in (one.places[0], one.places[-1]))
        next_best = "" if one.runner_up is None else f" (next: {one.runner_up[0]}, {one.runner_up[1]:.0%})"
        return [
            f"unknown {where}: {short(system, unknown)}, amplitude {low:.3g} .. {high:.3g} {one.unit} between"
            f" {ends}; removes {one.reduced:.0%} of the held-out gap{next_best}",
            *_carried(system, one),
        ]
    if unknown.events:
        unit = unit_of(system, next(e for e in system.equations if e.name == unknown.equation).channels[0])
        pushes = [
            f"{event.time:.1f} s ({event.size:+.2g} {unit} for {event.seconds:.1f} s)"
            for event in unknown.events[:MOST_EVENTS]
        ]
        return [f"unknown {where}: of nothing that was measured; pushes at {', '.join(pushes)}"]
    return [f"unknown {where}: it depends on nothing that was measured, alone"]


def _carried(system: System, one: Description) -> list[str]:
    """Return a line on what becomes of a description in a model file; none if there is no such file."""
    if not system.described:
        return []
    known = holder(system, one)
    if known is None:
        return ["no model file can carry this description"]
    first = one.channel == system.channels[0].name
    use = "controllers and gap use it" if first else "gap uses it, controllers do not"
    return [f"a model file carries this description, which is no cause, as {system.branch}.{known[0]}: {use}"]


def unknown_as_dict(system: System, unknown: Unknown | None) -> dict[str, Any] | None:
    """Return what is left as JSON-ready values."""
    if unknown is None:
        return None
    one = unknown.description
    curve = None if one is None else {
        "channel": one.channel, "coordinate": one.coordinate, "unit": one.unit, "period": one.period,
        "carried_as": (holder(system, one) or (None,))[0],
        "reduced": one.reduced, "amplitude": list(one.amplitude), "places": one.places.tolist(),
        "values": one.values.tolist(), "without_parabola": one.shape.tolist(),
        "standard_deviations": one.spread.tolist(),
    }  # fmt: skip
    return {
        "equation": unknown.equation,
        "curve": curve,
        "events": [vars(event) for event in unknown.events],
    }


def _name(system: System, one: Description) -> str:
    if push := system.push(one.channel):
        return f"unknown {push[1]}"
    return f"unknown rate of {one.channel.replace('_', ' ')}"


def _with_unit(system: System, one: Description, value: float) -> str:
    return f"{value:.3g} {system.unit(one.coordinate) or '(SI)'}"
