# SPDX-License-Identifier: Apache-2.0
"""What the gap workflow has described and could not name: a curve over one signal, added to an equation.

The nominal model alone can have it. It is no effect of the catalogue: it says what is missing, not why.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import casadi as ca

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Contribution, Effect
from pam_orthosis.model.rows import Row, Section, rounded
from pam_orthosis.model.signals import Expression, Signals

KNOTS = 20
# what is described of an actuator: name, stage, signal to which it is added (a gain: in shares of it), unit
ENTRIES = (
    ("rate", "rate", "pressure_rate", "Pa/s"),
    ("voltage", "command", "voltage", "V"),
    ("gain", "opening", "opening", "-"),
)
SOURCE = "described by the gap workflow"


@dataclass(frozen=True)
class Described(Effect):
    """A curve over one of some signals.

    Attributes:
        unit: of what is added.
        over: the signals.
    """

    unit: str = ""
    over: tuple[str, ...] = ()

    def rows(self, prefix: str) -> list[Row]:
        """Return the configuration rows below a prefix, switched off."""

        def row(name: str, value: bool | str | list[float], unit: str, meaning: str, *options: str) -> Row:
            return Row(f"{prefix}.{self.name}.{name}", value, unit, None, None, meaning, SOURCE, options)

        places, ends = [float(k) for k in range(KNOTS)], "straight lines between, constant beyond"
        return [
            row("enabled", False, "-", f"switches on: {self.title}"),
            row("coordinate", self.over[0], "-", "signal that it depends on", *self.over),
            row("places", places, "of the signal", "values of the signal, rising"),
            row("values", [0.0] * KNOTS, self.unit, f"what is added at these places; {ends}"),
        ]


def described(coordinate: str, effort: str, unit: str, actuators: Sequence[str]) -> dict[str, Effect]:
    """Return what can be described of a machine: its effort; rate, voltage and valve gain of actuators."""
    over = (
        coordinate, "velocity", "time",
        *(f"{name}_{signal}" for signal in ("pressure", "voltage") for name in actuators),
    )  # fmt: skip

    def value(s: Signals, p: Section) -> Expression:
        signals = {coordinate: s.coordinate, "velocity": s.velocity, "time": s.time}
        for name, one in s.actuators.items():
            signals |= {f"{name}_pressure": one.pressure, f"{name}_voltage": one.voltage}
        return curve(signals[p.coordinate], p.places, p.values)

    def of_effort(s: Signals, p: Section, _states: tuple[Expression, ...]) -> Contribution:
        return Contribution({"effort": value(s, p)})

    def of_gas(name: str, field: str, s: Signals, p: Section, _: tuple[Expression, ...]) -> Contribution:
        share = s.actuators[name].opening if field == "opening" else 1
        return Contribution({}, (), {name: {field: share * value(s, p)}})

    physics = "Nothing of the catalogue: what recordings ask for beside it, as a curve over one signal."
    first = Described(
        f"unknown_{effort}", "torque", (), of_effort, physics, SOURCE, coordinate=coordinate,
        unit=unit, over=over,
    )  # fmt: skip
    others = [
        Described(
            f"{name}_unknown_{what}", stage, (), partial(of_gas, name, field), physics,
            SOURCE, coordinate=f"{name}_pressure", unit=unit, over=over,
        )
        for name in actuators
        for what, stage, field, unit in ENTRIES
    ]  # fmt: skip
    return {one.name: one for one in (first, *others)}


def curve(x: Expression, places: Sequence[float], values: Sequence[float]) -> Expression:
    """Return straight lines between values at rising places, constant beyond them."""
    y = ca.SX(values[0])
    for (a, b), (first, last) in zip(pairwise(places), pairwise(values), strict=True):
        if not b > a:
            raise OrthosisError(f"a described curve has its places in a row that rises: {b:g} follows {a:g}")
        y += (last - first) * ca.fmin(ca.fmax((x - a) / (b - a), 0), 1)
    return y


def settings(coordinate: str, places: Sequence[float], values: Sequence[float]) -> Mapping[str, object]:
    """Return the settings of a curve; behind its last place the last value goes on."""
    more = KNOTS - len(places)
    step = places[-1] - places[-2]
    behind = [places[-1] + step * (k + 1) for k in range(more)]
    return short(coordinate, [*places, *behind], [*values, *[values[-1]] * more])


def short(coordinate: str, places: Sequence[float], values: Sequence[float]) -> Mapping[str, object]:
    """Return the settings of a curve where it may have any number of places."""
    return {
        "enabled": True,
        "coordinate": coordinate,
        "places": rounded(places),
        "values": rounded(values),
    }
