# SPDX-License-Identifier: Apache-2.0
"""What may be wrong with any apparatus that a user describes: parameters, sensors, times of its signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.model.effects import pade
from pam_orthosis.model.effects.base import Contribution, Effect, Quantity

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.systems.builder import Input, Model, Parameter
    from pam_orthosis.discrepancy.systems.system import Channel

WRONG, DELAY, LAG, MEASURED = "wrong_", "inputs_delay", "_lag", "measured_"
ALL, FOLLOWS, OFFSET = "inputs", "_follows", "offset"
LEAST, TYPICAL, REACH = 3.0, 6.0, 100.0  # tolerances: worth a name, to look for, and at most
LONGEST = 0.5  # s
STARTS = 0.005, -0.005, -0.02, 0.05, -0.05, 0.1, 0.2, 0.35  # s
SHORTEST, SLOWEST = 5.0e-4, 30.0  # s, of a sensor's delay or lag
LEAST_ZERO, FARTHEST_ZERO = 0.01, 1.0e4  # units of reports: what tables show, and at most
SOURCE = "a mistake that any apparatus may have"


def implied(model: Model) -> list[Effect]:
    """Return what may be missing in any system: values of parameters, delays, lags, zeros of sensors.

    A channel that is alone is late as the inputs are early. What a user says of what a sensor shows, he knows
    of its zero.
    """
    inputs, channels, stages = model.inputs, model.channels, {one.stage for one in model.effects}
    several = inputs if len(inputs) > 1 else ()
    shown = [one for one in channels if one.state is not None]
    return [
        *(wrong_parameter(one) for one in model.parameters if one.tolerance),
        *([late_inputs(inputs)] if inputs else []),
        *(late_input(one) for one in several),
        *(late_channel(one) for one in shown if len(channels) > 1),
        *(lagging_channel(one) for one in shown),
        *(lagging_input(one.name, one.name if several else ALL) for one in inputs),
        *(zero(one, model.limits.get(one.name)) for one in channels if f"{MEASURED}{one.name}" not in stages),
    ]


def wrong_parameter(one: Parameter) -> Effect:
    """Return the candidate that a parameter with a tolerance has another value, as a deviation."""
    step, farthest = TYPICAL * one.tolerance, REACH * one.tolerance
    return Effect(
        f"{WRONG}{one.name}",
        "",  # it enters as a parameter
        (Quantity(VALUE, step, one.unit, -farthest, farthest, one.meaning, 0.0),),
        lambda *_: Contribution({}),
        physics=f"The nominal model has another value of {one.name}: {one.meaning}.",
        source=SOURCE,
        starts=({VALUE: -step},),
        minimum_effect=LEAST * one.tolerance,
    )


def parameter_of(effect: Effect) -> str:
    """Return the parameter that one of these candidates takes to be wrong; empty if none."""
    return "" if effect.stage or effect.states else effect.name.removeprefix(WRONG)


def late_inputs(inputs: Sequence[Input]) -> Effect:
    """Return the candidate that all inputs act later than they are stamped, or earlier."""
    return Effect(
        DELAY,
        "",  # it enters where inputs are read
        (Quantity("delay", 0.02, "s", -LONGEST, LONGEST, "by which inputs act later than stamped", 0.0),),
        lambda *_: Contribution({}),
        physics="Electronics and drives answer after a dead time, a sensor shows the past, or the clocks of "
        "inputs and channels differ.",
        source=SOURCE,
        states=tuple(f"{one.name}_delayed" for one in inputs),
        starts=tuple({"delay": seconds} for seconds in STARTS),
        minimum_effect=3.0e-4,
        late=lambda p: p.delay,
    )


def late_input(one: Input) -> Effect:
    """Return the candidate that one of several inputs acts later than it is stamped, or earlier."""
    return replace(
        late_inputs([one]),
        name=f"{one.name}_delay",
        physics=f"What {one.name} drives answers after a dead time, or the clocks of the inputs differ.",
        states=(f"{one.name}_late",),
        late_of=one.name,
    )


def late_channel(channel: Channel) -> Effect:
    """Return the candidate that a channel shows the past as it was, or that its clock differs."""
    stage = f"{MEASURED}{channel.name}"
    return Effect(
        f"{channel.name}_delay",
        stage,
        (Quantity("delay", 0.01, "s", SHORTEST, LONGEST, f"age of {channel.name}"),),
        lambda _s, p, own: Contribution({stage: -pade.lost(own, p.delay)}),
        physics="Filter, bus or driver deliver the value late, or its clock differs; in the equations the "
        "delay is represented by its Pade approximation (2, 3).",
        source=SOURCE,
        states=tuple(f"{channel.name}_past_{letter}" for letter in "abc"),
        starts=({"delay": 0.002}, {"delay": 0.05}, {"delay": 0.2}),
        minimum_effect=3.0e-4,
        advance=lambda p: {channel.name: p.delay},
    )


def lagging_channel(channel: Channel) -> Effect:
    """Return the candidate that a channel's sensor follows by a lag of the first order."""
    stage = f"{MEASURED}{channel.name}"
    return Effect(
        f"{channel.name}{LAG}",
        stage,
        (Quantity("time", 0.02, "s", SHORTEST, SLOWEST, f"time constant with which {channel.name} follows"),),
        lambda _s, _p, own: Contribution({stage: -own[0]}),
        physics="A filter, a float or the heat capacity of a sensor lets its value follow.",
        source=SOURCE,
        states=(f"{channel.name}_behind",),
        starts=({"time": 0.002}, {"time": 0.2}, {"time": 2.0}),
        minimum_effect=3.0e-4,
    )


