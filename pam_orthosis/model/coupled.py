# SPDX-License-Identifier: Apache-2.0
"""The emulated hardware of several joints that are coordinates of one mechanism, integrated together."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import islice

import casadi as ca
import numpy as np

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import integrate
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.interlock import Interlock, has_sole
from pam_orthosis.model.mechanisms.base import Mechanics
from pam_orthosis.model.mechanisms.coupled import accelerations
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Array, Plant
from pam_orthosis.model.truth import true_parameters

SHARED = "leg."  # rows of the one mechanism: all its joints have the same


class Joint(Plant):
    """One joint: valves, actuators, sensors and person as of a machine of its own; `Coupled` moves it.

    Args:
        parameters: the whole tree of this joint.
        places: coordinates of all joints at the start.
    """

    def __init__(self, parameters: Parameters, places: Sequence[float]):
        self._places = places
        super().__init__(parameters, parameters.scenario.seed)

    def live_on(self) -> None:
        """Wait: all joints live on together."""

    def _memory(self) -> tuple[Array, Array, Array]:
        inputs = self.steps * self.symbols[1].shape[0]
        return np.zeros(len(self.states)), np.zeros(inputs), np.zeros(self.steps)

    def _acceleration(self) -> ca.Function:
        """Return what is left of the effort at rest, by the inertia, with all joints at their start."""
        index = self.machine.joint
        _given, _ = self._p.symbolic(self.machine.live)
        x, v = ca.SX.sym("q", len(self._places)), ca.SX.sym("v", len(self._places))
        terms = self.machine.coupled_mechanism(true_parameters(self._p)).terms(x, v)
        still = ca.Function("still", [x, v], [terms.inertia[index, index], terms.gravity[index]])
        inertia, gravity = still(self._places, np.zeros(len(self._places)))
        return ca.Function("acceleration", self.symbols, [(self.assembly.signals.effort - gravity) / inertia])


class Coupled:
    """The joints of one mechanism, in the order of its coordinates.

    Attributes:
        joints: measured, commanded and told about one by one, as a `Plant`.

    Raises:
        OrthosisError: joints of different mechanisms, or one that cannot be held at its start.
    """

    def __init__(self, parameters: Sequence[Parameters]):
        _check_alike(parameters)
        places = [one.at(one.declared.start) for one in parameters]
        self.joints = [Joint(one, places) for one in parameters]
        x, u = (ca.vertcat(*(joint.symbols[i] for joint in self.joints)) for i in range(2))
        rates = ca.Function("plant_rates", [x, u], [ca.cse(self._rates(parameters[0])), 0])
        self._steps = max(joint.steps for joint in self.joints)
        self._advance = compiled(integrate.steps_map("coupled_steps", rates, self._steps))
        self._state, self._inputs, self._lengths = self._advance.inputs
        self._state[:] = np.concatenate([joint.state for joint in self.joints])
        ends = np.cumsum([0, *(len(joint.states) for joint in self.joints)])
        for joint, first, last in zip(self.joints, ends, ends[1:], strict=False):
            joint.state = self._state[first:last]

    def live_on(self) -> None:
        """Integrate one control period of all joints; a step begins where a voltage of any changes."""
        coming = set().union(*(joint.coming() for joint in self.joints))
        tables, (lengths, *_) = zip(*(joint.inputs_of(coming) for joint in self.joints), strict=True)
        inputs = np.hstack(tables)
        for first in range(0, len(lengths), self._steps):
            self._integrate(inputs[first : first + self._steps], lengths[first : first + self._steps])
        for joint in self.joints:
            joint.lived()

    def _integrate(self, inputs: Array, lengths: Array) -> None:
        self._inputs.reshape(self._steps, -1)[: len(inputs)] = inputs
        self._lengths[:] = 0.0
        self._lengths[: len(lengths)] = lengths
        self._advance.evaluate()
        self._state[:] = self._advance.outputs[0]

    def _rates(self, parameters: Parameters) -> ca.SX:
        """Return the rates of all states: those of each joint, with the accelerations of the mechanism."""
        s = [joint.assembly.signals for joint in self.joints]
        names = ("coordinate", "velocity", "effort")
        q, v, effort = (ca.vertcat(*(getattr(one, name) for one in s)) for name in names)
        terms = self._terms(parameters, q, v, sum(one.extra_mass for one in s))
        free = [i for i, joint in enumerate(self.joints) if not joint.locked]
        of_all = ca.vertsplit(accelerations(effort, terms, free))
        rates = [joint.assembly.rates for joint in self.joints]
        return ca.vertcat(*(ca.vertcat(own[0], a, own[2:]) for own, a in zip(rates, of_all, strict=True)))

    def _terms(self, parameters: Parameters, q: ca.SX, v: ca.SX, extra_mass: ca.SX) -> Mechanics:
        """Return the terms of Eq. (26) of the true mechanism; what may change on the way is an input."""
        machine = parameters.declared
        live = self.joints[0].symbols[1][len(machine.inputs) :]
        given = parameters.substituted(dict(zip(machine.live, ca.vertsplit(live), strict=True)))
        return machine.coupled_mechanism(true_parameters(given)).terms(q, v, extra_mass)


class Plants:
    """The hardware of a run: a plant in each namespace, joints of one leg coupled, and an interlock."""

    def __init__(self, parameters: Mapping[str, Parameters]):
        groups: dict[str, list[str]] = defaultdict(list)
        for name, one in parameters.items():
            groups[name.rpartition("/")[0] if one.declared.coupled else f"{name}/"].append(name)
        self.of: dict[str, Plant] = {}
        self._coupled: list[Coupled] = []
        for names in groups.values():
            given = [parameters[name] for name in names]
            if given[0].declared.coupled:
                self._coupled.append(Coupled(given))
                self.of |= dict(zip(names, self._coupled[-1].joints, strict=True))
            else:
                self.of[names[0]] = Plant(given[0], given[0].scenario.seed)
        self._lines = [(self.of[name], i) for name in parameters for i in range(len(self.of[name].lines))]
        self._interlock = Interlock(parameters) if any(map(has_sole, parameters.values())) else None

    def advance(self, *voltages: float) -> None:
        """Let a control period pass; voltages, of all valves in order, answer the sample at its start."""
        own = iter(self._interlock.answered(voltages) if self._interlock else voltages)
        for plant in dict.fromkeys(plant for plant, _ in self._lines):
            plant.advance(*islice(own, len(plant.lines)))
        for coupled in self._coupled:
            coupled.live_on()

    def take(self, line: int, voltage: float, at_ns: int) -> None:
        """Take the voltage of the valve of this number that comes at an instant of the plant."""
        plant, own = self._lines[line]
        plant.take(own, self._interlock.allowed(line, voltage) if self._interlock else voltage, at_ns)

    def live_on(self) -> None:
        """Let a control period pass under the voltages that have come."""
        for plant in self.of.values():
            plant.live_on()
        for coupled in self._coupled:
            coupled.live_on()
        if self._interlock:
            self._interlock.passed()


def _check_alike(parameters: Sequence[Parameters]) -> None:
    kinds = [one.declared.neighbour for one in parameters]
    if len({one.declared.coupled for one in parameters}) != 1 or not all(kinds):
        raise OrthosisError("the joints are not of one mechanism")
    own = {one.declared.start for one in parameters}
    first, *others = (one.flat() for one in parameters)
    for other in others:
        for key in first.keys() & other.keys() - own:
            if key.startswith(SHARED) and first[key] != other[key]:
                raise OrthosisError(f"{key} = {first[key]} and {other[key]}: joints of one leg have the same")
