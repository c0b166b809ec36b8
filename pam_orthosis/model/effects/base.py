# SPDX-License-Identifier: Apache-2.0
"""What an effect is: one physical phenomenon that a model can have or miss.

The plant, the controllers' model and the gap workflow use the same object. An effect adds to the
signals of one stage of the model (see `STAGES`), may have states of its own, and is switched on by
one line of YAML: `effects.NAME.enabled: true`. A new effect is one file in this folder. It is written for a
kind of thing (see `Effect.of`); a machine has an instance of it for what it has of that kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from pam_orthosis.model.rows import Row, Section
from pam_orthosis.model.signals import Air, Expression, Signals

if TYPE_CHECKING:
    from pam_orthosis.model.machine import ActuatorOf

# the order in which a model evaluates its signals; an effect sees all signals of earlier stages
STAGES = (
    "body", "supply", "command", "spool", "opening", "flow", "gas", "rate", "force", "torque", "sensor",
)  # fmt: skip
# the equation of the model in which an effect of a stage shows
EQUATIONS = {
    "body": "torque", "force": "torque", "torque": "torque", "supply": "supply", "command": "valve",
    "spool": "valve", "opening": "valve", "flow": "gas", "gas": "gas", "rate": "gas", "sensor": "sensor",
}  # fmt: skip

AT_BOUND = 1e-3  # of a bound, or of the typical value: nearer than that a parameter is at its bound


@dataclass(frozen=True)
class Quantity:
    """A parameter of an effect: typical value, unit, bounds, meaning.

    `neutral` is the value at which the whole effect vanishes; None for a parameter of its shape.
    `fitted` is false for shape details that the gap workflow holds at their typical value. `prior`
    is the standard deviation that a coefficient of a shape correction (`Effect.shape`) may have.
    `meaningful` are the values, ends included, at which the effect is what its name says: a reflex without
    a threshold is viscous friction. None: all inside the bounds, but not the bounds themselves, where a fit
    asks for more than the effect can be.
    """

    name: str
    typical: float
    unit: str
    minimum: float
    maximum: float
    meaning: str
    neutral: float | None = None
    fitted: bool = True
    prior: float | None = None
    meaningful: tuple[float, float] | None = None

    def is_empty(self, value: float) -> bool:
        """Return whether the effect is no longer what its name says at this value."""
        if self.meaningful is not None:
            low, high = self.meaningful
            return not low <= value <= high
        return self.at_bound(value)

    def at_bound(self, value: float) -> bool:
        """Return whether a value is at one of the bounds."""
        return any(
            abs(value - bound) <= AT_BOUND * max(abs(bound), abs(self.typical))
            for bound in (self.minimum, self.maximum)
        )


@dataclass(frozen=True)
class Contribution:
    """What an effect adds to signals (name -> expression) and the rates of its own states.

    `add` names fields of what the effect is of: an actuator's signals, the air, or else the machine's
    signals; `actuators` holds what an effect of something else adds to fields of an actuator. Rates that
    need signals of later stages are given as a function of the signals, which is called when all stages
    are done.
    """

    add: Mapping[str, Expression]
    rates: tuple[Expression, ...] | Callable[[Signals], tuple[Expression, ...]] = ()
    actuators: Mapping[str, Mapping[str, Expression]] = field(default_factory=dict)


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    Attributes:
        name: key in the configuration.
        stage: the stage of the model that it enters, one of `STAGES`.
        parameters: its parameters.
        expression: (signals, own parameters, tuple of own states) -> Contribution. The signals are those
            of one actuator where the effect is of actuators, else those of the machine.
        physics: one paragraph on the phenomenon.
        source: where equation and magnitudes come from.
        of: `actuator` or `muscle`: each has an instance of its own, in whose texts its name stands for
            `{actuator}`. `actuators` or `muscles`: one instance acts on each in the same way, with states
            for each. `air`, or a kind of coordinate (`rotation`, `translation`) or of mechanism: one.
        separate: of an instance that acts on several actuators: with parameters for each.
        states: names of its own states, zero at rest.
        scales: typical size of each state, for integration tolerances and reports.
        starts: for the gap workflow, sets of start values (name -> value) beside the typical ones.
        minimum_effect: size of the first parameter below which the effect is not worth a name.
        coordinate: the signal against which the effect is seen best in a figure.
        confounded_with: effects that ordinary motion cannot distinguish from this one.
        separated_by: scenarios or segments that separate them.
        shape: a smooth bounded correction of a static map; the gap workflow lets it vary within its
            priors beside every candidate.
        within: shape correction whose level it is: where that has a name, it is no other.
        advance: for a sensor that lags, values -> {channel: seconds by which the recorded signal has to be
            advanced to be the true one}.
        late: for a delay of the inputs, values -> seconds by which the recorded ones act late.
        late_of: the only input that is late; empty: all are.
        lag: for what a dead time of the nominal model may stand for, values -> s by which it delays.
        held: for the gap workflow, own state -> {channel: gain by which a replay holds it to the recording,
            1/s times the ratio of their units}; for a state that chance decides.
        middle: name of the coordinate that is usually the middle of the machine's range.
        periodic: names of its frequency, Hz, and phase, rad; a search starts where residuals have peaks.
        on: the actuators on which this instance acts.
    """

    name: str
    stage: str
    parameters: tuple[Quantity, ...]
    expression: Callable[[Any, Any, tuple[Expression, ...]], Contribution]
    physics: str
    source: str
    of: str = "machine"
    separate: bool = False
    states: tuple[str, ...] = ()
    scales: tuple[float, ...] = ()
    starts: tuple[Mapping[str, float], ...] = ()
    minimum_effect: float = 0.0
    coordinate: str = "velocity"
    confounded_with: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()
    shape: bool = False
    within: str = ""
    advance: Callable[[Any], Mapping[str, float]] | None = None
    late: Callable[[Any], float] | None = None
    late_of: str = ""
    lag: Callable[[Any], float] | None = None
    held: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    middle: str = ""
    periodic: tuple[str, str] | None = None
    on: tuple[str, ...] = ()

    @property
    def is_dead_time(self) -> bool:
        """Whether all inputs act late by it."""
        return self.late is not None and not self.late_of

    @property
    def kind(self) -> str:
        """The name that all of its instances share."""
        return self.name.removeprefix("{actuator}_")

    @property
    def equation(self) -> str:
        """The equation in which it shows: torque, gas, valve, supply or sensor."""
        return EQUATIONS[self.stage]

    @property
    def fitted(self) -> tuple[Quantity, ...]:
        """The parameters that the gap workflow estimates; the first one is the effect's size."""
        return tuple(quantity for quantity in self.parameters if quantity.fitted)

    def rows(self, prefix: str) -> list[Row]:
        """Return the configuration rows of this effect below a prefix, switched off."""
        path = f"{prefix}.{self.name}"
        switch = Row(f"{path}.enabled", False, "-", None, None, f"switches on: {self.title}", self.source)
        return [switch] + [
            Row(f"{path}.{q.name}", q.typical, q.unit, q.minimum, q.maximum, q.meaning, self.source)
            for q in self.parameters
        ]

    @property
    def title(self) -> str:
        """The name in words."""
        return self.name.replace("_", " ")

    def instances(self, actuators: Sequence[ActuatorOf], kinds: Sequence[str]) -> list[Effect]:
        """Return the instances that a machine has of it, by its actuators and the kinds of its parts."""
        if self.of in ("air", *kinds):
            return [self._named((), actuators)]
        fitting = [one for one in actuators if self.of.removesuffix("s") in ("actuator", one.kind)]
        if self.of.endswith("s"):
            return [self._named(fitting, actuators)] if fitting else []
        return [self._named((one,), (one,)) for one in fitting]

    def _named(self, on: Sequence[ActuatorOf], known: Sequence[ActuatorOf]) -> Effect:
        """Return the instance that acts on some actuators; its texts name those that are known."""
        each, names, advance = on or known[:1], [one.name for one in known], self.advance

        def first(text: str) -> str:
            return text.format(actuator=names[0])

        own = [self._separate(one, q) for one in on for q in self.parameters] if self.separate else None
        return replace(
            self,
            name=first(self.name),
            parameters=self.parameters if own is None else tuple(own),
            physics=first(self.physics),
            states=tuple(state.format(actuator=one.name) for one in each for state in self.states),
            scales=self.scales * len(each),
            coordinate=first(self.coordinate),
            confounded_with=_filled(self.confounded_with, names),
            advance=None if advance is None else lambda p: {first(k): v for k, v in advance(p).items()},
            on=tuple(one.name for one in on),
        )

    def _separate(self, actuator: ActuatorOf, q: Quantity) -> Quantity:
        factor = actuator.sizes.get(self.name, 1.0)
        return replace(
            q,
            name=f"{actuator.name}_{q.name}",
            meaning=f"{actuator.name}: {q.meaning}",
            typical=factor * q.typical,
            minimum=factor * q.minimum,
            maximum=factor * q.maximum,
            prior=None if q.prior is None else factor * q.prior,
        )

    def enter(
        self, signals: Signals, values: Section, own: tuple[Expression, ...]
    ) -> tuple[Expression, ...] | Callable[[Signals], tuple[Expression, ...]]:
        """Add to the signals; return the rates of the own states."""
        if not self.on:
            contribution = self.expression(signals, values, own)
            _add(signals.air if self.of == "air" else signals, contribution.add)
            for name, amounts in contribution.actuators.items():
                _add(signals.actuators[name], amounts)
            return contribution.rates
        rates: list[Expression] = []
        share = len(own) // len(self.on)
        for index, name in enumerate(self.on):
            of_one = self._values_of(name, values) if self.separate else values
            actuator = signals.actuators[name]
            contribution = self.expression(actuator, of_one, own[share * index : share * (index + 1)])
            _add(actuator, contribution.add)
            rates += contribution.rates  # type: ignore[arg-type]  # an actuator's need no later stage
        return tuple(rates)

    def _values_of(self, actuator: str, values: Section) -> Section:
        start = f"{actuator}_"
        return Section(
            self.name, {k.removeprefix(start): v for k, v in values.items() if k.startswith(start)}
        )


