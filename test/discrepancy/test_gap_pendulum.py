# SPDX-License-Identifier: Apache-2.0
"""A light pendulum, its encoder far better than the start of a replay: an exact model leaves noise alone."""

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.discrepancy.api import (
    Channel,
    Effect,
    Input,
    Model,
    Parameter,
    Quantity,
    find_gap,
    from_arrays,
)
from pam_orthosis.discrepancy.recordings.stamps import skews
from pam_orthosis.discrepancy.replay.problem import Scored, sum_of_squares
from pam_orthosis.discrepancy.replay.whitening import Whitener
from pam_orthosis.model.parameters import load

INERTIA, WEIGHT, MOTOR, DAMPING = 0.0512, 1.22, 0.795, 0.052  # kg m^2, N m, N m/A, N m s/rad
PERIOD, SECONDS, NOISE = 4e-3, 12.0, 2e-4  # s, s, rad


def pendulum():
    def equations(s, p):
        s.torque = p.motor * s.current - p.weight * ca.sin(s.angle) - p.damping * s.velocity
        return {"angle": s.velocity, "velocity": s.torque / p.inertia}

    spring = Effect(
        name="spring",
        stage="torque",
        parameters=(Quantity("stiffness", 0.1, "N m/rad", 0.0, 5.0, "stiffness of a cable", 0.0),),
        expression=lambda s, p, _own: -p.stiffness * s.angle,
        physics="A cable pulls.",
        source="assumption",
    )
    return Model(
        name="pendulum",
        channels=[Channel("angle", "angle", "rad", "deg", 57.29578)],
        inputs=[Input("current", "A")],
        states=["angle", "velocity"],
        equations=equations,
        parameters=[
            Parameter("inertia", INERTIA, "kg m^2", 0.0025, "inertia"),
            Parameter("weight", WEIGHT, "N m", 0.06, "weight"),
            Parameter("motor", MOTOR, "N m/A", 0.02, "torque per current"),
            Parameter("damping", DAMPING, "N m s/rad", 0.01, "viscous friction"),
        ],
        effects=[spring],
    ).system()


def moved(x: np.ndarray, current: float, step: float) -> np.ndarray:
    """Return the state a step later (Runge and Kutta)."""

    def rates(y):
        torque = MOTOR * current - WEIGHT * np.sin(y[0]) - DAMPING * y[1]
        return np.array([y[1], torque / INERTIA])

    a = rates(x)
    b = rates(x + step / 2 * a)
    c = rates(x + step / 2 * b)
    d = rates(x + step * c)
    return x + step / 6 * (a + 2 * b + 2 * c + d)


def driven(seed: int, period: float, late: int) -> dict[str, np.ndarray]:
    """Return a recording of a pendulum whose current leaps, its encoder so many samples late."""
    rng, substeps = np.random.default_rng(seed), 4
    currents = np.repeat(rng.uniform(-1.0, 1.0, 100), 15)
    x, angles = np.zeros(2), np.zeros(len(currents))
    for n, current in enumerate(currents[:-1]):
        for _ in range(substeps):
            x = moved(x, current, period / substeps)
        angles[n + 1] = x[0]
    angles = np.concatenate([np.zeros(late), angles])[: len(currents)]
    angles += NOISE * rng.standard_normal(len(currents))
    return {"time": np.arange(len(currents)) * period, "angle": angles, "current": currents}


def recorded(seed: int) -> dict[str, np.ndarray]:
    """Return a recording of a controlled pendulum that begins far from what it follows."""
    rng = np.random.default_rng(seed)
    phases, substeps = rng.uniform(0, 6, 2), 4
    step, x = PERIOD / substeps, np.array([0.1, 0.0])
    time = np.arange(round(SECONDS / PERIOD)) * PERIOD
    angles, currents = np.empty(len(time)), np.empty(len(time))

    for n, t in enumerate(time):
        wanted = 0.6 * np.sin(2.5 * t + phases[0]) + 0.3 * np.sin(6.9 * t + phases[1])
        angles[n] = x[0] + NOISE * rng.standard_normal()
        currents[n] = 3.0 * (wanted - angles[n]) - 0.25 * x[1]
        for _ in range(substeps):
            x = moved(x, currents[n], step)
    return {"time": time, "angle": angles, "current": currents}


def test_an_exact_model_of_a_light_pendulum_leaves_noise_alone():
    system = pendulum()
    first, second, third = (from_arrays(str(seed), system, recorded(seed)) for seed in (21, 22, 23))
    found = find_gap(system, [first, second], [third], load().gap)
    assert found.verdict == "none"
    assert found.configured.white["angle"] < 1.15 * found.floor.white["angle"]


@pytest.mark.parametrize("late", [0, 2])
def test_that_an_input_is_held_is_no_skew(late):
    system, period = pendulum(), 0.01
    found = skews(system, from_arrays("x", system, driven(7, period, late)))
    assert [one.seconds for one in found] == pytest.approx([-late * period] * bool(late), abs=5e-4)


def test_what_a_replay_has_wrong_at_its_start_is_not_remembered_by_the_whitener():
    scored = Scored(None, Whitener({"angle": 0.99 ** np.arange(900.0)}), 400)
    rows = np.random.default_rng(1).standard_normal((2000, 3))
    wrong = rows.copy()
    wrong[:200] += 1e3
    assert np.array_equal(scored.white("angle", wrong), scored.white("angle", rows))
    assert np.array_equal(scored.white("angle", rows[:, 0]), scored.white("angle", rows)[:, 0])
    late = scored.white("angle", rows)[-500:]
    assert late == pytest.approx(scored.whiten("angle", rows)[-500:], abs=1e-2)


@pytest.mark.filterwarnings("error")
def test_a_replay_that_goes_astray_is_no_warning_but_no_fit():
    scored = Scored(None, Whitener({"angle": np.ones(1)}), 400)
    assert sum_of_squares({"torque": scored.white("angle", np.full(900, np.inf))}) == np.inf
