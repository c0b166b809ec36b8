# SPDX-License-Identifier: Apache-2.0
"""A system from its equations as one writes them: for apparatus that is none of this package's machines.

The builder finds out what else the engine has to know: symbols, the order of states, which state is the rate
of which, in which equation an effect shows, and what needs which input.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from types import SimpleNamespace
from typing import Any

import casadi as ca

from pam_orthosis.discrepancy.systems.changes import ON, UNKNOWN, Curve, changed, check_known, check_numbers
from pam_orthosis.discrepancy.systems.implied import channel_of, implied, input_of, is_zero, parameter_of
from pam_orthosis.discrepancy.systems.soundness import check_free
from pam_orthosis.discrepancy.systems.system import Calibration, Channel, Equation, Source, System
from pam_orthosis.discrepancy.systems.tracing import TIME, Traced
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.parameters import load

KEEPS_SIGN = 0.5  # tolerance of a parameter over its value
SEARCH = "gap"  # settings of the search, in a model file
WHOLE = "dynamics"  # the equation of a model that is replayed as a whole


@dataclass(frozen=True)
class Input:
    """A recorded input of a system: name, unit, standard deviation of what is recorded (0: exact).

    `held`: each value acts until the next row, as what a digital controller commands; else it runs straight
    from row to row, as what a sensor measures.
    """

    name: str
    unit: str
    noise: float = 0.0
    held: bool = True


@dataclass(frozen=True)
class Parameter:
    """A parameter of the nominal model: its value, and how far it may be off (standard deviation, same unit).

    One with a tolerance is recalibrated before anything is called a gap; with 0 it is exact. One whose
    tolerance is below the half of its value keeps its sign.
    """

    name: str
    value: float
    unit: str
    tolerance: float
    meaning: str

    @property
    def calibration(self) -> Calibration:
        """How far it may be off."""
        ratio = self.tolerance < KEEPS_SIGN * abs(self.value)
        return Calibration(
            self.name, self.tolerance, self.unit, self.meaning, nominal=self.value, ratio=ratio
        )


@dataclass(frozen=True)
class Model:
    """What is known of an apparatus, and which effects may be missing; `system()` makes it searchable.

    Each parameter with a tolerance may be wrong too, inputs late, sensors off: see `implied`.

    Attributes:
        name: in reports.
        channels: what is measured. A channel's signal is its state; one without a state is the signal of its
            name, which `equations` assigns. What a sensor shows is `measured_CHANNEL`, which is the signal
            itself if `equations` does not assign it.
        inputs: what is recorded of what drives the system.
        states: of the equations. Each is measured, is the rate of a measured one, or starts at 0.
        equations: (signals, parameters) -> rates of the states by name. It reads states, inputs and `time` of
            the signals by attribute, and assigns further ones: `s.force = p.gain * s.current`.
        parameters: read by attribute too.
        effects: that may be missing. `stage` names the signal at whose assignment an effect enters. Its
            expression gets the signals so far, its own parameters, and a tuple of its own states. It returns
            what it adds to this signal, or a `Contribution`: to this one and later ones, and the rates of
            its states.
        parts: equation -> its channels, if the model is to be replayed in several parts, each driven by what
            is recorded of the others; else all is one equation, `dynamics`.
        gains: channel -> observer gains, 1/s (and 1/s^2 for its rate), if those of `gap.replay` do not suit.
        limits: signal -> values that it cannot leave.
        late: s, by which inputs act later than recorded.
        sources: signal -> where recordings have it.
        ambient: absolute pressure, Pa, from which gauge pressures in a table count.
        present: effects, of `effects` or implied, that the nominal model has already -> their parameters.
            Those of the expressions are recalibrated, by a tenth (`gap.learned.deviation`); dead times of
            inputs are exact.
        curves: channel -> what was described of it and has no name.
    """

    name: str
    channels: Sequence[Channel]
    inputs: Sequence[Input]
    states: Sequence[str]
    equations: Callable[[Any, Any], Mapping[str, Any]]
    parameters: Sequence[Parameter] = ()
    effects: Sequence[Effect] = ()
    parts: Mapping[str, Sequence[str]] = field(default_factory=dict)
    gains: Mapping[str, Sequence[float]] = field(default_factory=dict)
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    late: float = 0.0
    sources: Mapping[str, Source] = field(default_factory=dict)
    ambient: float = System.ambient
    present: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)

    def system(self) -> System:
        """Return the system.

        Raises:
            OrthosisError: parts of the model do not fit together.
        """
        check_numbers(self)
        check_known(self)
        self._check_names()
        traced, missing = Traced(self, ()), [one for one in self.effects if one.name not in self.present]
        late = [one for one in self.known if one.late is not None]
        plain = System(
            name=self.name,
            channels=tuple(self.channels),
            inputs=tuple(one.name for one in self.inputs),
            derived=self._derived(traced),
            equations=(),
            calibrations=(*(one.calibration for one in self.parameters if one.tolerance), *self.learned),
            catalogue={effect.name: effect for effect in missing},
            assemble=lambda effects: Traced(self, effects).assembled(),
            limits=self.limits,
            aged=self._aged,
            already={f"{one.name}.{q}": value for one in late for q, value in self.present[one.name].items()},
            late=self.late + self._lateness.get("", 0.0),
            later={name: seconds for name, seconds in self._lateness.items() if name},
            changed=lambda values: changed(self, values).system(),
            simpler={name: partial(self._without, name) for name in self.present},
            input_units={one.name: one.unit for one in self.inputs},
            input_noise={one.name: one.noise for one in self.inputs},
            begins={one.states[0]: name for one in self.implied if (name := input_of(one))},
            gradual=tuple(one.name for one in self.inputs if not one.held),
            sources=self.sources,
            ambient=self.ambient,
        )
        equations = self._equations(plain.derived)
        places = {one.name: _place(plain, traced, equations, one) for one in missing}
        needs = {one.name: traced.inputs_of(plain, one) for one in equations}
        places |= self._implied_places(plain, traced, equations, needs)
        implied = {one.name: one for one in self.implied if one.name in places}
        entries = {
            one.name: tuple(replace(e, held=f"{UNKNOWN}{one.name}") for e in plain.entries_of(one.name))
            for one in self.channels
            if one.state is not None and one.name not in self.curves
        }
        return replace(
            plain,
            equations=equations,
            entries=entries,
            places=places,
            needs=needs,
            catalogue={**plain.catalogue, **implied},
            wrong={name: key for name, one in implied.items() if (key := parameter_of(one))},
        )

    def _implied_places(
        self,
        system: System,
        traced: Traced,
        equations: Sequence[Equation],
        needs: Mapping[str, Sequence[str]],
    ) -> dict[str, str]:
        """Return the first equation in which each of the implied effects shows, if one does."""

        def shows(effect: Effect, equation: Equation) -> bool:
            if effect.late is not None:
                felt = needs[equation.name]
                return effect.late_of in felt if effect.late_of else bool(felt)
            if name := input_of(effect):
                return name in needs[equation.name]
            if is_zero(effect):
                shown = system.channel(channel_of(effect))
                return traced.counts_from_zero(system, equation, shown)
            key = parameter_of(effect)
            enters = traced.symbol(key) if key else traced.marks[effect.stage]
            return any(traced.depends(system, equation, enters))

        # a dead time is exact: what it is off by is a candidate of its name
        missing = [one for one in self.implied if one.late is not None or one.name not in self.present]
        found = {one.name: [e.name for e in equations if shows(one, e)] for one in missing}
        return {name: places[0] for name, places in found.items() if places}

    @cached_property
    def implied(self) -> tuple[Effect, ...]:
        """What may be missing in any system; an effect of the model that has such a name is meant by it."""
        found = implied(self)
        return tuple(one for one in found if one.name not in {effect.name for effect in self.effects})

    @cached_property
    def known(self) -> tuple[Effect, ...]:
        """The effects that the model has already."""
        return tuple(one for one in (*self.effects, *self.implied) if one.name in self.present)

    @property
    def learned(self) -> tuple[Calibration, ...]:
        """By how much their parameters may be off: not dead times, shapes, nor what is at a bound."""
        unit, sd = load().row("gap.learned.deviation").unit, load().gap.learned.deviation
        return tuple(
            Calibration(f"{one.name}_{q.name}", sd, unit, f"{q.name} of {one.name}", True)
            for one in self.known
            if one.late is None and not one.shape
            for q in one.parameters
            if not q.at_bound(self.present[one.name].get(q.name, q.typical))
        )

    @property
    def _lateness(self) -> dict[str, float]:
        """By how much the inputs are known to act late, s: one by its name, all under an empty one."""
        values = {one.name: SimpleNamespace(**self.present[one.name]) for one in self.known}
        return {one.late_of: one.late(values[one.name]) for one in self.known if one.late is not None}

    @property
    def _aged(self) -> dict[str, float]:
        """By how much channels are known to show the past, s."""
        sensors = [one for one in self.known if one.advance is not None]
        known = [one.advance(SimpleNamespace(**self.present[one.name])) for one in sensors if one.advance]
        return {channel: seconds for each in known for channel, seconds in each.items()}

    def _without(self, name: str) -> System:
        return replace(self, present={k: v for k, v in self.present.items() if k != name}).system()

    def _check_names(self) -> None:
        check_free([one.name for one in self.channels], [one.name for one in self.inputs])
        names = [*self.states, *(one.name for one in self.inputs), TIME]
        names += [state for effect in (*self.effects, *self.implied) for state in effect.states]
        groups = {
            "states and inputs": names,
            "channels and inputs": [*(one.name for one in self.channels), *(one.name for one in self.inputs)],
            "parameters": [one.name for one in self.parameters],
            "effects": [one.name for one in self.effects] + [f"{UNKNOWN}{one.name}" for one in self.channels],
        }
        for what, group in groups.items():
            _check_group(what, group)
        self._check_channels()
        self._check_written()

    def _check_written(self) -> None:
        """Check that a model file can hold what a search may find."""
        own = {f"{one.name}_{q.name}": one.name for one in self.effects for q in one.parameters}
        for one in self.parameters:
            if one.name in own:
                raise OrthosisError(
                    f"parameter {one.name!r}: a recalibrated effect {own[one.name]!r} has one of this name"
                )
            if one.name in (System.branch, SEARCH):
                raise OrthosisError(
                    f"parameter {one.name!r}: a model file has something else under this name"
                )
        for effect in self.effects:
            if any(q.name == ON for q in effect.parameters):
                raise OrthosisError(f"effect {effect.name}: {ON!r} says in a model file that it is there")

    def _check_channels(self) -> None:
        for one in self.channels:
            if one.state is not None and one.state not in self.states:
                raise OrthosisError(f"channel {one.name}: {one.state!r} is none of the states")
        known = {one.name for one in self.channels}
        for name in (*(name for part in self.parts.values() for name in part), *self.gains):
            if name not in known:
                raise OrthosisError(f"parts and gains: there is no channel {name!r}")

    def _derived(self, traced: Traced) -> dict[str, str]:
        """Return the states that are not measured, but are the rate of one that is."""
        seen = {one.state for one in self.channels}
        return {
            rate: state
            for state in self.states
            for rate in self.states
            if state in seen and rate not in seen and ca.is_equal(traced.rate(state), traced.state(rate))
        }

    def _equations(self, derived: Mapping[str, str]) -> tuple[Equation, ...]:
        parts = self.parts or {WHOLE: [one.name for one in self.channels]}
        return tuple(self._equation(name, tuple(channels), derived) for name, channels in parts.items())

    def _equation(self, name: str, channels: tuple[str, ...], derived: Mapping[str, str]) -> Equation:
        gains = {}
        for channel in self.channels:
            if channel.name in channels and channel.state is not None:
                states = [channel.state, *(rate for rate, state in derived.items() if state == channel.state)]
                wanted = self.gains.get(channel.name) or _usual_gains(len(states))
                if len(wanted) != len(states):
                    raise OrthosisError(
                        f"gains of {channel.name}: give {len(states)}, for {' and '.join(states)}"
                    )
                gains[channel.name] = dict(zip(states, wanted, strict=True))
        states = [one.state for one in self.channels if one.name in channels and one.state is not None]
        states += [rate for rate, state in derived.items() if state in states]
        return Equation(name, tuple(states), channels, gains, stiff=True)


def _usual_gains(count: int) -> tuple[float, ...]:
    """Return the shipped observer gains: those of a measured signal alone, or of one and its rate."""
    usual = load().gap.replay
    return (usual.pressure_gain,) if count == 1 else (usual.angle_gain, usual.velocity_gain)


def _place(system: System, traced: Traced, equations: Sequence[Equation], effect: Effect) -> str:
    """Return the first equation that what enters at an effect's stage changes."""
    if effect.stage not in traced.marks:
        raise OrthosisError(
            f"effect {effect.name}: the equations assign no signal {effect.stage!r}, its stage; they assign"
            f" {', '.join(traced.marks)}"
        )
    for equation in equations:
        if any(traced.depends(system, equation, traced.marks[effect.stage])):
            return equation.name
    raise OrthosisError(f"effect {effect.name}: nothing that is predicted depends on {effect.stage!r}")


def _check_group(what: str, names: Sequence[str]) -> None:
    for name in names:
        if not name.isidentifier() or names.count(name) > 1:
            reason = "is there twice" if name.isidentifier() else "is no name (letters, digits, _)"
            raise OrthosisError(f"{what}: {name!r} {reason}")
