# SPDX-License-Identifier: Apache-2.0
"""Machine code that replays one equation of a system, with or without parameter sensitivities.

The expressions are those of the system's assembly; neighbours are read from the recording. At each
sample the prediction is compared and the state corrected weakly (innovation form); then one period
is integrated with the recorded inputs held, by the classical Runge-Kutta method of fourth order: a
lag inside the step is as exact as the integration, so that no false delay appears.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.sparse.csgraph import connected_components

from pam_orthosis.discrepancy.system import Assembled, Equation, System
from pam_orthosis.model.compiled import best_library, processor

# what is fitted may differ in its last digits from one processor to the next; not a number stays what it is
FLAGS = (
    "-O2", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-fassociative-math",
    "-freciprocal-math", "-ffp-contract=fast", "-fPIC", "-shared", "-Wl,-Bsymbolic",
)  # fmt: skip
OPTIONS = (("-march=native",), ())  # not every compiler knows its processor
INVERSION_STEPS = 4  # fixed-point steps: a sensor gain of 10 % is inverted to 1e-5 of the value
# those of the library are calls; these also keep what is not a number in the second argument
EXTREMES = """
#include <math.h>
#define fmax(x, y) ((x) > (y) ? (x) : (y))
#define fmin(x, y) ((x) < (y) ? (x) : (y))
"""
LOOP = """
static void rk4(double* x, const double* z, const double* theta, const double* period,
                const double* held, double at, double h) {{
  double k[4][{states}], y[{states}], f = at, part = h / *period;
  const double* seen[] = {{y, z, theta, period, &f, held}};
  for (int i = 0; i < {states}; i++) y[i] = x[i];
  for (int s = 0; s < 4; s++) {{
    double* told[] = {{k[s]}};
    f = at + (s == 0 ? 0 : s == 3 ? part : 0.5 * part);
    orthosis_rates(seen, told, 0, 0, 0);
    double w = s == 2 ? h : 0.5 * h;
    if (s < 3) for (int i = 0; i < {states}; i++) y[i] = x[i] + w * k[s][i];
  }}
  for (int i = 0; i < {states}; i++) x[i] += h / 6 * (k[0][i] + 2 * k[1][i] + 2 * k[2][i] + k[3][i]);
}}

void orthosis_replay(long n, long substeps, double period, const double* z, const double* theta,
                     const double* start, double* result) {{
  double x[{states}], next[{states}], fixed[{fixed}], held[{held}], h = period / substeps;
  const double* once[] = {{theta, &period}};
  double* kept[] = {{fixed}};
  orthosis_fixed(once, kept, 0, 0, 0);
  for (int i = 0; i < {states}; i++) x[i] = start[i];
  for (long k = 0; k < n; k++) {{
    const double* seen[] = {{x, z + k * {data}, theta, &period}};
    double* told[] = {{next, result + k * {results}}};
    orthosis_observe(seen, told, 0, 0, 0);
    for (int i = 0; i < {states}; i++) x[i] = next[i];
    const double* given[] = {{z + k * {data}, theta, &period, fixed}};
    double* got[] = {{held}};
    orthosis_held(given, got, 0, 0, 0);
    for (long j = 0; j < substeps; j++)
      rk4(x, z + k * {data}, theta, &period, held, (double)j / substeps, h);
  }}
}}
"""


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
        late: recorded signals may be shifted: inputs change within a period.
    """

    own: tuple[str, ...]
    channels: tuple[str, ...]
    parameters: tuple[str, ...]
    observe: ca.Function
    rates: ca.Function
    slopes: ca.Function
    late: bool

    def fastest(self, rows: np.ndarray, theta: np.ndarray, states: np.ndarray, period: float) -> float:
        """Return the largest eigenvalue (1/s, magnitude) of the rates at some rows of `z` and states."""
        count = len(rows)
        side_by_side = np.array(self.slopes(states.T, rows.T, np.tile(theta[:, None], count), period, 0.0))
        matrices = side_by_side.reshape(len(self.own), count, len(self.own)).swapaxes(0, 1)
        return float(np.abs(np.linalg.eigvals(matrices)).max()) if np.isfinite(matrices).all() else np.inf


def data_width(system: System) -> int:
    """Return the number of columns of the data `z`.

    These are: neighbours now and next, inputs before and now, time, measured channels, the fraction of the
    period in which the inputs before still act.
    """
    return 3 * len(system.channels) + 2 * len(system.inputs) + 2


