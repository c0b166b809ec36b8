# SPDX-License-Identifier: Apache-2.0
"""The expressions of a model that is written as a function: its signals in their order, with effects.

The function assigns signals and returns the rates of the states. An effect enters where the signal is
assigned that its `stage` names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import casadi as ca

from pam_orthosis.discrepancy.systems.cut import closure
from pam_orthosis.discrepancy.systems.implied import (
    MEASURED,
    OFFSET,
    channel_of,
    input_of,
    is_zero,
    parameter_of,
    sensor_rates,
)
from pam_orthosis.discrepancy.systems.suspects import VALUE
from pam_orthosis.discrepancy.systems.system import Assembled, Channel, Equation, System
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Contribution, Effect
from pam_orthosis.model.effects.described import curve

if TYPE_CHECKING:
    from pam_orthosis.discrepancy.systems.builder import Model, Parameter

TIME = "time"
Added = Sequence[Mapping[str, Any]]


class Attributes:
    """Attributes by attribute; a name that is not there is refused with those that are."""

    def __init__(self, what: str, values: Mapping[str, Any]):
        self.__dict__.update(_what=what, _values=dict(values))

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if name not in self._values:
            raise OrthosisError(f"there is no {self._what} {name!r}; there are: {', '.join(self._values)}")
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values


class Signals(Attributes):
    """Signals by attribute; what is assigned gets what effects add to it.

    Args:
        known: states, inputs and time.
        entering: (name, signals) -> called when a signal was assigned: what is added to signals.
    """

    def __init__(self, known: Mapping[str, Any], entering: Callable[[str, Signals], Added]):
        super().__init__("signal", known)
        self.__dict__.update(_entering=entering, _added={}, _assigned=[])

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._values:
            raise OrthosisError(f"the signal {name!r} is there already and cannot be assigned")
        self._values[name] = value + sum(self._added.pop(name, []))
        self._assigned.append(name)
        for added in self._entering(name, self):
            for other, amount in added.items():
                self._add(name, other, amount)

    def _add(self, stage: str, name: str, amount: Any) -> None:
        if name == stage:
            self._values[name] += amount
        elif name in self._values:
            raise OrthosisError(f"what enters at {stage!r} cannot add to {name!r}, which is there before")
        else:
            self._added.setdefault(name, []).append(amount)

    def check_finished(self) -> None:
        """Check that no effect adds to a signal that was not assigned."""
        if self._added:
            raise OrthosisError(
                f"an effect adds to {next(iter(self._added))!r}, which is never assigned; assigned are:"
                f" {', '.join(self._assigned)}"
            )


class Traced:
    """The model's expressions with some effects on; `marks` stand for what may be added to each signal."""

    def __init__(self, model: Model, effects: tuple[str, ...]):
        self._model = model
        implied = {one.name: one for one in model.implied}
        every = implied | {one.name: one for one in model.effects}
        tried = [every[name] for name in effects]
        self._on = [*(one for one in model.known if one.late is None), *tried]
        self._implied = [one for one in self._on if one.name in implied]
        self.states = (*model.states, *(state for one in self._on for state in one.states))
        self.x, self.u = ca.SX.sym("x", len(self.states)), ca.SX.sym("u", len(model.inputs))
        self.time = ca.SX.sym(TIME)
        self.marks: dict[str, ca.SX] = {}
        tolerances = [one.name for one in model.parameters if one.tolerance]
        own = [f"{one.name}.{q.name}" for one in tried for q in one.parameters]
        self.parameters = (*tolerances, *(one.name for one in model.learned), *own)
        self.theta = ca.SX.sym("theta", len(self.parameters))
        self._symbols = {name: self.theta[i] for i, name in enumerate(self.parameters)}
        known = [(one.name, q.name) for one in model.known if one.late is None for q in one.parameters]
        self._symbols |= {f"{effect}.{q}": self._known(effect, q) for effect, q in known}
        self._of_state = {name: self.x[i] for i, name in enumerate(self.states)}
        self._effect_rates: dict[str, Any] = {}
        self._evaluate()

    def _evaluate(self) -> None:
        model, known = self._model, {name: self._of_state[name] for name in self._model.states}
        known = self._true(known) | self._inputs() | {TIME: self.time}
        signals = Signals(known, self._entering)
        values = {one.name: self._value(one) for one in model.parameters}
        returned = model.equations(signals, Attributes("parameter", values))
        _check_keys("rates that the equations return", model.states, returned)
        self.rates = dict(returned)
        for channel in model.channels:
            if f"{MEASURED}{channel.name}" not in signals:
                setattr(signals, f"{MEASURED}{channel.name}", getattr(signals, channel.state or channel.name))
        signals.check_finished()
        self.measured = {one.name: ca.SX(getattr(signals, f"{MEASURED}{one.name}")) for one in model.channels}
        for one in self._implied:
            if (shown := channel_of(one)) and one.states:
                self._effect_rates[one.name] = self._past(one, shown)
        for one in self._on:
            rates = self._effect_rates.get(one.name, ())
            rates = tuple(rates(signals) if callable(rates) else rates)
            if len(rates) != len(one.states):
                raise OrthosisError(f"effect {one.name}: {len(rates)} rates of {len(one.states)} states")
            self.rates |= dict(zip(one.states, rates, strict=True))
        states = {channel.name: str(channel.state) for channel in model.channels}
        for name, row in model.curves.items():
            rate = self._last_rate(states[name])
            self.rates[rate] += curve(known[row.coordinate], row.places, row.values)

    def _true(self, states: Mapping[str, ca.SX]) -> dict[str, ca.SX]:
        """Return the states as they are: what is measured counts from its sensor's zero, as recordings do."""
        off = {channel_of(one): one.name for one in self._implied if is_zero(one)}
        moved = {
            one.state: states[one.state] - self._symbols[f"{off[one.name]}.{OFFSET}"]
            for one in self._model.channels
            if one.state is not None and one.name in off
        }
        return {**states, **moved}

    def _last_rate(self, state: str) -> str:
        """Return the state that is the rate of a state, or itself if none is."""
        rates = (one for one in self._model.states if ca.is_equal(self.rate(state), self._of_state[one]))
        return next(rates, state)

    def _known(self, effect: str, quantity: str) -> Any:
        """Return a parameter of an effect that the model has, as recalibration moves it."""
        return self._model.present[effect][quantity] * (1 + self._symbols.get(f"{effect}_{quantity}", 0.0))

    def _inputs(self) -> dict[str, Any]:
        """Return the inputs; those that act late by a Pade approximation (1, 1), which no replay needs."""
        inputs = {one.name: self.u[i] for i, one in enumerate(self._model.inputs)}
        for one in self._implied:
            if one.late is not None:
                delay, names = self._symbols[f"{one.name}.delay"], [one.late_of] if one.late_of else [*inputs]
                states = {name: self._of_state[own] for name, own in zip(names, one.states, strict=True)}
                rates = [2 * (inputs[name] - state) / delay for name, state in states.items()]
                self._effect_rates[one.name] = rates
                inputs |= {name: 2 * state - inputs[name] for name, state in states.items()}
        for one in self._implied:
            if name := input_of(one):
                state, time = self._of_state[one.states[0]], self._symbols[f"{one.name}.time"]
                self._effect_rates[one.name] = [(inputs[name] - state) / time]
                inputs[name] = state
        return inputs

    def _past(self, one: Effect, channel: str) -> tuple[Any, ...]:
        """Return the rates of the states of a channel that is late or lags."""
        state = next(known.state for known in self._model.channels if known.name == channel)
        values = SimpleNamespace(**{q.name: self._symbols[f"{one.name}.{q.name}"] for q in one.parameters})
        own = [self._of_state[name] for name in one.states]
        return sensor_rates(one, own, self.rates[str(state)], values)

    def _value(self, one: Parameter) -> Any:
        """Return a parameter: the nominal one, as recalibration moves it, and as far as it is wrong."""
        if not one.tolerance:
            return one.value
        wrong = (effect.name for effect in self._implied if parameter_of(effect) == one.name)
        off = sum((self._symbols[f"{name}.{VALUE}"] for name in wrong), self._symbols[one.name])
        return one.calibration.applied(off)

    def _entering(self, stage: str, signals: Signals) -> list[Mapping[str, Any]]:
        """Return what enters where a signal was assigned: a mark, and what effects add."""
        self.marks[stage] = ca.SX.sym("mark")
        added: list[Mapping[str, Any]] = [{stage: self.marks[stage]}]
        for one in self._on:
            if one.stage == stage:
                values = {q.name: self._symbols[f"{one.name}.{q.name}"] for q in one.parameters}
                own = tuple(self._of_state[state] for state in one.states)
                given: Any = one.expression(signals, Attributes("parameter", values), own)
                contribution = given if isinstance(given, Contribution) else Contribution({stage: given})
                self._effect_rates[one.name] = contribution.rates
                added.append(contribution.add)
        return added

    def assembled(self) -> Assembled:
        """Return the expressions as the engine takes them."""
        names = list(self.measured)
        all_rates = ca.vertcat(*(self.rates[name] for name in self.states))
        marks = ca.vertcat(*self.marks.values())
        rates, *measured = ca.substitute(
            [ca.SX(all_rates), *(self.measured[name] for name in names)], [marks], [ca.SX.zeros(marks.shape)]
        )
        return Assembled(
            self.states, self.x, self.u, self.time, self.theta, self.parameters, rates,
            dict(zip(names, measured, strict=True)),
        )  # fmt: skip

    def symbol(self, parameter: str) -> ca.SX:
        """Return the symbol of a parameter with a tolerance."""
        return self._symbols[parameter]

    def rate(self, state: str) -> ca.SX:
        """Return the rate of a state, nothing added."""
        marks = ca.vertcat(*self.marks.values())
        return ca.substitute(ca.SX(self.rates[state]), marks, ca.SX.zeros(marks.shape))

    def state(self, name: str) -> ca.SX:
        """Return the symbol of a state."""
        return self._of_state[name]

    def depends(self, system: System, equation: Equation, symbols: ca.SX) -> list[bool]:
        """Return on which symbols an equation depends: in its rates, or in what it predicts."""
        own = closure(system, self.assembled(), equation)
        results = ca.vertcat(*(self.rates[n] for n in own), *(self.measured[n] for n in equation.channels))
        used = set(ca.jacobian_sparsity(ca.SX(results), symbols).get_col())
        return [i in used for i in range(symbols.shape[0])]

    def counts_from_zero(self, system: System, equation: Equation, channel: Channel) -> bool:
        """Return whether an equation shows where a channel's sensor has its zero.

        What is where it was with any zero, as the position of a carriage, has none; on linear springs it does
        what a constant does that the equations lack, which is as likely. A user who gives what a sensor shows
        parameters has said what may be wrong with it.
        """
        if channel.state is None:
            return channel.name in equation.channels
        if ca.jacobian_sparsity(self.measured[channel.name], self.theta).nnz():
            return False
        others = [self.measured[name] for name in equation.channels if name != channel.name]
        rates = [self.rates[name] for name in closure(system, self.assembled(), equation)]
        felt = ca.jacobian(ca.SX(ca.vertcat(*rates, *others)), self._of_state[channel.state])
        return bool(ca.depends_on(felt, ca.vertcat(self.x, self.u, self.time)))

    def inputs_of(self, system: System, equation: Equation) -> tuple[str, ...]:
        """Return the inputs without which an equation cannot be replayed."""
        needed = self.depends(system, equation, self.u)
        return tuple(name for name, one in zip(system.inputs, needed, strict=True) if one)


def _check_keys(what: str, expected: Iterable[str], given: Any) -> None:
    if not isinstance(given, Mapping):
        names = ", ".join(f'"{name}": ...' for name in expected)
        raise OrthosisError(f"{what}: give them by name, {{{names}}}, not {type(given).__name__}")
    missing, more = [n for n in expected if n not in given], [n for n in given if n not in expected]
    if missing or more:
        wrong = f"{missing[0]} is missing" if missing else f"{more[0]} is no state"
        raise OrthosisError(f"{what}: {wrong}; states are: {', '.join(expected)}")
