# SPDX-License-Identifier: Apache-2.0
"""Equations cut out of a system's assembly: one replays alone, driven by what is recorded of its neighbours.

At each sample the prediction is compared and the state corrected weakly (innovation form).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.sparse.csgraph import connected_components

from pam_orthosis.discrepancy.systems.system import Assembled, Channel, Equation, Names, System

MOST_PULLED = 0.5  # of a deviation, that one sample takes away
INVERSION_STEPS = 4  # fixed-point steps: a sensor gain of 10 % is inverted to 1e-5 of the value


@dataclass(frozen=True)
class Part:
    """One equation, cut out of an assembly.

    Attributes:
        own: its states, base states first.
        channels: what it predicts.
        parameters: those parameters of the assembly that the equation depends on, `theta`.
        observe: (state, z, theta, period) -> (corrected state, residuals).
        rates: (state, z, theta, period, fraction of the period) -> rates.
        slopes: the same -> derivatives of the rates by the state.
        switches: columns of `z` with an input before and after it changes within a period, of those that the
            rates depend on.
    """

    own: tuple[str, ...]
    channels: tuple[str, ...]
    parameters: tuple[str, ...]
    observe: ca.Function
    rates: ca.Function
    slopes: ca.Function
    switches: tuple[tuple[int, int], ...]

    def fastest(self, rows: np.ndarray, theta: np.ndarray, states: np.ndarray, period: float) -> float:
        """Return the largest eigenvalue (1/s, magnitude) of the rates at some rows of `z` and states."""
        count = len(rows)
        side_by_side = np.array(self.slopes(states.T, rows.T, np.tile(theta[:, None], count), period, 0.0))
        matrices = side_by_side.reshape(len(self.own), count, len(self.own)).swapaxes(0, 1)
        return float(np.abs(np.linalg.eigvals(matrices)).max()) if np.isfinite(matrices).all() else np.inf


def data_width(system: System) -> int:
    """Return the number of columns of the data `z`.

    These are: neighbours now and next, inputs before and now (gradual ones: now and next), time, measured
    channels, second difference quotients, the fraction of the period in which the inputs before still act.
    """
    return 3 * len(system.channels) + 2 * len(system.inputs) + 2 + len(system.derived_twice)


def divided(system: System, assembled: Assembled, equation: Equation) -> list[Equation]:
    """Return an equation as several that do not feel each other, each with some of its channels.

    The gas of one muscle knows nothing of the other's, unless an effect joins them.
    """
    own = closure(system, assembled, equation)
    group = _groups(system, assembled, equation, own)

    def some(names: Names, one: int) -> tuple[str, ...]:
        return tuple(name for name in names if group[name] == one)

    numbers = dict.fromkeys(group[name] for name in equation.channels)
    return [
        replace(equation, states=some(equation.states, one), channels=some(equation.channels, one))
        for one in numbers
    ]


def _groups(system: System, assembled: Assembled, equation: Equation, own: tuple[str, ...]) -> dict[str, int]:
    """Return a number for each state and channel of an equation, the same for those that feel each other."""
    places = [assembled.states.index(name) for name in own]
    results = ca.vertcat(assembled.rates[places], *(assembled.measured[name] for name in equation.channels))
    felt = ca.jacobian_sparsity(results, assembled.x[places]).get_triplet()
    pulled, channel = ca.sparsify(_gains(equation, own)).sparsity().get_triplet()
    derived = [(own.index(a), own.index(b)) for a, b in system.derived.items() if a in own and b in own]
    links = [*zip(*felt, strict=True), *((i, len(own) + k) for i, k in zip(pulled, channel, strict=True))]
    names = (*own, *equation.channels)
    joined = np.zeros((len(names), len(names)), bool)
    joined[tuple(np.array([*links, *derived], int).T)] = True
    return dict(zip(names, connected_components(joined, directed=False)[1].tolist(), strict=True))


def cut(system: System, assembled: Assembled, static: Assembled, equation: Equation) -> Part:
    """Return one equation of an assembly with its neighbours replaced by recorded signals.

    `static` is the same assembly without lagging sensors: from it the true neighbours are got from
    the recorded ones.
    """
    seen = _Seen(system, equation, static)
    own = closure(system, assembled, equation)
    x, z, theta = ca.SX.sym("x", len(own)), ca.SX.sym("z", data_width(system)), assembled.theta
    period, fraction = ca.SX.sym("period"), ca.SX.sym("fraction")
    inputs_now = ca.vertcat(assembled.u, assembled.time)

    def evaluate(expression: ca.SX, state: ca.SX, at: ca.SX | float, held: ca.SX) -> ca.SX:
        full = _full_state(system, assembled, own, state, seen.base(z, theta, period, at, held))
        time = seen.time(z) + at * period
        return ca.substitute([expression], [assembled.x, inputs_now], [full, ca.vertcat(held, time)])[0]

    own_rates = ca.vertcat(*(assembled.rates[assembled.states.index(name)] for name in own))
    rates = evaluate(own_rates, x, fraction, seen.inputs(z, fraction))
    switches = tuple(places for places in seen.switches() if _depends(rates, z[places[1]]))
    predicted = ca.vertcat(*(assembled.measured[name] for name in equation.channels))
    residual = seen.measured(z) - evaluate(predicted, x, 0.0, seen.inputs(z, 0.0, before=True))
    pulled = _gains(equation, own) @ residual
    moved = _moved(system, own, x, pulled)
    remembered = [evaluate(own_rates, state, 0.0, seen.inputs(z, 0.0, before=True)) for state in (x, moved)]
    held = {state for gains in equation.gains.values() for state in gains} - set(equation.states)
    felt = ca.vertcat(*(name in held for name in own)) * (remembered[1] - remembered[0])
    corrected = x + ca.fmin(period, _longest(system, equation)) * (pulled + felt)
    used = sorted(set(ca.jacobian_sparsity(ca.vertcat(rates, residual), theta).get_col()))
    few = ca.SX.sym("theta", len(used))
    placed = ca.SX.zeros(theta.shape[0])
    for place, i in enumerate(used):
        placed[i] = few[place]
    rates, corrected, residual = ca.substitute([rates, corrected, residual], [theta], [placed])
    given = [x, z, few, period, fraction]
    slopes = ca.Function("slopes", given, [ca.densify(ca.jacobian(rates, x))])
    observe = ca.Function("observe", [x, z, few, period], [corrected, residual])
    names = tuple(assembled.parameters[i] for i in used)
    return Part(
        own, equation.channels, names, observe, ca.Function("rates", given, [rates]), slopes, switches
    )


def _longest(system: System, equation: Equation) -> float:
    """Return for how long a sample may hold an equation to its recording, s; a longer pull overshoots."""
    states = {name: str(system.channel(name).state) for name in equation.gains}
    largest = max((gains.get(states[name], 0.0) for name, gains in equation.gains.items()), default=0.0)
    return MOST_PULLED / largest if largest > 0 else math.inf


class _Seen:
    """How an equation reads the columns of `z`."""

    def __init__(self, system: System, equation: Equation, static: Assembled):
        self._system, self._equation = system, equation
        self._channels, self._inputs = len(system.channels), len(system.inputs)
        self._gradual = [name in system.gradual for name in system.inputs]
        neighbours = [c for c in system.channels if c.name not in equation.channels and c.state is not None]
        self._inverse = {c.state: _inverse(system, static, c) for c in neighbours}

    def base(self, z: ca.SX, theta: ca.SX, period: ca.SX, at: ca.SX | float, held: ca.SX) -> dict[str, ca.SX]:
        """Return the true neighbouring base states at a fraction of the period."""
        now, after = z[: self._channels], z[self._channels : 2 * self._channels]
        values: dict[str, ca.SX] = {}
        for channel in self._system.channels:
            if channel.state is None or channel.state not in self._inverse:
                continue
            invert = self._inverse[channel.state]
            first, last = (invert(m, held, self.time(z), theta) for m in (now, after))
            values[channel.state] = first + at * (last - first)
            for derived, parent in self._system.derived.items():
                if parent == channel.state:
                    values[derived] = (last - first) / period
        end = data_width(self._system) - 1
        bends = ca.vertsplit(z[end - len(self._system.derived_twice) : end])
        return values | dict(zip(self._system.derived_twice, bends, strict=True))

    def inputs(self, z: ca.SX, at: ca.SX | float, before: bool = False) -> ca.SX:
        """Return the inputs at a fraction of the period; `before`: those held are of the sample before."""
        first, last = self.recorded_inputs(z)
        between, held = first + at * (last - first), first if before else last
        return ca.vertcat(*(between[i] if g else held[i] for i, g in enumerate(self._gradual)))

    def recorded_inputs(self, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the columns of inputs: before and now, of gradual ones now and next."""
        start, count = 2 * self._channels, self._inputs
        return z[start : start + count], z[start + count : start + 2 * count]

    def switches(self) -> tuple[tuple[int, int], ...]:
        """Return the columns of each input that changes within a period: before and after it does."""
        start = 2 * self._channels
        return tuple((start + i, start + self._inputs + i) for i, g in enumerate(self._gradual) if not g)

    def time(self, z: ca.SX) -> ca.SX:
        return z[2 * self._channels + 2 * self._inputs]

    def measured(self, z: ca.SX) -> ca.SX:
        start = 2 * self._channels + 2 * self._inputs + 1
        names = [c.name for c in self._system.channels]
        return ca.vertcat(*(z[start + names.index(name)] for name in self._equation.channels))