def divided(system: System, assembled: Assembled, equation: Equation) -> list[Equation]:
    """Return an equation as several that do not feel each other, each with some of its channels.

    The gas of one muscle knows nothing of the other's, unless an effect joins them.
    """
    own = closure(system, assembled, equation)
    group = _groups(system, assembled, equation, own)

    def some(names: tuple[str, ...], one: int) -> tuple[str, ...]:
        return tuple(name for name in names if group[name] == one)

    numbers = dict.fromkeys(group[name] for name in equation.channels)
    return [
        replace(equation, states=some(equation.states, one), channels=some(equation.channels, one))
        for one in numbers
    ]


def _groups(system: System, assembled: Assembled, equation: Equation, own) -> dict[str, int]:
    """Return a number for each state and channel of an equation, the same for those that feel each other."""
    places = [assembled.states.index(name) for name in own]
    told = ca.vertcat(assembled.rates[places], *(assembled.measured[name] for name in equation.channels))
    felt = ca.jacobian_sparsity(told, assembled.x[places]).get_triplet()
    pulled, channel = ca.sparsify(_gains(equation, own)).sparsity().get_triplet()
    derived = [(own.index(a), own.index(b)) for a, b in system.derived.items() if a in own and b in own]
    links = [*zip(*felt, strict=True), *((i, len(own) + k) for i, k in zip(pulled, channel, strict=True))]
    names = (*own, *equation.channels)
    joined = np.zeros((len(names), len(names)), bool)
    joined[tuple(np.array([*links, *derived], int).T)] = True
    return dict(zip(names, connected_components(joined, directed=False)[1].tolist(), strict=True))


def cut(system: System, assembled: Assembled, static: Assembled, equation: Equation, late: bool) -> Part:
    """Return one equation of an assembly with its neighbours replaced by recorded signals.

    `static` is the same assembly without lagging sensors: from it the true neighbours are got from
    the recorded ones. `late`: inputs change within a period, at the fraction that a row of `z` tells;
    the rates before and after are weighted by their times.
    """
    seen = _Seen(system, equation, static)
    own = closure(system, assembled, equation)
    x, z, theta = ca.SX.sym("x", len(own)), ca.SX.sym("z", data_width(system)), assembled.theta
    period, fraction = ca.SX.sym("period"), ca.SX.sym("fraction")
    inputs_now = ca.vertcat(assembled.u, assembled.time)

    def evaluate(expression, state, at, held):
        full = _full_state(system, assembled, own, state, seen.base(z, theta, period, at, held))
        time = seen.time(z) + at * period
        return ca.substitute([expression], [assembled.x, inputs_now], [full, ca.vertcat(held, time)])[0]

    own_rates = ca.vertcat(*(assembled.rates[assembled.states.index(name)] for name in own))
    rates = evaluate(own_rates, x, fraction, seen.inputs(z))
    if late and _depends(rates, seen.inputs(z)):
        before = evaluate(own_rates, x, fraction, seen.inputs_before(z))
        rates += seen.share_before(z) * (before - rates)
    predicted = ca.vertcat(*(assembled.measured[name] for name in equation.channels))
    residual = seen.measured(z) - evaluate(predicted, x, 0.0, seen.inputs_before(z))
    pulled = _gains(equation, own) @ residual
    moved = _moved(system, own, x, pulled)
    remembered = [evaluate(own_rates, state, 0.0, seen.inputs_before(z)) for state in (x, moved)]
    held = {state for gains in equation.gains.values() for state in gains} - set(equation.states)
    felt = ca.vertcat(*(name in held for name in own)) * (remembered[1] - remembered[0])
    corrected = x + period * (pulled + felt)
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
    return Part(own, equation.channels, names, observe, ca.Function("rates", given, [rates]), slopes, late)


