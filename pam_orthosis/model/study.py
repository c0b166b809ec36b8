# SPDX-License-Identifier: Apache-2.0
"""Parameter studies: the emulated hardware with many sets of parameters, driven by the same voltages.

    study = Study(load({"plant.simulation.step": 1e-3}), ["leg.person.mass", "plant.deviation.conductance"])
    answers = study.simulate(sets, voltages)["angle"]

The equations are those of `Plant`, from the same expressions. Sets are advanced eight at a time, in vector
registers and whole recordings a call, which is some ten times as fast as one `Plant` after the other.
"""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
import numpy.typing as npt

from pam_orthosis.errors import OrthosisError
from pam_orthosis.model import lanes
from pam_orthosis.model.assembly import Assembly, assemble
from pam_orthosis.model.compiled import pointer, taken_out
from pam_orthosis.model.delay import computing_ns, line_ns
from pam_orthosis.model.leg_table import TERMS, LegTable, leg_mechanics, leg_terms
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.mechanisms import Knee
from pam_orthosis.model.parameters import Parameters
from pam_orthosis.model.plant import BISECTIONS, STILL, Array, Plant, external_torque, true_hardware

ORDER, NODES = 20, 30  # of the leg's polynomials
LANES = 8  # sets that are advanced together: one vector of the widest registers there are
MEASURED = ("measured_angle", "measured_extensor_pressure", "measured_flexor_pressure")
# what decides over grid and structure of a study: the same for all of its sets
COMMON = ("scenario.control_period", "scenario.duration", "plant.simulation.step", "plant.voltage_resolution")
DELAY = "plant.delay."
Kernel: TypeAlias = Callable[[Array, Array], Array]  # sets, voltages -> (sets, periods, signals)
LOOP = """
static void rk4(lane* x, const lane* u, const lane* theta, const lane* held, double h) {{
  lane k[{states}], sum[{states}], y[{states}];
  for (int s = 0; s < 4; s++) {{
    call<study_rates>(k, s ? y : x, u, theta, held);
    double ahead = s == 2 ? h : 0.5 * h;
    for (int i = 0; i < {states}; i++) {{
      sum[i] = s == 0 ? k[i] : sum[i] + (s == 3 ? k[i] : 2.0 * k[i]);
      y[i] = x[i] + ahead * k[i];
    }}
  }}
  for (int i = 0; i < {states}; i++) x[i] += h / 6.0 * sum[i];
}}

static const double angles[{nodes}] = {{{angles}}}, weights[{size}][{nodes}] = {{{weights}}};

/* fits the leg's terms at the nodes */
static void tabulate(const lane* keys, lane* table) {{
  lane angle, terms[{terms}];
  for (int i = 0; i < {terms} * {size}; i++) table[i] = 0.0;
  for (int n = 0; n < {nodes}; n++) {{
    angle = angles[n];
    call<study_leg>(terms, keys, &angle);
    for (int t = 0; t < {terms}; t++)
      for (int i = 0; i < {size}; i++) table[{size} * t + i] += weights[i][n] * terms[t];
  }}
}}

/* sets the state at rest; returns the acceleration that is left */
static lane rest(lane* x, const lane* u, const lane* theta, const lane* fixed) {{
  lane start[4], held[{held}], k[{states}];
  call<study_start>(start, theta);
  call<study_held>(held, u, theta, fixed);
  lane mean = start[1], ambient = start[2], supply = start[3];
  lane low = ambient - mean, high = supply - mean, down;
  for (int i = 0; i < {states}; i++) x[i] = 0.0;
  x[0] = start[0];
  x[2] = x[3] = mean;
  k[1] = 0.0;
  for (int n = 0; n < {bisections}; n++) {{
    lane shift = 0.5 * (low + high);
    x[2] = smaller(larger(mean - shift, ambient), supply);
    x[3] = smaller(larger(mean + shift, ambient), supply);
    call<study_rates>(k, x, u, theta, held);
    down = k[1] < 0.0;
    low = where(down, shift) + where(!down, low);
    high = where(down, high) + where(!down, shift);
  }}
  return k[1];
}}

extern "C" void study(
    long periods, long steps, double period, const double* lengths, const long* ages,
    const double* sets, const double* voltages, double* result, double* unrest) {{
  lane x[{states}], u[4], theta[{theta}], fixed[{fixed}], held[{held}], answers[{answers}];
  for (int i = 0; i < {keys}; i++) theta[i] = load(sets + {lanes} * i);
  tabulate(theta, theta + {keys});
  call<study_fixed>(fixed, theta);
  call<study_closed>(u, theta);
  store(unrest, rest(x, u, theta, fixed));
  for (long n = 0; n < periods; n++) {{
    call<study_answers>(answers, x, u, theta);
    for (int i = 0; i < {answers}; i++) store(result + {lanes} * (n * {answers} + i), answers[i]);
    u[3] = n * period;
    call<study_torque>(u + 2, theta, u + 3);
    for (long s = 0; s < steps; s++) {{
      long given = n - ages[s];
      if (given >= 0) {{
        u[0] = voltages[2 * given];
        u[1] = voltages[2 * given + 1];
      }}
      if (s == 0 || ages[s] != ages[s - 1]) call<study_held>(held, u, theta, fixed);
      rk4(x, u, theta, held, lengths[s]);
    }}
  }}
}}
"""


