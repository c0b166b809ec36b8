# SPDX-License-Identifier: Apache-2.0
"""What is left, in words and as the contract of `gap.json`."""

from collections.abc import Callable
from typing import Any

import numpy as np

from pam_orthosis.discrepancy.answer.digits import digits
from pam_orthosis.discrepancy.systems.system import System, Values
from pam_orthosis.discrepancy.unknown.curve_fit import knots_of
from pam_orthosis.discrepancy.unknown.description import Description, holder
from pam_orthosis.discrepancy.unknown.events import Event
from pam_orthosis.discrepancy.unknown.unknown import Unknown

MOST_EVENTS = 4  # in one line
FEWEST_DIGITS = 3  # of a curve's amplitude
ALL = 0.99  # of a gap
BENT = 10.0  # the same, of one that is a parabola above all
LARGER = 1.5  # half the range of a curve over that of its shape, which is worth a word
DRIFTING, CLEARLY = 0.5, 2.0  # of the gap, that time explains; times what any other signal does


def short(system: System, unknown: Unknown) -> str:
    """Return what is unknown, in a few words."""
    if unknown.descriptions:
        return " and ".join(_short(system, one) for one in unknown.descriptions)
    more = len(unknown.events) - MOST_EVENTS
    times = _by_recording(unknown, lambda event: f"{event.time:.1f} s")
    return f"{len(unknown.events)} {_pushes(unknown)} ({times}" + (f" and {more} more)" if more > 0 else ")")


def unannounced(system: System, unknown: Unknown) -> str:
    """Return that no curve explains pushes, and at which end of a coordinate they are, if at one."""
    words = "no curve of a measured signal explains them"
    if unknown.end is None:
        return words
    end, side = unknown.end, "above" if unknown.end.above else "below"
    place, largest = (f"{value:.3g} {system.unit(end.signal)}" for value in (end.value, end.largest))
    return (
        f"{words}, and all are where {end.signal} is {side} {place}, the largest at {largest}: an end stop?"
    )


def _by_recording(unknown: Unknown, told: Callable[[Event], str]) -> str:
    """Return the first events in words, and in which recordings they are: each has a clock of its own."""
    found: dict[str, list[str]] = {}
    for event in unknown.events[:MOST_EVENTS]:
        found.setdefault(event.recording, []).append(told(event))
    return "; ".join(f"in {name} at {', '.join(many)}" for name, many in found.items())


def _short(system: System, one: Description) -> str:
    if one.is_constant:
        return f"{_name(one)} that is constant ({one.level:.3g} {one.unit})"
    period = "" if one.period is None else f"period {_with_unit(system, one, one.period)}, "
    name, signal = _name(one), one.coordinate.replace("_", " ")
    by = "over" if " of " in name else "of"
    if _whole(one) > BENT * one.amplitude[2]:
        return f"{name} {by} {signal} ({_whole(one):.3g} {one.unit})"
    return f"{name} {by} {signal} ({period}{one.amplitude[0]:.3g} {one.unit})"


def unknown_words(
    system: System, unknown: Unknown, shares: Values | None = None, carried: bool = True
) -> list[str]:
    """Return lines on what is left in an equation.

    `shares` of its gap are explained by signals; `carried`: a model file has what is described.
    """
    where = f"in the {unknown.equation} equation"
    if unknown.descriptions:
        return [line for one in unknown.descriptions for line in _words(system, one, where, carried)]
    if unknown.events:
        (equation,) = (one for one in system.equations if one.name == unknown.equation)
        several = len(equation.channels) > 1
        told = _by_recording(unknown, lambda event: _push(system, event, several))
        return [f"unknown {where}: {unannounced(system, unknown)}; {_pushes(unknown)} {told}"]
    if _drifts(shares or {}):
        return [f"unknown {where}: it changes with time: a sensor's zero that drifts, what wears or warms?"]
    tried = f"up to {knots_of(system)[-1]} points were tried"
    return [
        f"unknown {where}: no curve over one measured signal, added to the equation, removes half of the"
        f" held-out gap ({tried}); an error of a sensor that depends on a signal was not tried"
    ]


def _pushes(unknown: Unknown) -> str:
    return "push" if len(unknown.events) == 1 else "pushes"


def _drifts(shares: Values) -> bool:
    """Return whether time explains most, and clearly more than a signal: by chance a slow one follows it."""
    others = max((share for name, share in shares.items() if name != "time"), default=0.0)
    return shares.get("time", 0.0) >= max(DRIFTING, CLEARLY * others)


