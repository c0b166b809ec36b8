# SPDX-License-Identifier: Apache-2.0
"""SciPy's side: `solve_ivp` on the plant's equations, compiled as the plant's own are or as a script."""

from __future__ import annotations

import time
from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from pam_orthosis.model.assembly import assemble
from pam_orthosis.model.compiled import compiled
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import Plant, true_hardware
from speed.scripted import scripted

TOLERANCES = (1e-1, 3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
METHODS = ("RK23", "RK45", "DOP853", "LSODA")
TIGHT = ("DOP853", 1e-9)
SCALES = {"angle": 1.0, "velocity": 1.0, "pressure": 1e5}  # of states whose errors count alike
SMALL = 1e-3  # absolute tolerance / (relative tolerance x scale)


class Solved:
    """The plant's equations, solved control period by control period.

    Voltages jump from one period to the next: a step across a jump would be rejected again and again.

    Args:
        voltages: (periods, 2), V.
        made: makes something to be called with state and inputs of the function of the rates.
    """

    def __init__(self, parameters: Parameters, voltages: np.ndarray, made: Callable = compiled):
        assembly = assemble(true_hardware(parameters))
        given = [assembly.x, assembly.u]
        self._rates = made(ca.Function("rates", given, ca.cse([assembly.rates])))
        self._told = compiled(ca.Function("told", given, ca.cse([assembly.measured])))
        self._start = Plant(parameters).state.copy()
        self._closed, self._voltages = parameters.valve.closed_voltage, voltages
        self._period = parameters.scenario.control_period
        self._small = SMALL * np.array([_scale(name) for name in assembly.states])

    def by(self, method: str, tolerance: float) -> np.ndarray:
        """Return what sensors without noise show at the start of each period, (periods, 3)."""
        x, held, told = self._start, np.array([self._closed, self._closed, 0.0, 0.0]), []
        for index, pair in enumerate(self._voltages):
            told.append(self._told(x, held)[0].copy())
            held = np.array([*pair, 0.0, index * self._period])
            x = self._after_period(x, held, method, tolerance)
        return np.array(told)

    def _after_period(self, x: np.ndarray, held: np.ndarray, method: str, tolerance: float) -> np.ndarray:
        def rates(_time, state):
            return self._rates(state, held)[0].copy()

        span = (0.0, self._period)
        told = solve_ivp(rates, span, x, method, span[1:], rtol=tolerance, atol=tolerance * self._small)
        return told.y[:, -1]


def in_python(function: ca.Function) -> Callable[[np.ndarray, np.ndarray], list[np.ndarray]]:
    """Return a function of state and inputs as Python code, called as a compiled one is."""
    evaluated = scripted(function)
    return lambda x, u: [np.array(evaluated(x.tolist(), u.tolist()))]


def errors(measured: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Return the largest errors of angle, rad, and pressures, Pa."""
    off = np.abs(measured - true).max(axis=0)
    return float(off[0]), float(off[1:].max())


def as_accurate(solved: Solved, ours: tuple[float, float], true: np.ndarray):
    """Return SciPy's cheapest method with errors no larger than ours: its name, tolerance, errors.

    Of each method that of `TOLERANCES` which is the widest one that is accurate enough.
    """
    enough = []
    for method in METHODS:
        for tolerance in TOLERANCES:
            before = time.process_time()
            theirs = errors(solved.by(method, tolerance), true)
            if theirs[0] <= ours[0] and theirs[1] <= ours[1]:
                enough.append((time.process_time() - before, method, tolerance, theirs))
                break
    if not enough:
        raise RuntimeError("none of SciPy's methods is as accurate with any of the tolerances")
    return min(enough)[1:]


def _scale(state: str) -> float:
    return next((scale for name, scale in SCALES.items() if name in state), 1.0)
