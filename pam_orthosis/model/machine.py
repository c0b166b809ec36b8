# SPDX-License-Identifier: Apache-2.0
"""A machine: a mechanism with named actuators, as one file declares it.

The shipped ones are in `config/machines/`; their parts have parameters in the files of `config/`. A user's
file may give the parameters of its parts itself: they become rows below `machine`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

from pam_orthosis.errors import OrthosisError
from pam_orthosis.markup import Shown
from pam_orthosis.model.components import cylinder, muscle
from pam_orthosis.model.components.actuator import Actuator
from pam_orthosis.model.effects import KINDS
from pam_orthosis.model.effects.base import Effect
from pam_orthosis.model.effects.described import described
from pam_orthosis.model.mechanisms import MECHANISMS
from pam_orthosis.model.mechanisms.base import Coordinate, Mechanics, Mechanism
from pam_orthosis.model.mechanisms.coupled import COUPLED, Leg
from pam_orthosis.model.person.tissue import TISSUE
from pam_orthosis.model.rows import Row, Section
from pam_orthosis.model.signals import Expression

if TYPE_CHECKING:
    from pam_orthosis.model.parameters import Parameters

ACTUATORS: dict[str, Callable[[Section], Actuator]] = {
    "muscle": muscle.actuator,
    "cylinder": cylinder.actuator,
}


@dataclass(frozen=True)
class ActuatorOf:
    """An actuator of a machine.

    Attributes:
        name: in signals, topics and effects.
        kind: `muscle` or `cylinder`.
        parameters: its branch of the parameters.
        transmission: the branch that says how the coordinate contracts it; empty where the mechanism does.
        parallel: so many of them side by side.
        sizes: effect -> how many times larger than elsewhere its coefficients may be.
    """

    name: str
    kind: str
    parameters: str
    transmission: str = ""
    parallel: int = 1
    sizes: Mapping[str, float] = field(default_factory=dict)

    def built(self, parameters: Parameters) -> Actuator:
        """Return it as its parameters describe it."""
        return ACTUATORS[self.kind](parameters.at(self.parameters)).times(self.parallel)


@dataclass(frozen=True, repr=False)
class Machine(Shown):
    """What a file declares.

    Attributes:
        name, meaning: of the machine.
        kind: of its mechanism.
        parameters: branch of its mechanism's parameters.
        actuators: in the order of inputs, states and outputs.
        start: key of the coordinate at which it rests at the start; empty: whoever runs it says so.
        sensor: start of the keys `..._noise` and `..._resolution` of its coordinate's sensor.
        effects: names of the kinds of effects that it may have, in this order; empty: all that fit.
        branch: of the parameters that switches nominal effects on.
        coupled: kind of the mechanism of several coordinates of which its own is one; empty: none.
        experiments: the diagnostic scenarios can be made with it.
        takes: keys whose values are those of other keys.
        rows: parameters that its file gives itself.
        values: key -> value, where its file changes what `config/` says.
        text: of its file; empty for those of `config/`.
    """

    name: str
    meaning: str
    kind: str
    parameters: str
    actuators: tuple[ActuatorOf, ...]
    sensor: str
    start: str = ""
    effects: tuple[str, ...] = ()
    branch: str = "effects"
    coupled: str = ""
    experiments: bool = False
    takes: Mapping[str, str] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()
    values: Mapping[str, Any] = field(default_factory=dict)
    text: str = ""

    @property
    def coordinate(self) -> Coordinate:
        """Its coordinate's names and units."""
        return MECHANISMS[self.kind].coordinate

    @property
    def stops(self) -> tuple[str, ...]:
        """Keys of its coordinate's least and largest value."""
        return tuple(f"{self.parameters}.{name}" for name in MECHANISMS[self.kind].stops)

    @property
    def subjects(self) -> tuple[str, ...]:
        """Files of `config/` with rows that only machines of its kind have."""
        if self.coupled:
            return COUPLED[self.coupled].subjects
        own = MECHANISMS[self.kind].subject
        return (own,) if own else ()

    @property
    def shared_rows(self) -> tuple[str, ...]:
        """How the keys of `config/` begin that it has as a machine of its kind."""
        return MECHANISMS[self.kind].rows or (f"{self.parameters}.",)

    @property
    def joint(self) -> int:
        """Number of its coordinate among those of the coupled mechanism."""
        return COUPLED[self.coupled].joints.index(self.kind)

    @property
    def neighbour(self) -> str:
        """Kind of the other joint of the coupled mechanism; empty: none."""
        return COUPLED[self.coupled].joints[1 - self.joint] if self.coupled else ""

    @property
    def identity(self) -> str:
        """Its name and, if it is of a user's file, what distinguishes it from another of this name."""
        digest = hashlib.sha256(self.text.encode()).hexdigest()[:12]
        return f"{self.name} ({digest})" if self.text else self.name

    @property
    def live(self) -> tuple[str, ...]:
        """Keys of parameters that may change while it runs."""
        return MECHANISMS[self.kind].live

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the actuators."""
        return tuple(one.name for one in self.actuators)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states, those of effects left out."""
        return (self.coordinate.name, "velocity", *(f"{name}_pressure" for name in self.names))

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs; `time` is that since the start of the run, s."""
        return (*(f"{name}_voltage" for name in self.names), *MECHANISMS[self.kind].inputs, "time")

    @property
    def external(self) -> str:
        """The input that adds an effort from outside to its own; empty: it has none."""
        name = f"external_{self.coordinate.effort}"
        return name if name in self.inputs else ""

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what sensors measure."""
        return (self.coordinate.name, *(f"{name}_pressure" for name in self.names))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of what a model reports beside its states, in this order."""
        kinds = ("contraction", "rate", "tension", "flow")
        own = (f"{name}_{kind}" for kind in kinds for name in self.names)
        return (self.coordinate.effort, *own, *(f"measured_{channel}" for channel in self.channels))

    def _instances(self, effect: Effect) -> list[Effect]:
        return effect.instances(self.actuators, (self.coordinate.kind, self.kind))

    def has(self, kind: str) -> bool:
        """Return whether it has what an effect of this kind acts on."""
        return any(self._instances(effect) for effect in KINDS if effect.kind == kind)

    @cached_property
    def catalogue(self) -> dict[str, Effect]:
        """The effects that it can have or miss, by name."""
        known = {effect.kind: effect for effect in KINDS}
        chosen = [known[name] for name in self.effects] if self.effects else KINDS
        instances = [one for effect in chosen for one in self._instances(effect)]
        names = {one.name for one in instances}
        return {
            one.name: replace(
                one,
                confounded_with=tuple(name for name in one.confounded_with if name in names),
                separated_by=one.separated_by if self.experiments else (),
            )
            for one in instances
        }

    @property
    def possible(self) -> dict[str, Effect]:
        """The effects that its nominal model can have: the catalogue, and what could only be described."""
        c = self.coordinate
        return self.catalogue | described(c.name, c.effort, c.effort_unit, self.names)

    @cached_property
    def tissue(self) -> dict[str, Effect]:
        """What a person in the emulated hardware adds to it, by name."""
        kinds = (self.coordinate.kind, self.kind)
        return {one.name: one for effect in TISSUE for one in effect.instances(self.actuators, kinds)}

    def mechanism(self, parameters: Parameters) -> Mechanism:
        """Return its mechanism as the parameters describe it."""
        built: Any = MECHANISMS[self.kind]
        own = [parameters.at(one.transmission) for one in self.actuators if one.transmission]
        section = parameters.at(self.parameters)
        made: Mechanism = built(section, tuple(map(built.transmission, own))) if own else built(section)
        return made

    def coupled_mechanism(self, parameters: Parameters) -> Leg:
        """Return the mechanism of several coordinates of which its own is one."""
        return COUPLED[self.coupled](parameters.at(self.parameters))

    def beside(self, parameters: Parameters, motion: Expression) -> Mechanism:
        """Return its mechanism, the coupled joint moving so: angle, velocity, acceleration (symbols)."""
        whole, built = self.coupled_mechanism(parameters), cast(Any, MECHANISMS[self.kind])

        def mechanics(q: Expression, v: Expression, _: Section, extra_mass: Expression = 0.0) -> Mechanics:
            return whole.terms_of(self.joint, q, v, motion, extra_mass)

        made: Mechanism = built(parameters.at(self.parameters), mechanics)
        return made

    def _shown(self) -> tuple[Sequence[str], list[tuple[str, str, str]], str]:
        rows = [(one.name, one.kind, one.parameters) for one in self.actuators]
        return ("actuator", "kind", "parameters"), rows, f"{self.name}: {self.meaning}"

    def with_parts(self, **branches: str) -> Machine:
        """Return the machine with other branches of parameters for some actuators (name -> branch)."""
        parts = tuple(
            replace(one, parameters=branches.get(one.name, one.parameters)) for one in self.actuators
        )
        return replace(self, actuators=parts)

    def taken(self, parameters: Parameters) -> Parameters:
        """Return the parameters with the values that it takes from other keys."""
        return parameters.changed({key: parameters.at(other) for key, other in self.takes.items()})

    def check(self, parameters: Parameters) -> None:
        """Check that the parameters have the branches and values that it names; OrthosisError if not."""
        self.mechanism(parameters)
        for one in self.actuators:
            one.built(parameters)
        for key in (f"{self.sensor}_noise", f"{self.sensor}_resolution", *filter(None, (self.start,))):
            if not isinstance(parameters.row(key).value, float):
                raise OrthosisError(f"{key} is not a number")
        for key, other in self.takes.items():
            parameters.row(key).with_value(parameters.row(other).value)
