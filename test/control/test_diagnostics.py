# SPDX-License-Identifier: Apache-2.0
"""Diagnostic experiments: smooth experiments, co-contraction, closed valves, a locked joint."""

import numpy as np
import pytest

from pam_orthosis.control.diagnostic import EXPERIMENTS, make_experiment, move, multisine
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.control.position import PositionController
from pam_orthosis.control.pressure import PressureController
from pam_orthosis.control.reference import Reference, Valve, as_number
from pam_orthosis.control.trajectory import make_trajectory
from pam_orthosis.model.parameters import load, scenario_names, scenario_overrides

SCENARIOS = [name for name in scenario_names() if name.startswith("diagnostic")]
MS = 1_000_000


def sampled(experiment, step_ms=2):
    """Return the references at every step: (n, 3) angle and derivatives, (n,) mean pressure."""
    times = np.arange(0, round(experiment.duration * 1e3), step_ms)
    references = [experiment.sample(int(t) * MS) for t in times]
    pressures = np.array([as_number(r.mean_pressure) for r in references])
    return np.array([r[:3] for r in references]), pressures


def run(scenario, seconds, **overrides):
    p = load({**scenario_overrides(scenario), **overrides})
    return ClosedLoop(p, 3).run(round(seconds / p.scenario.control_period)), p


def test_there_is_a_scenario_for_every_experiment():
    assert {scenario_overrides(name)["scenario.trajectory"] for name in SCENARIOS} == set(EXPERIMENTS)


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_the_run_lasts_as_long_as_the_experiment(scenario):
    p = load(scenario_overrides(scenario))
    assert make_trajectory(p).duration == pytest.approx(p.scenario.duration, abs=0.5)


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_angle_velocity_and_acceleration_belong_together(name):
    motion, mean = sampled(make_experiment(name, load(scenario_overrides("diagnostic"))))
    step = 2e-3
    for order in (0, 1):
        slope = (motion[2:, order] - motion[:-2, order]) / (2 * step)
        assert (
            np.abs(slope - motion[1:-1, order + 1]).max() < 0.02 * np.abs(motion[:, order + 1]).max() + 1e-9
        )
    assert np.abs(np.diff(motion[:, 2])).max() <= 0.2 * np.abs(motion[:, 2]).max() + 1e-9
    open_ = mean != Valve.CLOSED.value
    assert np.abs(np.diff(mean)[open_[1:] & open_[:-1]]).max() < 2.0e4


def test_the_protocol_uses_two_mean_pressures_and_closed_valves():
    p = load(scenario_overrides("diagnostic"))
    motion, mean = sampled(make_trajectory(p))
    d = p.scenario.diagnostic
    for level in (d.low_mean, d.high_mean):
        assert np.isclose(mean, level).mean() > 0.05
    assert 0.1 < (mean == Valve.CLOSED.value).mean() < 0.3
    assert motion[:, 0].min() >= 0.25
    assert motion[:, 0].max() <= 1.1


def test_trajectories_leave_the_mean_pressure_to_the_controller():
    assert make_trajectory(load()).sample(3 * 10**9).mean_pressure is None


def test_the_asked_mean_pressure_is_held():
    """Co-contraction at a held angle: the mean of both references is the asked one but near slackness."""
    recorded, p = run("diagnostic-cocontraction", 8.0)
    experiment = make_trajectory(p)
    asked = np.array([experiment.sample(round(t * 1e9)).mean_pressure for t in recorded["time"]])
    got = 0.5 * (recorded["extensor_pressure_reference"] + recorded["flexor_pressure_reference"])
    assert (np.abs(got - asked) < 1.0).mean() > 0.95
    measured = 0.5 * (recorded["extensor_pressure"] + recorded["flexor_pressure"])
    assert np.median(np.abs(measured - asked)[500:]) < 0.03e5
    assert np.ptp(asked) > 1.5e5
    assert np.rad2deg(np.abs(recorded["angle"] - recorded["reference_angle"]).max()) < 1.0


def test_closed_valves_are_closed_and_the_knee_swings():
    recorded, p = run("diagnostic-decay", 3.5)
    closed = recorded["extensor_pressure_reference"] == Valve.CLOSED.value
    assert 0.2 < closed.mean() < 0.6
    for muscle in ("extensor", "flexor"):
        assert (recorded[f"{muscle}_voltage"][closed] == p.valve.closed_voltage).all()
        assert (recorded[f"{muscle}_mass_flow"][closed] == 0).all()
    first = np.flatnonzero(closed)[:400]
    assert np.ptp(recorded["true_angle"][first]) > np.deg2rad(5)
    crossings = np.diff(np.sign(recorded["true_velocity"][first]))
    assert np.count_nonzero(crossings) >= 2


def test_closed_valves_hold_the_air():
    """A leak shows as a falling pressure while the valves are closed, and only with the leak."""
    tight, _ = run("diagnostic-hold", 3.0)
    leaky, _ = run(
        "diagnostic-hold", 3.0,
        **{"plant.effects.extensor_leak.enabled": True, "plant.effects.extensor_leak.coefficient": 5e-10},
    )  # fmt: skip
    closed = np.flatnonzero(tight["extensor_pressure_reference"] == Valve.CLOSED.value)
    middle, end = closed[len(closed) // 3], closed[-1]
    falls = [r["extensor_pressure"][middle] - r["extensor_pressure"][end] for r in (tight, leaky)]
    assert abs(falls[0]) < 3e3
    assert falls[1] > falls[0] + 5e3


def test_a_locked_joint_does_not_move_and_its_pressures_step():
    recorded, _ = run("diagnostic-locked", 4.0)
    assert np.ptp(recorded["true_angle"]) == 0.0
    assert np.ptp(recorded["extensor_pressure"]) > 1.4e5
    wanted = recorded["extensor_pressure_reference"]
    assert np.ptp(wanted) > 1.4e5
    settled = (np.abs(wanted - np.roll(wanted, 250)) < 1e3) & (recorded["time"] > 1.0)
    assert np.abs(recorded["extensor_pressure"] - wanted)[settled].max() < 0.1e5


def test_the_pressure_controller_restarts_gently_after_closed_valves():
    controller = PressureController(load(), "extensor")
    controller.step(3.0e5, 3.0e5, 0.6, 0.0)
    assert controller.step(3.0e5, Valve.CLOSED, 0.6, 0.0) == 0.0
    assert abs(controller.step(3.0e5, 3.0e5, 0.6, 0.0)) < 1e-9


def test_without_a_mean_pressure_the_controllers_own_is_taken():
    p = load()
    explicit = Reference(0.6, 0.0, 0.0, p.control.position.mean_pressure)
    own, asked = PositionController(p), PositionController(p)
    measured = (0.6, (3.9e5, 3.3e5))
    assert own.step(*measured, Reference(*explicit[:3])) == asked.step(*measured, explicit)


def test_moves_start_and_stop_where_they_should():
    path = move(0.2, 1.0, 2.0, 0.3)
    assert path(0.0) == (0.2, 0.0, 0.0)
    assert path(2.0) == (1.0, 0.0, 0.0)
    assert path(1.0)[0] == pytest.approx(0.6)
    assert path(1.0)[1] == pytest.approx(0.8 / 1.7)


def test_a_multisine_starts_and_ends_at_rest():
    path = multisine(0.6, 0.05, 9.0)
    assert path(0.0) == pytest.approx((0.6, 0.0, 0.0), abs=1e-9)
    assert path(9.0) == pytest.approx((0.6, 0.0, 0.0), abs=1e-9)
    assert max(abs(path(t)[0] - 0.6) for t in np.linspace(1, 8, 500)) > 0.08
