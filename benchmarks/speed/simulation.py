# SPDX-License-Identifier: Apache-2.0
"""The simulation core: simulated seconds in a second of processor time, every effect of the catalogue on.

Beside it: SciPy's `solve_ivp` on the same equations, compiled or in Python, with the method and tolerance
that are cheapest among those as accurate as our fixed step, and MuJoCo with one hinge and two muscles. It is
processor time, which others on the machine disturb less than the time on the wall.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Generator, Iterator
from functools import partial

import numpy as np

from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import Parameters, load
from pam_orthosis.model.plant import Plant
from pam_orthosis.model.study import MEASURED, Study
from speed.hinge import Hinge
from speed.rows import Goal, Row, alternating, row
from speed.solved import TIGHT, Solved, as_accurate, errors, in_python

STEP = 1e-3  # s; the plant's default is ten times finer
SECONDS = 2.0  # of simulated time in one measurement
SETS, BATCH_SECONDS = 1000, 1.0
RATE = "simulated s / (core s)"
REAL_TIME = Goal(">= 500 x real time", at_least=500.0)
SCIPY = Goal(">= 100 x SciPy", at_least=100.0)
MUJOCO = Goal("not slower than MuJoCo", at_least=1.0)
VARIED = {
    "leg.person.mass": (50.0, 100.0),
    "plant.deviation.conductance": (0.8, 1.2),
    "plant.deviation.extensor_force": (0.9, 1.1),
    "plant.deviation.flexor_force": (0.9, 1.1),
    "plant.effects.joint_friction.coulomb": (0.0, 2.0),
    "plant.effects.muscle_hysteresis.half_width": (0.0, 30.0),
    "plant.effects.valve_dead_band.half_width": (0.0, 0.2),
    "plant.effects.creep.stiffness": (0.0, 2000.0),
}
# delays shift what goes in and out; the peers integrate the equations alone
AT_ONCE = {f"plant.delay.{part}": 0.0 for part in ("computing", "converter", "valve", "hose_length")}
ALONE = np.empty((1, 0))  # one set of no parameters


def rows(repeats: int) -> Iterator[Row]:
    """Yield the rows of the group."""
    on = {f"plant.effects.{name}.enabled": not name.endswith("_delay") for name in KNEE.catalogue}
    parameters = load({**on, **AT_ONCE, "leg.person.present": True, "plant.simulation.step": STEP})
    scipy = yield from _one_plant(parameters, repeats)
    yield from _batch(parameters, scipy, repeats)


def driving(parameters: Parameters, seconds: float) -> np.ndarray:
    """Return voltages that move the knee through half of its range, on the converter's grid, (periods, 2)."""
    period, grid = parameters.scenario.control_period, parameters.plant.voltage_resolution
    at = np.arange(round(seconds / period)) * period
    voltages = 5 + 0.9 * np.column_stack([np.sin(np.pi * at), np.sin(np.pi * at + 2.2)])
    return np.round(voltages / grid) * grid


def random_sets(count: int, seed: int = 1) -> np.ndarray:
    """Return parameter sets within the bounds of `VARIED`, (count, parameters)."""
    low, high = np.array(list(VARIED.values())).T
    return np.random.default_rng(seed).uniform(low, high, (count, len(VARIED)))


def _one_plant(parameters: Parameters, repeats: int) -> Generator[Row, None, tuple[str, float]]:
    """Yield rows; return SciPy's method and tolerance."""
    study, plant, voltages = Study(parameters, ()), Plant(parameters), driving(parameters, SECONDS)
    solved = Solved(parameters, voltages)
    told, true = study.simulate(ALONE, voltages), solved.by(*TIGHT)
    error = errors(np.column_stack([told[name][0] for name in MEASURED]), true)
    method, tolerance, theirs = as_accurate(solved, error, true)
    add = partial(row, "simulation")
    yield add(
        f"largest error of the angle, SciPy {method} rtol {tolerance:g}", "rad", [error[0]], [theirs[0]]
    )
    yield add("largest error of the pressures, the same", "Pa", [error[1]], [theirs[1]])
    script = Solved(parameters, voltages, in_python)
    ours, scipy, by_script, euler, fourth, periods = alternating(
        repeats,
        partial(_rate, partial(study.simulate, ALONE, voltages, 1), SECONDS),
        partial(_rate, partial(solved.by, method, tolerance), SECONDS),
        partial(_rate, partial(script.by, method, tolerance), SECONDS),
        partial(_rate, Hinge("Euler", STEP, SECONDS), SECONDS),
        partial(_rate, Hinge("RK4", STEP, SECONDS), SECONDS),
        partial(_rate, lambda: [plant.advance(*pair) for pair in voltages.tolist()], SECONDS),
    )
    yield add("one plant, beside SciPy with no larger errors", RATE, ours, scipy, SCIPY)
    yield add("one plant, beside the same with its equations in Python", RATE, ours, by_script, SCIPY)
    yield add("one plant, beside MuJoCo's RK4 at the same step", RATE, ours, fourth, MUJOCO)
    yield add("one plant, beside MuJoCo's Euler at the same step", RATE, ours, euler, MUJOCO)
    yield add("one plant, all periods in one call", RATE, ours, goal=REAL_TIME)
    yield add("one plant, a call a period, as its node does", RATE, periods, goal=REAL_TIME)
    return method, tolerance


def _batch(parameters: Parameters, scipy: tuple[str, float], repeats: int) -> Iterator[Row]:
    study, sets = Study(parameters, tuple(VARIED)), random_sets(SETS)
    voltages, cores = driving(parameters, BATCH_SECONDS), os.cpu_count() or 1
    study.simulate(sets[:2], voltages[:2])  # compiled
    simulated = SETS * BATCH_SECONDS
    solved, (method, tolerance) = Solved(parameters, voltages), scipy
    ours, theirs, by_scipy, wall = alternating(
        repeats,
        partial(_rate, partial(study.simulate, sets, voltages), simulated),
        partial(_rate, partial(Hinge("Euler", STEP, BATCH_SECONDS).many, SETS, cores), simulated),
        partial(_rate, partial(solved.by, method, tolerance), BATCH_SECONDS),
        partial(_rate, partial(study.simulate, sets, voltages), simulated, time.monotonic),
    )
    what, add = f"{SETS:,} random sets of {len(VARIED)} parameters", partial(row, "simulation")
    yield add(f"{what}, beside SciPy with one", RATE, ours, by_scipy, SCIPY)
    yield add(f"{what}, beside MuJoCo's rollout (Euler)", RATE, ours, theirs, MUJOCO)
    yield add(what, RATE, ours, goal=REAL_TIME)
    yield add(f"{what}, {cores} cores, by the clock on the wall", "simulated s / s", wall)


def _rate(
    work: Callable[[], object], simulated: float, clock: Callable[[], float] = time.process_time
) -> float:
    """Return simulated seconds per second of a clock."""
    before = clock()
    work()
    return simulated / (clock() - before)
