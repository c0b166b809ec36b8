# SPDX-License-Identifier: Apache-2.0
"""What the gap workflow needs to know of a system: equations, signals, tolerances, catalogue.

The engine knows no machine. A system gives its equations as one assembly of expressions, with
the parameters as symbols; the engine cuts it into equations that are driven by recorded neighbours.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import SimpleNamespace
from typing import Any, TypeAlias

import casadi as ca

from pam_orthosis.discrepancy.systems.boxes import Box
from pam_orthosis.model.effects.base import Effect

Names: TypeAlias = tuple[str, ...]
Values: TypeAlias = Mapping[str, float]  # parameter -> value


@dataclass(frozen=True)
class Channel:
    """A measured signal: the state that it measures (None: a function of states), units.

    `report_factor` leads from the unit to that of reports.
    """

    name: str
    state: str | None
    unit: str
    report_unit: str
    report_factor: float


@dataclass(frozen=True)
class Source:
    """Where recordings have a signal, if not under its own name and in its own unit.

    Attributes:
        column: of a CSV table.
        topic: of a bag.
        type: of the topic's messages, a standard one with a header.
        field: of the message, as `position` or `wrench.force.x`.
        joint: where the field is a list of joints.
        spool: the field is the position of a valve's spool, and the signal the voltage that asks for it.
        factor, offset: the signal is factor times what is recorded, plus offset.
    """

    column: str = ""
    topic: str = ""
    type: str = ""
    field: str = ""
    joint: str = ""
    spool: bool = False
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Entry:
    """How something unknown may enter the equation of a channel.

    Attributes:
        unit: of what enters.
        name: in reports; empty: it is added to the rate.
        parameter: whose change by `size` shows what it does, a calibration or `EFFECT.PARAMETER`; empty: as
            `name`.
        held: what below `System.branch` of a model can hold a curve that enters so; empty: nothing.
    """

    unit: str
    name: str = ""
    parameter: str = ""
    size: float = 1.0
    held: str = ""


@dataclass(frozen=True)
class Equation:
    """One part of the model that is replayed alone.

    Attributes:
        name: in reports.
        states: base states that it integrates.
        channels: measured channels that it predicts.
        gains: channel -> {state: observer gain, 1/s times the ratio of their units}; base states first, then
            those of effects.
        stiff: its base states may be faster than the sampling: steps follow the fastest one.
    """

    name: str
    states: tuple[str, ...]
    channels: tuple[str, ...]
    gains: Mapping[str, Mapping[str, float]]
    stiff: bool = False


@dataclass(frozen=True)
class Calibration:
    """A nuisance parameter that may be off: deviation from the nominal model with mean 0 and this sd.

    `relative`: it is a share of what the model has. `nominal`: the value that it changes, where it is of one
    parameter. `ratio`: by the factor exp(deviation / nominal), which makes parameters that act by their ratio
    alone easy to move together; else it is added.
    """

    name: str
    sd: float
    unit: str
    meaning: str
    relative: bool = False
    nominal: float = 0.0
    ratio: bool = False

    def applied(self, deviation: Any) -> Any:
        """Return the parameter with a deviation, which may be an expression."""
        nominal = self.nominal
        return nominal * ca.exp(deviation / nominal) if self.ratio else nominal + deviation


@dataclass(frozen=True)
class Assembled:
    """Expressions of a system with some effects on.

    `x` holds the states named `states` (base states first), `u` the inputs, `time` the instant in s,
    `theta` the parameters named `parameters`; `measured` maps a channel to its expression.
    """

    states: tuple[str, ...]
    x: ca.SX
    u: ca.SX
    time: ca.SX
    theta: ca.SX
    parameters: tuple[str, ...]
    rates: ca.SX
    measured: Mapping[str, ca.SX]


@dataclass(frozen=True)
class System:
    """A system whose model can be replayed.

    Attributes:
        name: in reports.
        channels: what is measured.
        inputs: recorded inputs, in the order of `Assembled.u`.
        derived, derived_twice: state -> that whose (second) difference quotient it is (velocity: the angle).
        equations: how the model is cut.
        calibrations, catalogue: nuisance parameters with tolerances; effects that may be missing.
        assemble: names of effects -> Assembled; parameters are the calibrations' deviations, then
            `EFFECT.PARAMETER` of each effect in the order given.
        needs: equation (also those that effects name) -> recorded inputs without which it cannot be judged.
        equation_names: what effects call an equation -> its name here, where that differs.
        branch: of the parameters that switches effects on in the model.
        simpler: effects that the model has already -> makes the system without that one.
        limits: channel or input -> values that it cannot leave, in its unit.
        input_period: parameter in a bag's metadata that says how often the inputs changed, s.
        late: s, by which the model's inputs act later than recorded; effects with `late` count from there.
        later, aged: input -> s by which it acts later still; channel -> s by which it shows the past.
        already: `EFFECT.PARAMETER` -> what the model has of an effect that a candidate of its name adds to.
        changed: key -> value of a model file, `gap.*` left out -> the system that has it; None: it has none.
        unusable: experiments that effects name and whose recordings cannot be searched.
        places: effect -> the equation in which it shows, where the effect does not name it itself.
        input_units, input_noise: input -> its unit (V); sd of what is recorded (`gap.replay.input_noise`).
        begins: state of an effect -> the input at whose value it begins; others begin at 0.
        gradual: inputs that run straight from sample to sample; others keep their value until the next.
        sensed: inputs that a sensor measures: no delay of the others is theirs, recordings show their noise.
        entries: channel -> how something unknown may enter, if not as a rate alone; pushes as the first one.
        wrong: candidate -> key of the parameter that it takes to be wrong; see `recalibrating`.
        common: candidate -> key -> nominal value of all parameters that it multiplies.
        shares: candidate -> calibration by which the same parameter may be off by a share.
        sources: signal (of a table `time` too) -> where recordings have it.
        ambient: absolute pressure, Pa, from which gauge pressures in a table count.
        boxes: of its muscles' maps.
        also_recorded: names of what this package's own tables hold beside: it is left unread without a word.
    """

    name: str
    channels: tuple[Channel, ...]
    inputs: tuple[str, ...]
    derived: Mapping[str, str]
    equations: tuple[Equation, ...]
    calibrations: tuple[Calibration, ...]
    catalogue: Mapping[str, Effect]
    assemble: Callable[[tuple[str, ...]], Assembled]
    needs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    equation_names: Mapping[str, str] = field(default_factory=dict)
    branch: str = "effects"
    simpler: Mapping[str, Callable[[], System]] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    input_period: str = ""
    late: float = 0.0
    later: Values = field(default_factory=dict)
    aged: Values = field(default_factory=dict)
    already: Values = field(default_factory=dict)
    changed: Callable[[Mapping[str, Any]], System] | None = None
    unusable: tuple[str, ...] = ()
    places: Mapping[str, str] = field(default_factory=dict)
    input_units: Mapping[str, str] = field(default_factory=dict)
    input_noise: Mapping[str, float] = field(default_factory=dict)
    begins: Mapping[str, str] = field(default_factory=dict)
    gradual: tuple[str, ...] = ()
    sensed: tuple[str, ...] = ()
    sources: Mapping[str, Source] = field(default_factory=dict)
    entries: Mapping[str, tuple[Entry, ...]] = field(default_factory=dict)
    wrong: Mapping[str, str] = field(default_factory=dict)
    common: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    shares: Mapping[str, str] = field(default_factory=dict)
    derived_twice: Mapping[str, str] = field(default_factory=dict)
    ambient: float = 1.013e5
    boxes: tuple[Box, ...] = ()
    also_recorded: tuple[str, ...] = ()

    def without(self, missing: Collection[str]) -> System:
        """Return the system without equations and effects that need inputs that are missing."""

        def judged(name: str) -> bool:
            return not set(missing) & set(self.needs.get(name, ()))

        return replace(
            self,
            equations=tuple(e for e in self.equations if judged(e.name)),
            catalogue={name: effect for name, effect in self.catalogue.items() if judged(self._place(name))},
        )

    def without_effect(self, name: str) -> System:
        """Return the system without an effect that its model has already, with the same equations."""
        judged = {equation.name for equation in self.equations}
        simple = self.simpler[name]()
        return replace(simple, equations=tuple(one for one in simple.equations if one.name in judged))

    def bare(self) -> System:
        """Return the system without any effect that its model has already."""
        return self.without_effect(next(iter(self.simpler))).bare() if self.simpler else self

    @cached_property
    def shapes(self) -> tuple[str, ...]:
        """The shape corrections: always there, held by their priors."""
        return tuple(name for name, effect in self.catalogue.items() if effect.shape)

    @cached_property
    def candidates(self) -> tuple[str, ...]:
        """The effects that can be named."""
        return tuple(name for name, effect in self.catalogue.items() if not effect.shape)

    def recalibrating(self, candidate: str) -> Calibration | None:
        """Return the calibration of what a candidate takes to be wrong, if there is one.

        The candidate's own parameter is then a deviation too.
        """
        key = self.wrong.get(candidate, "")
        return next((one for one in self.calibrations if one.name == key), None)

    def moved_by(self, candidate: str) -> Calibration | None:
        """Return the calibration that moves what a candidate takes to be wrong, if there is one."""
        name = self.shares.get(candidate, self.wrong.get(candidate, ""))
        return next((one for one in self.calibrations if one.name == name), None)

    def moved_to(self, candidate: str, deviation: float) -> float:
        """Return the candidate's own parameter that does what a deviation of its calibration does."""
        nominal = self.nominal_of(candidate)
        return nominal * (1 + deviation) if candidate in self.shares else deviation

    def moved_back(self, candidate: str, value: float) -> float:
        """Return the deviation that does what a candidate's own parameter does."""
        return value / self.nominal_of(candidate) - 1 if candidate in self.shares else value

    def nominal_of(self, candidate: str) -> float:
        """Return what the nominal model has of a parameter that a candidate takes to be wrong."""
        own = self.recalibrating(candidate)
        return own.nominal if own else self.catalogue[candidate].parameters[0].neutral or 0.0

    def taken(self, effects: Collection[str]) -> set[str]:
        """Return the effects that a model has, and those that are a part of one of them."""
        return {*effects, *(name for name, one in self.catalogue.items() if one.within in effects)}

    def entries_of(self, channel: str) -> tuple[Entry, ...]:
        """Return how something unknown may enter the equation of a channel that measures a state.

        An effect that the nominal model has already is no candidate, and nothing enters by its parameter.
        """
        known = self.channel(channel)
        rate = Entry(f"{known.unit}/s" + "^2" * (known.state in self.derived.values()))
        there = {"", *self.catalogue, *(one.name for one in self.calibrations)}
        found = tuple(e for e in self.entries.get(channel, ()) if e.parameter.partition(".")[0] in there)
        return found or (rate,)

    def beside(self, effect: str, known: Collection[str]) -> Names:
        """Return the effects that have to move with one, beside those that are known.

        The nominal dead time may stand for a lag. A free one stands for what is common to the sensors of an
        equation, so that the delay of one cannot be found without those of the others.
        """
        one = self.catalogue[effect]
        dead_times = {name for name, other in self.catalogue.items() if other.is_dead_time}
        if self.late and one.lag is not None:
            return tuple(sorted(dead_times - set(known)))
        if one.advance is None or not dead_times & set(known):
            return ()
        return tuple(name for name in self._delays_beside(effect) if name not in known)

    def _delays_beside(self, effect: str) -> Names:
        """Return the delays of other sensors whose channels are in the same equation."""
        channels = {
            name: set(one.advance(SimpleNamespace(**{q.name: q.typical for q in one.parameters})))
            for name, one in self.catalogue.items()
            if one.advance is not None
        }
        own = [set(e.channels) for e in self.equations if channels[effect] & set(e.channels)]
        return tuple(
            name for name, many in channels.items() if name != effect and any(many & others for others in own)
        )

    def equation_of(self, effect: str) -> str:
        """Return the equation in which an effect shows, as reports call it."""
        equation = self._place(effect)
        return self.equation_names.get(equation, equation)

    def _place(self, effect: str) -> str:
        return self.places[effect] if effect in self.places else self.catalogue[effect].equation

    def twins(self, effect: str) -> tuple[str, ...]:
        """Return what an effect of one actuator is called at the others."""
        one = self.catalogue[effect]
        alike = (n for n, other in self.catalogue.items() if other.on and other.expression is one.expression)
        return tuple(name for name in alike if name != effect)

    def unit(self, name: str) -> str:
        """Return the unit of a channel, its rate, an input or `time`; empty if none is known."""
        of_state = {channel.state: channel.unit for channel in self.channels}
        units = {channel.name: channel.unit for channel in self.channels}
        units |= {rate: f"{of_state[state]}/s" for rate, state in self.derived.items() if state in of_state}
        units |= {"time": "s", **dict.fromkeys(self.inputs, "V"), **self.input_units}
        return units.get(name, "")

    def is_absolute(self, name: str) -> bool:
        """Return whether a signal is a pressure that counts from vacuum: its limits do not begin below 0."""
        return self.unit(name) == "Pa" and self.limits.get(name, (0.0, 0.0))[0] >= 0.0

    def experiments(self, effect: str) -> tuple[str, ...]:
        """Return the experiments that would show an effect, or part it from others, and can be searched."""
        return tuple(one for one in self.catalogue[effect].separated_by if one not in self.unusable)

    def channel(self, name: str) -> Channel:
        """Return a channel by name."""
        return next(channel for channel in self.channels if channel.name == name)