class _Seen:
    """How an equation reads the columns of `z`."""

    def __init__(self, system: System, equation: Equation, static: Assembled):
        self._system, self._equation = system, equation
        self._channels, self._inputs = len(system.channels), len(system.inputs)
        neighbours = [c for c in system.channels if c.name not in equation.channels and c.state is not None]
        self._inverse = {c.state: _inverse(system, static, c) for c in neighbours}

    def base(self, z, theta, period, at, held) -> dict:
        """Return the true neighbouring base states at a fraction of the period."""
        now, after = z[: self._channels], z[self._channels : 2 * self._channels]
        values = {}
        for channel in self._system.channels:
            if channel.state not in self._inverse:
                continue
            invert = self._inverse[channel.state]
            first, last = (invert(m, held, self.time(z), theta) for m in (now, after))
            values[channel.state] = first + at * (last - first)
            for derived, parent in self._system.derived.items():
                if parent == channel.state:
                    values[derived] = (last - first) / period
        return values

    def inputs_before(self, z):
        return z[2 * self._channels : 2 * self._channels + self._inputs]

    def inputs(self, z):
        start = 2 * self._channels + self._inputs
        return z[start : start + self._inputs]

    def time(self, z):
        return z[2 * self._channels + 2 * self._inputs]

    def share_before(self, z):
        return z[z.shape[0] - 1]

    def measured(self, z):
        start = 2 * self._channels + 2 * self._inputs + 1
        names = [c.name for c in self._system.channels]
        return ca.vertcat(*(z[start + names.index(name)] for name in self._equation.channels))


def _inverse(system: System, static: Assembled, channel) -> ca.Function:
    """Return (recorded channels, inputs, time, theta of the whole assembly) -> true base state."""
    recorded = ca.SX.sym("m", len(system.channels))
    index = [c.name for c in system.channels].index(channel.name)
    place = static.states.index(channel.state)
    added = static.measured[channel.name] - static.x[place]
    states = _as_measured(system, static, recorded)
    true = recorded[index]
    steps = INVERSION_STEPS if _depends(added, static.x) else 1
    for _ in range(steps):
        states[place] = true
        true = recorded[index] - ca.substitute([added], [static.x], [states])[0]
    return ca.Function("inverse", [recorded, static.u, static.time, static.theta], [true])


def _as_measured(system: System, static: Assembled, recorded):
    states = ca.SX.zeros(len(static.states))
    for i, channel in enumerate(system.channels):
        if channel.state is not None:
            states[static.states.index(channel.state)] = recorded[i]
    return states


def _depends(expression, symbols) -> bool:
    return ca.jacobian_sparsity(expression, symbols).nnz() > 0


def _full_state(system, assembled, own, state, neighbours):
    full = ca.SX.zeros(len(assembled.states))
    for name, value in neighbours.items():
        full[assembled.states.index(name)] = value
    for place, name in enumerate(own):
        full[assembled.states.index(name)] = state[place]
    return full


def closure(system: System, assembled: Assembled, equation: Equation) -> tuple[str, ...]:
    """Return the equation's base states and all effect states that these or its channels depend on."""
    base = {channel.state for channel in system.channels} | set(system.derived)  # seen, if not integrated
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


def _moved(system: System, own: tuple[str, ...], state, pulled):
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