def _inverse(system: System, static: Assembled, channel: Channel) -> ca.Function:
    """Return (recorded channels, inputs, time, theta of the whole assembly) -> true base state."""
    recorded = ca.SX.sym("m", len(system.channels))
    index = [c.name for c in system.channels].index(channel.name)
    place = static.states.index(channel.state)
    added = static.measured[channel.name] - static.x[place]
    states = ca.SX.zeros(len(static.states))
    for i, one in enumerate(system.channels):
        if one.state is not None:
            states[static.states.index(one.state)] = recorded[i]
    true = recorded[index]
    steps = INVERSION_STEPS if _depends(added, static.x) else 1
    for _ in range(steps):
        states[place] = true
        true = recorded[index] - ca.substitute([added], [static.x], [states])[0]
    return ca.Function("inverse", [recorded, static.u, static.time, static.theta], [true])


def _depends(expression: ca.SX, symbols: ca.SX) -> bool:
    return ca.jacobian_sparsity(expression, symbols).nnz() > 0


def _full_state(
    system: System, assembled: Assembled, own: tuple[str, ...], state: ca.SX, neighbours: Mapping[str, ca.SX]
) -> ca.SX:
    full = ca.SX.zeros(len(assembled.states))
    for name, value in neighbours.items():
        full[assembled.states.index(name)] = value
    for place, name in enumerate(own):
        full[assembled.states.index(name)] = state[place]
    return full