class Study:
    """One structure of the hardware (the effects that are on), with some parameters left open.

    Args:
        parameters: the whole tree; its values hold where a set says nothing.
        keys: the parameters that the sets give: numbers, of any branch that the hardware is made of.
        signals: what is recorded: states of the model and the machine's outputs, free of noise, SI units.

    Raises:
        OrthosisError: a key that is unknown or not a number that sets can differ in.
    """

    def __init__(self, parameters: Parameters, keys: Sequence[str], signals: Sequence[str] = MEASURED):
        self.parameters, self.keys, self.signals = parameters, tuple(keys), tuple(signals)
        for key in self.keys:
            value = parameters.row(key).value
            if key in COMMON or key.startswith(DELAY) or not isinstance(value, float):
                raise OrthosisError(
                    f"{key} cannot differ between the sets of one study: it shapes all of them"
                )
        symbols = ca.SX.sym("keys", max(1, len(self.keys)))
        given = {key: symbols[i] for i, key in enumerate(self.keys)}
        self._table = LegTable(*_stops(parameters, self.keys), ORDER, NODES)
        assembly, self._functions = _functions(
            parameters.substituted(given), symbols, self.signals, self._table
        )
        self.states = assembly.states
        self._kernels: dict[int, Kernel | None] = {}

    def simulate(
        self, sets: npt.ArrayLike, voltages: npt.ArrayLike, workers: int | None = None
    ) -> dict[str, Array]:
        """Return signal -> (sets, periods): sample k is of the instant before the voltages k act.

        Sets whose knee cannot be held at its starting angle are NaN.

        Args:
            sets: (sets, keys), each within the bounds and rules of the parameters.
            voltages: of extensor and flexor valve, (periods, 2), finite, V, each held for a control period.
            workers: threads (as many as there are cores).
        """
        sets, voltages = np.asarray(sets, float), self._quantised(np.asarray(voltages, float))
        width = LANES if len(sets) > 1 else 1
        if width not in self._kernels:
            self._kernels[width] = _kernel(self, width)
        kernel = self._kernels[width]
        if kernel is None:
            return self._one_by_one(sets, voltages)
        groups = [sets[i : i + width] for i in range(0, len(sets), width)]
        if len(groups) < 2:
            parts = [kernel(group, voltages) for group in groups]
        else:
            with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
                parts = list(pool.map(lambda group: kernel(group, voltages), groups))
        table = np.concatenate(parts)
        return {name: np.ascontiguousarray(table[:, :, i]) for i, name in enumerate(self.signals)}

    def _quantised(self, voltages: Array) -> Array:
        """Return what the converter makes of voltages."""
        resolution = self.parameters.plant.voltage_resolution
        quantised = np.round(voltages / resolution) * resolution if resolution > 0 else voltages
        return np.ascontiguousarray(quantised)

    def _one_by_one(self, sets: Array, voltages: Array) -> dict[str, Array]:
        """Without a compiler: one `Plant` after the other."""
        table = np.full((len(sets), len(voltages), len(self.signals)), np.nan)
        for values, rows in zip(sets.tolist(), table, strict=True):
            try:
                plant = Plant(self.parameters.changed(dict(zip(self.keys, values, strict=True))))
            except OrthosisError:  # the values are within their bounds: the knee cannot be held
                continue
            for row, pair in zip(rows, voltages.tolist(), strict=True):
                answers = plant.signals()
                row[:] = [answers[name] for name in self.signals]
                plant.advance(*pair)
        return {name: np.ascontiguousarray(table[:, :, i]) for i, name in enumerate(self.signals)}