class Kernel:
    """A part as machine code (or on CasADi's virtual machine), for whole recordings.

    Args:
        part: the equation.
        wrt: parameters by which the residuals are differentiated; none for a plain replay.
    """

    def __init__(self, part: Part, wrt: tuple[str, ...] = ()):
        self.part, self.wrt = part, wrt
        self._observe, rates = _with_sensitivities(part, wrt)
        self._rates, self._held, self._fixed = _hoisted(rates)
        self.states, self.channels = len(part.own), part.observe.size1_out(1)
        self._size, self._results = self._observe.size1_in(0), self._observe.size1_out(1)
        self._width = part.observe.size1_in(1)
        self._library, self._source = None, self._write_source()

    def __call__(self, z, theta, start, period: float, substeps: int) -> np.ndarray:
        """Return residuals (n, channels) or, with sensitivities, (n, channels, 1 + len(wrt))."""
        state = np.zeros(self._size)
        state[: self.states] = start
        if self._library is None:
            flat = self._run_virtual(z, theta, state, period, substeps)
        else:
            flat = np.empty((len(z), self._results))
            self._library.orthosis_replay(
                ctypes.c_long(len(z)), ctypes.c_long(substeps), ctypes.c_double(period),
                _pointer(z), _pointer(theta), _pointer(state), _pointer(flat),
            )  # fmt: skip
        if not self.wrt:
            return flat
        return flat.reshape(len(z), 1 + len(self.wrt), self.channels).transpose(0, 2, 1)

    def build(self) -> None:
        """Compile; without a compiler the virtual machine does the work."""
        path = best_library("replay", self._source, FLAGS, OPTIONS)
        self._library = None if path is None else ctypes.CDLL(str(path))

    def _write_source(self) -> str:
        generator = ca.CodeGenerator("replay.c")
        for function in (self._observe, self._rates, self._held, self._fixed):
            generator.add(function)
        loop = LOOP.format(
            states=self._size, data=self._width, results=self._results,
            fixed=max(1, self._fixed.size1_out(0)), held=max(1, self._held.size1_out(0)),
        )  # fmt: skip
        return f"/* {processor()} */\n" + EXTREMES + generator.dump() + loop

    def _run_virtual(self, z, theta, state, period, substeps):
        x, row = ca.MX.sym("x", self._size), ca.MX.sym("z", self._width)
        parameters = ca.MX.sym("theta", len(theta))
        after, result = self._observe(x, row, parameters, period)
        held = self._held(row, parameters, period, self._fixed(parameters, period))
        for j in range(substeps):
            after = self._virtual_step(after, row, parameters, held, period, j / substeps, period / substeps)
        one = ca.Function("one", [x, row, parameters], [after, result])
        many = one.mapaccum(len(z))
        told = many(state, z.T, np.tile(theta[:, None], (1, len(z))))[1]
        return np.array(told).T

    def _virtual_step(self, x, z, theta, held, period, at, h):
        """Return the state one Runge-Kutta step later, as the C loop does it."""

        def rates(state, part):
            return self._rates(state, z, theta, period, at + part * h / period, held)

        k1 = rates(x, 0.0)
        k2 = rates(x + h / 2 * k1, 0.5)
        k3 = rates(x + h / 2 * k2, 0.5)
        k4 = rates(x + h * k3, 1.0)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _with_sensitivities(part: Part, wrt: tuple[str, ...]) -> tuple[ca.Function, ca.Function]:
    """Return observe and rates for the state with its sensitivities appended, columns by parameter.

    Runge-Kutta steps of the variational equation are the derivatives of the Runge-Kutta steps.
    """
    x, z = ca.SX.sym("x", len(part.own)), ca.SX.sym("z", part.observe.size1_in(1))
    theta, period = ca.SX.sym("theta", len(part.parameters)), ca.SX.sym("period")
    fraction = ca.SX.sym("fraction")
    s = ca.SX.sym("s", len(part.own), len(wrt))
    chosen = [part.parameters.index(name) for name in wrt]
    whole = ca.vertcat(x, ca.vec(s))

    def extended(expression):
        by_state, by_theta = ca.jacobian(expression, x), ca.jacobian(expression, theta)
        return ca.densify(ca.vertcat(expression, ca.vec(by_state @ s + by_theta[:, chosen])))

    told = [extended(one) for one in part.observe(x, z, theta, period)]
    rates = extended(part.rates(x, z, theta, period, fraction))
    return (
        ca.Function("orthosis_observe", [whole, z, theta, period], told),
        ca.Function("orthosis_rates", [whole, z, theta, period, fraction], [rates]),
    )


def _hoisted(rates: ca.Function) -> tuple[ca.Function, ca.Function, ca.Function]:
    """Return rates(..., held), held(z, theta, period, fixed) and fixed(theta, period).

    What depends on the parameters alone is computed once a recording, what depends on the recorded
    sample alone once a step.
    """
    x, z, theta, period, fraction = (
        ca.SX.sym(name, rates.size1_in(i)) for i, name in enumerate(("x", "z", "theta", "period", "f"))
    )
    inner, held, by_sample = _extracted(rates(x, z, theta, period, fraction), ca.vertcat(z, theta, period))
    outer, fixed, by_theta = _extracted(by_sample, ca.vertcat(theta, period))
    return (
        ca.Function("orthosis_rates", [x, z, theta, period, fraction, held], [inner]),
        ca.Function("orthosis_held", [z, theta, period, fixed], [outer]),
        ca.Function("orthosis_fixed", [theta, period], [by_theta]),
    )


def _extracted(expression, symbols):
    """Return the expression with what depends on `symbols` alone taken out, its names, its values."""
    inner, names, values = ca.extract_parametric(expression, symbols)
    return ca.densify(inner), ca.vertcat(*names), ca.densify(ca.vertcat(*values))
