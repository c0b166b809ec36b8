# SPDX-License-Identifier: Apache-2.0
"""Machine code that replays one equation of a system, with or without parameter sensitivities.

The expressions are those of the system's assembly; neighbours are read from the recording. At each
sample the prediction is compared and the state corrected weakly (innovation form); then one period
is integrated with the recorded inputs, held (`gradual` ones interpolated), by the classical
Runge-Kutta method of fourth order. Inputs that act late change within the period: it is integrated up to
there and on from there, so that a lag is as exact as the integration and no false delay appears.
"""

import ctypes
import math
from collections.abc import Mapping
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from pam_orthosis.discrepancy.replay import source as source_module
from pam_orthosis.discrepancy.replay.lanes import LANES, Lanes
from pam_orthosis.discrepancy.replay.source import source
from pam_orthosis.discrepancy.systems.cut import Part
from pam_orthosis.discrepancy.systems.system import Names
from pam_orthosis.model import compiled
from pam_orthosis.model.compiled import best_library, pointer, processor, remember, remembered, taken_out

NAME = "replay"  # of the libraries
# what is fitted may differ in its last digits from one processor to the next; not a number stays what it is.
# Compiling is half of a first search: -O2 takes two fifths longer, for code that is hardly faster
FLAGS = (
    "-O1", "-ftree-vectorize", "-fopenmp-simd", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros",
    "-fassociative-math", "-freciprocal-math", "-ffp-contract=fast", "-fPIC", "-shared", "-Wl,-Bsymbolic",
    "-Wl,-z,defs",
)  # fmt: skip
# not every library has functions of vectors, and not every compiler knows its processor; for some of these it
# would take short vectors, whose functions take as long
OPTIONS = (
    ("-march=native", "-mprefer-vector-width=512", "-DVECTOR_MATHEMATICS"),
    ("-march=native",),
    (),
)