def closure(system: System, assembled: Assembled, equation: Equation) -> tuple[str, ...]:
    """Return the equation's base states and all effect states that these or its channels depend on."""
    # seen, if not integrated
    base = {channel.state for channel in system.channels} | {*system.derived, *system.derived_twice}
    outputs = ca.vertcat(*(assembled.measured[name] for name in equation.channels))
    own = list(equation.states)
    while True:
        rates = ca.vertcat(*(assembled.rates[assembled.states.index(name)] for name in own))
        used = sorted(set(ca.jacobian_sparsity(ca.vertcat(rates, outputs), assembled.x).get_col()))
        more = [assembled.states[i] for i in used]
        more = [name for name in more if name not in base and name not in own]
        if not more:
            return tuple(own)
        own += more


def _gains(equation: Equation, own: tuple[str, ...]) -> ca.DM:
    gains = ca.DM.zeros(len(own), len(equation.channels))
    for column, channel in enumerate(equation.channels):
        for state, gain in equation.gains.get(channel, {}).items():
            if state in own:
                gains[own.index(state), column] = gain
    return gains


def _moved(system: System, own: tuple[str, ...], state: ca.SX, pulled: ca.SX) -> ca.SX:
    """Return a state whose derived signals are the rates at which the corrected state moves.

    A state that is held to the recording, a play, is wound by the motion that is predicted, the correction
    included: wound by the model's velocity alone, which at rest is opposite to a lasting correction, it
    would never come loose. Friction is not: what corrects the model meets no resistance.
    """
    moved = ca.SX(state)
    for derived, parent in system.derived.items():
        if derived in own and parent in own:
            moved[own.index(derived)] += pulled[own.index(parent)]
    return moved
