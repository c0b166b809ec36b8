# SPDX-License-Identifier: Apache-2.0
"""Optimal control of one cycle: the periodic motion nearest to a wanted one that the actuators can make.

The unknowns are states and mass flows at the nodes of a grid, bound by the equations of the controllers'
model (implicit midpoint rule). Pressures in bar and flows in g/s there keep the numbers of like size.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from threading import current_thread, main_thread
from types import FrameType
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from pam_orthosis.control import effects
from pam_orthosis.control.axis import Axis
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.assembly import set_pressure_rates
from pam_orthosis.model.mechanisms.base import acceleration
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.signals import Expression, Signals
from pam_orthosis.processes import ENDING

Array: TypeAlias = NDArray[np.float64]

BAR, GRAM = 1.0e5, 1.0e-3
HELPS = "a slower cycle, a lighter person or more supply pressure helps"


class NotFound(OrthosisError):
    """The search ended without a motion that the muscles can make."""


@dataclass(frozen=True)
class Cycle:
    """A periodic motion at N equidistant instants: (N,) rad or m, both pressures (2, N), absolute Pa.

    `largest` is its error, rad or m. `solution` is, of a cycle that was found, states and flows as the search
    has them.
    """

    position: Array
    pressures: Array
    largest: float
    solution: tuple[Array, Array] | None = None

    @property
    def mean_pressure(self) -> Array:
        """Mean of both pressures, (N,) Pa."""
        return np.asarray(self.pressures.sum(axis=0) / 2)


def nearest_cycle(
    nominal: Parameters,
    start: Cycle,
    position: Array,
    velocity: Array,
    effort: Array,
    period: float,
    share: float = 1.0,
) -> Cycle:
    """Return the cycle whose largest distance from a wanted one is least.

    Args:
        start: where the search begins.
        position: (N,) wanted, rad or m.
        velocity: (N,) its rate.
        effort: (N,) what is added to the actuators' torque or force between an instant and the next.
        period: between two instants, s.
        share: of what an open valve passes, that is asked for at most.

    Raises:
        NotFound: no motion was found that the muscles can make.
    """
    count, rate = len(position), _rates(nominal, share)
    low = nominal.control.position.minimum_pressure / BAR
    high = nominal.control.position.maximum_pressure / BAR
    opti = ca.Opti()
    x = opti.variable(rate.size1_in(0), count)
    flow = opti.variable(2, count)
    largest = opti.variable()
    after = ca.horzcat(x[:, 1:], x[:, 0])
    rates, margins = rate.map(count)((x + after) / 2, flow, effort.reshape(1, -1))
    opti.subject_to(ca.vec(after - x - period * rates) == 0)
    opti.subject_to(ca.vec(margins) >= 0)
    opti.subject_to(opti.bounded(low, ca.vec(x[2:4, :]), high))
    error = x[0, :] - position.reshape(1, -1)
    opti.subject_to(opti.bounded(-largest, error, largest))
    opti.subject_to(error[0] == 0)  # where the run begins
    shown = nominal.declared.coordinate.shown_factor
    mean = (x[2, :] + x[3, :]) / 2 - nominal.control.position.mean_pressure / BAR
    opti.minimize(largest * shown + _cost(flow, mean, error * shown, period))
    _begin(opti, x, flow, start, velocity)
    opti.set_initial(largest, start.largest or 0.1)
    value: Callable[[Expression], Any] = _solved(opti).value
    states = value(x)
    return Cycle(states[0], states[2:4] * BAR, float(value(largest)), (states, value(flow)))


def _cost(flow: Expression, mean: Expression, error: Expression, period: float) -> Expression:
    """Return the objective beside the largest error in degrees or mm: what else the controllers do anyway."""
    change = flow - ca.horzcat(flow[:, -1], flow[:, :-1])
    flow_weight, error_weight, mean_weight = 1.0e-3, 1.0e-2, 1.0e-3
    cost = flow_weight * ca.sumsqr(change) + mean_weight * ca.sumsqr(mean) * period
    return cost + error_weight * ca.sumsqr(error) * period


def _begin(opti: ca.Opti, x: Expression, flow: Expression, start: Cycle, velocity: Array) -> None:
    """Let the search begin at a cycle, with its solution if it was found."""
    if start.solution:
        opti.set_initial(x, start.solution[0])
        opti.set_initial(flow, start.solution[1])
    else:
        opti.set_initial(x[0, :], start.position.reshape(1, -1))
        opti.set_initial(x[1, :], velocity.reshape(1, -1))
        opti.set_initial(x[2:4, :], start.pressures / BAR)


def _solved(opti: ca.Opti) -> ca.OptiSol:
    seconds = 600.0  # of processor time: iterations come first, on a slow machine too
    iterations = 1000
    limits: dict[str, Any] = {
        "max_iter": iterations,
        "max_cpu_time": seconds,
        "tol": 1e-5,
        "mu_strategy": "adaptive",
    }
    opti.solver("ipopt", {"print_time": False}, {**limits, "print_level": 0, "sb": "yes"})
    try:
        with _interrupts():
            return opti.solve()
    except RuntimeError:
        raise NotFound(f"the search found no motion that these actuators can make; {HELPS}") from None


@contextmanager
def _interrupts() -> Iterator[None]:
    """Raise KeyboardInterrupt behind a search that a signal was to end, which CasADi takes for a failure."""
    if current_thread() is not main_thread():
        yield
        return
    came: list[int] = []
    before: dict[int, Callable[[int, FrameType | None], Any]] = {
        number: handler for number in ENDING if callable(handler := signal.getsignal(number))
    }

    def note(number: int, frame: FrameType | None) -> None:
        came.append(number)
        before[number](number, frame)

    for number in before:
        signal.signal(number, note)
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            raise KeyboardInterrupt


def _rates(nominal: Parameters, share: float) -> ca.Function:
    """Return (state, mass flows, effort of the effects) -> (rates, distances from the flows allowed)."""
    model, scales = effects.gas_model(nominal), effects.supply_scales(nominal)
    s, flow, effort = model.signals.copy(), ca.SX.sym("flow", 2), ca.SX.sym("effort")
    own = ca.SX.sym("supply", len(scales))
    for i, a in enumerate(s.actuators.values()):
        a.flow = flow[i] * GRAM
    set_pressure_rates(s)
    drawing = 0.02 * GRAM  # kg/s over which a valve begins to draw: an edge has no second derivative
    drawn = {name: _positive(a.flow, drawing) for name, a in s.actuators.items()}
    supply, supply_rates = effects.supply(nominal, own, drawn)
    rates = [s.velocity, _acceleration(s, effort, Axis(nominal))]
    rates += [a.pressure_rate for a in s.actuators.values()]
    rates.append(supply_rates)
    margins = []
    for i, (name, a) in enumerate(s.actuators.items()):
        passes = effects.flow_of_opening(nominal, name)
        margins.append(share * passes(1.0, a.pressure, supply) / GRAM - flow[i])
        margins.append(flow[i] - share * passes(-1.0, a.pressure, supply) / GRAM)
    scale = ca.DM([1.0, 1.0, BAR, BAR, *scales])
    base = model.x[: len(nominal.declared.states)]
    scaled = ca.SX.sym("scaled", scale.shape[0])
    whole = [ca.vertcat(*rates) / scale, ca.vertcat(*margins)]
    whole = ca.substitute(whole, [ca.vertcat(base, own)], [scaled * scale])
    return ca.Function("cycle_rates", [scaled, flow, effort], [ca.cse(term) for term in whole])


def _acceleration(s: Signals, effort: Expression, axis: Axis) -> Expression:
    pulls = []
    slackening = 15.0  # N over which a muscle goes slack: the law's edge has no second derivative
    for one, a in zip(axis.actuators, s.actuators.values(), strict=True):
        pull = one.force(a.contraction, a.gauge) - one.damping * a.rate
        pulls.append(_positive(pull, slackening) if one.pulls_only else pull)
    share, arm = axis.lever(s.coordinate)
    whole = arm * (pulls[1] - share * pulls[0]) + effort
    return acceleration(whole, axis.terms(s.coordinate, s.velocity))


def _positive(x: Expression, width: float) -> Expression:
    """Return the positive part, with its edge rounded over a width."""
    return (x + ca.sqrt(x**2 + width**2)) / 2