def _kernel(study: Study, width: int) -> Kernel | None:
    """Return a study's machine code for as many sets as there are lanes; None if there is no compiler."""
    path = lanes.library("study", _source(study, width))
    if path is None:
        return None
    run: Any = ctypes.CDLL(str(path)).study
    period_ns = round(study.parameters.scenario.control_period * 1e9)
    lengths, ages = _steps(study.parameters, period_ns)

    def kernel(sets: Array, voltages: Array) -> Array:
        full = np.zeros((max(1, len(study.keys)), width))
        full[: sets.shape[1]] = sets[np.minimum(np.arange(width), len(sets) - 1)].T
        result, unrest = np.empty((len(voltages), len(study.signals), width)), np.empty(width)
        run(
            ctypes.c_long(len(voltages)), ctypes.c_long(len(ages)), ctypes.c_double(period_ns * 1e-9),
            *map(pointer, (lengths, ages, full, voltages, result, unrest)),
        )  # fmt: skip
        result[:, :, ~(np.abs(unrest) <= STILL)] = np.nan
        answers: Array = result.transpose(2, 0, 1)[: len(sets)]
        return answers

    return kernel


def _steps(parameters: Parameters, period_ns: int) -> tuple[Array, npt.NDArray[Any]]:
    """Return the lengths of a period's integration steps, s, and how many periods old their voltages are."""
    count, rest = divmod(computing_ns(parameters) + line_ns(parameters), period_ns)
    grid = np.arange(0, period_ns, round(parameters.plant.simulation.step * 1e9))
    starts = np.union1d(grid, [rest])
    ages = count + (starts < rest)
    return np.diff(starts, append=period_ns) / 1e9, ages.astype(ctypes.c_long)


def _stops(parameters: Parameters, keys: Sequence[str]) -> tuple[float, float]:
    """Return the joint's stops, rad; the widest that sets may have where these differ in them."""
    least, most = (parameters.row(key) for key in KNEE.stops)
    joint = parameters.leg.joint
    low = least.bounds[0] if least.key in keys else joint.minimum
    return low, most.bounds[1] if most.key in keys else joint.maximum


def _functions(
    parameters: Parameters, keys: ca.SX, signals: Sequence[str], table: LegTable
) -> tuple[Assembly, tuple[ca.Function, ...]]:
    """Return the assembly and the CasADi functions that the machine code is made of.

    `theta` is what is constant over a run: the values of the keys, then the leg's table.
    """
    coefficients, angle = ca.SX.sym("table", TERMS * (ORDER + 1)), ca.SX.sym("angle")
    theta, hardware = ca.vertcat(keys, coefficients), true_hardware(parameters)
    assembly = assemble(
        replace(hardware, mechanism=Knee(hardware.mechanism.parameters, leg_mechanics(table, coefficients)))
    )
    known = dict(zip(assembly.states, ca.vertsplit(assembly.x), strict=True))
    known |= dict(zip(KNEE.outputs, ca.vertsplit(assembly.outputs), strict=True))
    x, u, time = assembly.x, assembly.u, ca.SX.sym("time")
    rates, held, at_period = taken_out(ca.densify(ca.cse(assembly.rates)), ca.vertcat(u, theta))
    by_period, fixed, at_start = taken_out(at_period, theta)
    answers = ca.cse(ca.vertcat(*(known[name] for name in signals)))
    valve, start = parameters.valve, parameters.scenario.start_angle
    at_rest = (
        start,
        parameters.control.position.mean_pressure,
        valve.ambient_pressure,
        valve.supply_pressure,
    )
    return assembly, (
        ca.Function("study_leg", [keys, angle], [leg_terms(hardware.mechanism.parameters, angle)]),
        ca.Function("study_rates", [x, u, theta, held], [rates]),
        ca.Function("study_held", [u, theta, fixed], [by_period]),
        ca.Function("study_fixed", [theta], [at_start]),
        ca.Function("study_torque", [theta, time], [external_torque(parameters, time)]),
        ca.Function("study_start", [theta], [ca.vertcat(*at_rest)]),
        ca.Function("study_closed", [theta], [ca.vertcat(valve.closed_voltage, valve.closed_voltage, 0, 0)]),
        ca.Function("study_answers", [x, u, theta], [answers]),
    )


def _source(study: Study, width: int) -> str:
    functions = {function.name(): function for function in study._functions}
    fixed, held = (max(1, functions[name].size1_out(0)) for name in ("study_fixed", "study_held"))
    keys, table = max(1, len(study.keys)), study._table
    loop = LOOP.format(
        nodes=NODES, size=ORDER + 1, terms=TERMS, angles=str(table.angles.tolist())[1:-1],
        weights=", ".join(f"{{{str(row)[1:-1]}}}" for row in table.weights()),
        states=len(study.states), keys=keys, theta=keys + TERMS * (ORDER + 1), answers=len(study.signals),
        lanes=width, fixed=fixed, held=held,
        bisections=0 if study.parameters.leg.joint.locked else BISECTIONS,
    )  # fmt: skip
    return lanes.source(study._functions, width) + loop
