# SPDX-License-Identifier: Apache-2.0
"""What an effect is: one physical phenomenon that a model can have or lack.

The plant, the controllers' model and the gap workflow use the same object. An effect adds to the
signals of one stage of the model (see `STAGES`), may have states of its own, and is switched on by
one line of YAML: `effects.NAME.enabled: true`. A new effect is one file in this folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

# the order in which a model evaluates its signals; an effect sees all signals of earlier stages
STAGES = (
    "body", "supply", "command", "spool", "opening", "flow", "gas", "force", "torque", "sensor",
)  # fmt: skip
# the equation of the model in which an effect of a stage shows
EQUATIONS = {
    "body": "torque", "force": "torque", "torque": "torque", "supply": "supply", "command": "valve",
    "spool": "valve", "opening": "valve", "flow": "gas", "gas": "gas", "sensor": "sensor",
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
        return any(
            abs(value - bound) <= AT_BOUND * max(abs(bound), abs(self.typical))
            for bound in (self.minimum, self.maximum)
        )


@dataclass(frozen=True)
class Contribution:
    """What an effect adds to signals (name -> expression) and the rates of its own states.

    Rates that need signals of later stages are given as a function of the signals, which is called
    when all stages are done.
    """

    add: Mapping[str, Any]
    rates: tuple | Callable[[Any], tuple] = ()


@dataclass(frozen=True)
class Effect:
    """One physical effect.

    Attributes:
        name: key in the configuration.
        stage: the stage of the model that it enters, one of `STAGES`.
        parameters: its parameters.
        expression: (signals, parameter values, own states) -> Contribution.
        physics: one paragraph on the phenomenon.
        source: where equation and magnitudes come from.
        states: names of its own states, zero at rest.
        scales: typical size of each state, for integration tolerances and reports.
        starts: for the gap workflow, sets of start values (name -> value) beside the typical ones.
        minimum_effect: size of the first parameter below which the effect is not worth a name.
        coordinate: the signal against which the effect is seen best in a figure.
        confounded_with: effects that ordinary motion cannot tell from this one.
        separated_by: scenarios or segments that tell them apart.
        shape: a smooth bounded correction of a static map; the gap workflow lets it vary within its
            priors beside every candidate.
        advance: for a sensor that lags, values -> {"angle" | "extensor_pressure" | ...: seconds by which
            the recorded signal has to be advanced to be the true one}.
        late: for a delay of the inputs, values -> seconds by which the recorded ones act late.
        fastest: the shortest time constant that its states have at these values, values -> s.
        held: for the gap workflow, own state -> {channel: gain by which a replay holds it to the recording,
            1/s times the ratio of their units}; for a state that chance decides.
    """

    name: str
    stage: str
    parameters: tuple[Quantity, ...]
    expression: Callable[[Any, Any, tuple], Contribution]
    physics: str
    source: str
    states: tuple[str, ...] = ()
    scales: tuple[float, ...] = field(default=())
    starts: tuple[Mapping[str, float], ...] = ()
    minimum_effect: float = 0.0
    coordinate: str = "velocity"
    confounded_with: tuple[str, ...] = ()
    separated_by: tuple[str, ...] = ()
    shape: bool = False
    advance: Callable[[Any], Mapping[str, float]] | None = None
    late: Callable[[Any], float] | None = None
    fastest: Callable[[Any], float] | None = None
    held: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def equation(self) -> str:
        """The equation in which it shows: torque, gas, valve, supply or sensor."""
        return EQUATIONS[self.stage]

    @property
    def fitted(self) -> tuple[Quantity, ...]:
        """The parameters that the gap workflow estimates; the first one is the effect's size."""
        return tuple(quantity for quantity in self.parameters if quantity.fitted)

    def rows(self, prefix: str) -> list:
        """Return the configuration rows of this effect below a prefix, switched off."""
        from pam_orthosis.model.parameters import Row  # parameters reads the catalogue

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


def enabled(settings) -> list[str]:
    """Return the names of the effects that are switched on in a section of settings."""
    return [name for name, values in settings.items() if values.enabled]


class ActiveEffects:
    """The effects that are on in one set of equations, with their states.

    Args:
        catalogue: effects by name.
        settings: section with the settings of each effect.
    """

    def __init__(self, catalogue: Mapping[str, Effect], settings):
        self._effects = [catalogue[name] for name in enabled(settings)]
        self._settings = settings
        self._own: dict[str, tuple] = {}
        self._rates: dict[str, Any] = {}

    @property
    def states(self) -> tuple[str, ...]:
        """Names of all states, effect by effect."""
        return tuple(state for effect in self._effects for state in effect.states)

    def bind(self, symbols: list) -> None:
        """Give the states their symbols, in the order of `states`."""
        rest = iter(symbols)
        for effect in self._effects:
            self._own[effect.name] = tuple(next(rest) for _ in effect.states)

    def stages(self, signals: SimpleNamespace, *names: str) -> None:
        """Let the effects of these stages, one after the other, add to the signals."""
        for name in names:
            for effect in self._effects:
                if effect.stage == name:
                    self._apply(effect, signals)

    def rates(self, signals: SimpleNamespace) -> list:
        """Return the derivatives of all states; call it when all stages are done."""
        result: list = []
        for effect in self._effects:
            own = self._rates[effect.name]
            result += own(signals) if callable(own) else own
        return result

    def _apply(self, effect: Effect, signals: SimpleNamespace) -> None:
        values = getattr(self._settings, effect.name)
        contribution = effect.expression(signals, values, self._own[effect.name])
        for name, amount in contribution.add.items():
            setattr(signals, name, getattr(signals, name) + amount)
        self._rates[effect.name] = contribution.rates