def _filled(texts: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return the texts, those that name an actuator once for each one."""
    pairs = ((text, names if "{actuator}" in text else names[:1]) for text in texts)
    return tuple(text.format(actuator=name) for text, some in pairs for name in some)


def _add(target: Signals | Air | object, amounts: Mapping[str, Expression]) -> None:
    for name, amount in amounts.items():
        setattr(target, name, getattr(target, name) + amount)


def enabled(settings: Section) -> list[str]:
    """Return the names of the effects that are switched on in a section of settings."""
    return [name for name, values in settings.items() if values.enabled]


class ActiveEffects:
    """The effects that are on in one set of equations, with their states."""

    def __init__(self, catalogue: Mapping[str, Effect], settings: Section):
        self._effects = [catalogue[name] for name in enabled(settings)]
        self._values = dict(settings.items())
        self._own: dict[str, tuple[Expression, ...]] = {}
        self._rates: dict[str, Any] = {}

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all states, effect by effect."""
        return tuple(state for effect in self._effects for state in effect.states)

    def bind(self, symbols: Sequence[Expression]) -> None:
        """Give the states their symbols, in the order of `states`."""
        rest = iter(symbols)
        for effect in self._effects:
            self._own[effect.name] = tuple(next(rest) for _ in effect.states)

    def stages(self, signals: Signals, *names: str) -> None:
        """Let the effects of these stages, one after the other, add to the signals."""
        for name in names:
            for effect in self._effects:
                if effect.stage == name:
                    own = self._own[effect.name]
                    self._rates[effect.name] = effect.enter(signals, self._values[effect.name], own)

    def rates(self, signals: Signals) -> list[Expression]:
        """Return the derivatives of all states; call it when all stages are done."""
        result: list[Expression] = []
        for effect in self._effects:
            own = self._rates[effect.name]
            result += own(signals) if callable(own) else own
        return result