class Kernel:
    """A part as machine code (or on CasADi's virtual machine), for whole recordings.

    Args:
        part: the equation.
        wrt: parameters by which the residuals are differentiated; none for a plain replay.
    """

    def __init__(self, part: Part, wrt: Names = ()):
        self.part, self.wrt = part, wrt
        self.states, self.channels = len(part.own), part.observe.size1_out(1)
        self._size, self._results = ((1 + len(wrt)) * count for count in (self.states, self.channels))
        self._width = part.observe.size1_in(1)  # of the rows
        self._library: ctypes.CDLL | None = None
        self._key = _key(part, wrt)
        self._path = remembered(NAME, self._key)
        self._source = "" if self._path else self._write_source()

    def __call__(
        self, rows: Lanes, theta: np.ndarray, starts: np.ndarray, period: float, substeps: int
    ) -> np.ndarray:
        """Return residuals (n, channels) or, with sensitivities, (n, channels, 1 + len(wrt)).

        The inputs of all rows change at the same fraction of the period, which their last column holds.

        Args:
            rows: `z`.
            theta: values of the part's parameters.
            starts: (stretches, states), where each stretch of the rows begins.
            period: s.
            substeps: integration steps a period.
        """
        state = np.zeros((self._size, LANES))
        state[: self.states] = starts.T
        at = float(rows.z[0, -1, 0]) if self.part.switches else 0.0
        steps = math.ceil(at * substeps), max(1, math.ceil((1 - at) * substeps))
        if self._library is None:
            z = rows.at(np.arange(rows.rows))
            flat = self._run_virtual(z, theta, np.ascontiguousarray(state[:, 0]), period, steps)
        else:
            one_pass = partial(self._passed, theta, period, steps)
            flat = rows.replayed(one_pass, state, self._results, self._size - self.states)
        if not self.wrt:
            return flat
        table: np.ndarray = flat.reshape(rows.rows, 1 + len(self.wrt), self.channels).transpose(0, 2, 1)
        return table

    def _passed(
        self,
        theta: np.ndarray,
        period: float,
        steps: tuple[int, int],
        rows: Lanes,
        first: np.ndarray,
        results: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Fill the results of all stretches: see `Lanes.replayed`."""
        assert self._library is not None
        start = np.ascontiguousarray(first)
        begun, ended = np.empty_like(start), np.empty_like(start)
        counts = (len(rows.z), rows.warm, *steps)
        arrays = (rows.z, theta, start, results, begun, ended)
        self._library.orthosis_replay(
            *map(ctypes.c_long, counts), ctypes.c_double(period), *map(pointer, arrays)
        )
        return begun, ended

    @property
    def built(self) -> bool:
        """Whether it is machine code."""
        return self._library is not None

    def build(self) -> None:
        """Compile; without a compiler the virtual machine does the work."""
        if self._path is None:
            self._path = best_library(NAME, self._source, FLAGS, OPTIONS)
            if self._path:
                remember(NAME, self._key, self._path)
        self._library = None if self._path is None else ctypes.CDLL(str(self._path))

    def __getstate__(self) -> dict[str, Any]:
        """Return what another process needs to load the machine code."""
        rest = ("_library", "_functions", "_source")
        return {key: value for key, value in vars(self).items() if key not in rest}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        vars(self).update(state)
        self._library = ctypes.CDLL(str(self._path))

    @cached_property
    def _functions(self) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function]:
        """observe, rates, held, fixed: see `_with_sensitivities` and `_hoisted`."""
        observe, rates = _with_sensitivities(self.part, self.wrt)
        return observe, *_hoisted(rates)

    def _write_source(self) -> str:
        return f"/* {processor()} */\n" + source(self._functions, self.part.switches)

    def _run_virtual(
        self, z: np.ndarray, theta: np.ndarray, state: np.ndarray, period: float, steps: tuple[int, int]
    ) -> np.ndarray:
        x, row = ca.MX.sym("x", self._size), ca.MX.sym("z", self._width)
        parameters = ca.MX.sym("theta", len(theta))
        observe, _, outer, fixed = self._functions
        after, result = observe(x, row, parameters, period)
        before, at = ca.MX(row), float(z[0, -1]) if steps[0] else 0.0
        for old, now in self.part.switches:
            before[now] = row[old]
        for seen, begin, end, count in ((before, 0.0, at, steps[0]), (row, at, 1.0, steps[1])):
            held = outer(seen, parameters, period, fixed(parameters, period))
            for j in range(count):
                share = (end - begin) / count
                place, step = begin + j * share, share * period
                after = self._virtual_step(after, seen, parameters, held, period, place, step)
        one = ca.Function("one", [x, row, parameters], [after, result])
        many = one.mapaccum(len(z))
        results = many(state, z.T, np.tile(theta[:, None], (1, len(z))))[1]
        residuals: np.ndarray = np.array(results).T
        return residuals

    def _virtual_step(
        self, x: ca.MX, z: ca.MX, theta: ca.MX, held: ca.MX, period: float, at: float, h: float
    ) -> ca.MX:
        """Return the state one Runge-Kutta step later, as the C loop does it."""

        def rates(state: ca.MX, part: float) -> ca.MX:
            return self._functions[1](state, z, theta, period, at + part * h / period, held)

        k1 = rates(x, 0.0)
        k2 = rates(x + h / 2 * k1, 0.5)
        k3 = rates(x + h / 2 * k2, 0.5)
        k4 = rates(x + h * k3, 1.0)
        return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _key(part: Part, wrt: Names) -> str:
    """Return what the source of a kernel follows from: cheaper than the source."""
    code = [
        Path(file).read_text(encoding="utf-8")
        for file in (__file__, source_module.__file__, compiled.__file__)
    ]
    # the functions know parameters by their place alone
    names = repr((part.parameters, wrt, part.switches, LANES))
    return "\n".join(
        (part.observe.serialize(), part.rates.serialize(), names, version("casadi"), *code, processor())
    )


def _with_sensitivities(part: Part, wrt: Names) -> tuple[ca.Function, ca.Function]:
    """Return observe and rates for the state with its sensitivities appended, columns by parameter.

    Runge-Kutta steps of the variational equation are the derivatives of the Runge-Kutta steps.
    """
    x, z = ca.SX.sym("x", len(part.own)), ca.SX.sym("z", part.observe.size1_in(1))
    theta, period = ca.SX.sym("theta", len(part.parameters)), ca.SX.sym("period")
    fraction = ca.SX.sym("fraction")
    s = ca.SX.sym("s", len(part.own), len(wrt))
    chosen = [part.parameters.index(name) for name in wrt]
    whole = ca.vertcat(x, ca.vec(s))

    def extended(expression: ca.SX) -> ca.SX:
        by_state, by_theta = ca.jacobian(expression, x), ca.jacobian(expression, theta)
        return ca.densify(ca.vertcat(expression, ca.vec(by_state @ s + by_theta[:, chosen])))

    results = ca.cse([extended(one) for one in part.observe(x, z, theta, period)])
    rates = ca.cse(extended(part.rates(x, z, theta, period, fraction)))
    return (
        ca.Function("orthosis_observe", [whole, z, theta, period], results),
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
    inner, held, by_sample = taken_out(rates(x, z, theta, period, fraction), ca.vertcat(z, theta, period))
    outer, fixed, by_theta = taken_out(by_sample, ca.vertcat(theta, period))
    return (
        ca.Function("orthosis_rates", [x, z, theta, period, fraction, held], [inner]),
        ca.Function("orthosis_held", [z, theta, period, fixed], [outer]),
        ca.Function("orthosis_fixed", [theta, period], [by_theta]),
    )