def lagging_input(name: str, what: str) -> Effect:
    """Return the candidate that what an input drives follows it by a lag of the first order."""
    return Effect(
        f"{what}{LAG}",
        "",  # it enters where inputs are read
        (Quantity("time", 0.02, "s", SHORTEST, SLOWEST, f"time constant with which {name} acts"),),
        lambda *_: Contribution({}),
        physics=f"A valve, a drive or an amplifier follows {name}.",
        source=SOURCE,
        states=(f"{name}{FOLLOWS}",),
        starts=({"time": 0.002}, {"time": 0.2}, {"time": 2.0}),
        minimum_effect=3.0e-4,
    )


def is_lag(effect: Effect) -> bool:
    """Return whether an effect is one of these candidates that follow by a lag of the first order."""
    return bool(effect.states) and effect.source == SOURCE and effect.name.endswith(LAG)


def input_of(effect: Effect) -> str:
    """Return the input that acts by a lag with one of these candidates; empty if none does."""
    lags = not effect.stage and effect.late is None and effect.states
    return effect.states[0].removesuffix(FOLLOWS) if lags else ""


def zero(channel: Channel, limits: tuple[float, float] | None) -> Effect:
    """Return the candidate that a channel shows a constant more than there is, or less."""
    # a factor or a range that is none is refused later, in words
    stage, unit = f"{MEASURED}{channel.name}", 1.0 / (abs(channel.report_factor) or 1.0)
    ends = limits if isinstance(limits, Sequence) and len(limits) == 2 else (0.0, FARTHEST_ZERO * unit)
    reach = ends[1] - ends[0]
    return Effect(
        f"{channel.name}_zero",
        stage,
        (Quantity(OFFSET, min(unit, 0.1 * reach), channel.unit, -reach, reach, f"of {channel.name}", 0.0),),
        lambda _s, p, _own: Contribution({stage: p.offset}),
        physics="The zero of a sensor has moved, or was not set.",
        source=SOURCE,
        minimum_effect=LEAST_ZERO * unit,
    )


def is_zero(effect: Effect) -> bool:
    """Return whether one of these candidates is a sensor's zero."""
    return bool(effect.stage) and not effect.states


def channel_of(effect: Effect) -> str:
    """Return the channel of whose sensor one of these candidates is; empty if of none."""
    return effect.stage.removeprefix(MEASURED)


def sensor_rates(effect: Effect, own: Sequence[Any], rate: Any, values: Any) -> tuple[Any, ...]:
    """Return the rates of the states of a sensor that is late or lags, given the rate of what it shows."""
    if effect.advance is None:
        return (rate - own[0] / values.time,)
    return pade.chain(tuple(own), rate, values.delay)