def _push(system: System, event: Event, named: bool) -> str:
    unit, of = system.entries_of(event.channel)[0].unit, f" of {event.channel}" if named else ""
    return f"{event.time:.1f} s ({event.size:+.2g} {unit}{of} for {event.seconds:.1f} s)"


def _words(system: System, one: Description, where: str, carried: bool) -> list[str]:
    if one.is_constant:
        return [f"unknown {where}: {_short(system, one)}; {_removes(one)}"]
    _, low, high = one.amplitude
    shown = digits(low, high, FEWEST_DIGITS)
    ends = " and ".join(_with_unit(system, one, end) for end in (one.places[0], one.places[-1]))
    size = "half its height" if one.period is None else "amplitude"
    next_best = "" if one.runner_up is None else f" (one over {one.runner_up[0]}: {one.runner_up[1]:.0%})"
    return [
        f"unknown {where}: {_short(system, one)}, {size} {low:.{shown}g} .. {high:.{shown}g} {one.unit}"
        f" between {ends}{_with_parabola(one)}; {_removes(one)}{next_best}",
        *resemblance(one),
        *(_carried(system, one) if carried else ()),
    ]


def resemblance(one: Description) -> list[str]:
    """Return a line on the textbook effect that has a curve's shape; none if none has."""
    return (
        [] if one.shape_of is None else [f"it has the shape of {one.shape_of}; other causes may have it too"]
    )


def _removes(one: Description) -> str:
    """Return how much of the gap goes: of the squares, of which little is still many times the noise."""
    share = f"{one.reduced:.0%}" if one.reduced < ALL else f"more than {ALL:.0%}"
    return f"removes {share} of the squares of the held-out gap"


def _with_parabola(one: Description) -> str:
    """Return how large a curve is with the parabola that other parameters may do as well, if it is larger."""
    larger = _whole(one) > LARGER * one.amplitude[0]
    words = (
        f" ({_whole(one):.3g} {one.unit} with a parabola that may be due to the model's parameters instead)"
    )
    return words if larger else ""


def _whole(one: Description) -> float:
    """Return half the range of a curve, with a parabola that its shape is without."""
    return 0.5 * float(np.ptp(one.values))


def _carried(system: System, one: Description) -> list[str]:
    """Return a line on what becomes of a description in a model file; none if there is no such file."""
    if not system.entries:
        return []
    known = holder(system, one)
    if known is None:
        why = "" if system.changed is None else ": the model has a curve there already"
        return [f"no model file can carry this description{why}"]
    first = one.channel == system.channels[0].name and one.coordinate != "time"
    use = "controllers and gap use it" if first else "gap uses it, controllers do not"
    use = use if system.changed is None else "gap uses it"
    return [f"a model file carries this description, which is no cause, as {system.branch}.{known[0]}: {use}"]


def unknown_as_dict(system: System, unknown: Unknown | None, carried: bool = True) -> dict[str, Any] | None:
    """Return what is left as JSON-ready values; `carried`: a model file has what is described."""
    if unknown is None:
        return None
    curves = [_curve_as_dict(system, one, carried) for one in unknown.descriptions]
    return {
        "equation": unknown.equation,
        "curve": curves[0] if curves else None,
        "other_curves": curves[1:],
        "events": [vars(event) for event in unknown.events],
    }


def _curve_as_dict(system: System, one: Description, carried: bool) -> dict[str, Any]:
    holding = holder(system, one) if carried else None
    return {
        "channel": one.channel, "enters_as": one.entry.name or "rate", "coordinate": one.coordinate,
        "unit": one.unit, "period": one.period, "harmonics": one.harmonics or None,
        "carried_as": holding[0] if holding else None,
        "reduced": one.reduced, "level": one.level, "amplitude": list(one.amplitude),
        "places": one.places.tolist(), "values": one.values.tolist(), "without_parabola": one.shape.tolist(),
        "standard_deviations": one.spread.tolist(), "shape_of": one.shape_of,
    }  # fmt: skip


def _name(one: Description) -> str:
    kind = "acceleration" if one.unit.endswith("/s^2") else "rate"
    return f"unknown {one.entry.name or f'{kind} of {one.channel}'}".replace("_", " ")


def _with_unit(system: System, one: Description, value: float) -> str:
    return f"{value:.3g} {system.unit(one.coordinate)}".rstrip()
