# SPDX-License-Identifier: Apache-2.0
"""The cascade on hardware with a delay: bounds of tracking, calm and margin; what the predictor is for."""

import math

import numpy as np
import pytest

from pam_orthosis.control.effects import command_lag
from pam_orthosis.control.loop import ClosedLoop
from pam_orthosis.model.parameters import load, scenario_overrides

SECONDS = 7.0
SENSOR = load().plant.effects.extensor_pressure_delay.delay
FRICTION = {"plant.effects.joint_friction.coulomb": 2.4, "plant.effects.viscous_friction.viscosity": 0.3}
HYSTERESIS = {"plant.effects.muscle_hysteresis.half_width": 36.0}
LAG = "plant.effects.valve_lag.natural_frequency"
SUPPLY = {"plant.deviation.supply_pressure": 6.0 / 7.0}
ENCODER = {"plant.sensor.angle_resolution": math.radians(0.1)}


def lasting(seconds):
    """Return the overrides that give the hardware this delay in all."""
    parts = dict.fromkeys((f"plant.delay.{part}" for part in ("computing", "converter", "hose_length")), 0.0)
    return {**parts, "plant.delay.valve": seconds - SENSOR}


def walk(scenario="default", seed=1, **overrides):
    p = load({**scenario_overrides(scenario), **overrides})
    return ClosedLoop(p, seed).run(round(SECONDS / p.scenario.control_period))


def largest(run):
    return np.degrees(np.abs(run["reference_angle"] - run["angle"])).max()


def test_the_knee_follows_calmly_on_the_shipped_hardware():
    run = walk()
    error = np.degrees(run["reference_angle"] - run["angle"])
    rest = (run["time"] > 0.5) & (run["time"] < 1.0)
    assert np.abs(error).max() <= 0.9
    assert np.sqrt(np.mean(error**2)) <= 0.3
    assert np.abs(error[rest]).mean() <= 0.3
    for muscle in ("extensor", "flexor"):
        assert np.abs(np.diff(run[f"{muscle}_voltage"])).sum() / SECONDS <= 75.0


def test_it_follows_with_a_person():
    assert largest(walk("person")) <= 0.8


PERTURBED = {
    "5 ms more": lasting(load().valve.delay + 5e-3),
    "5 ms less": lasting(load().valve.delay - 5e-3),
    "30 Hz": {LAG: 30.0},
    "friction": FRICTION,
    "hysteresis": HYSTERESIS,
    "6 bar": SUPPLY,
    "encoder": ENCODER,
    "100 Hz": {"scenario.control_period": 0.01},
    "together": {**FRICTION, **HYSTERESIS, LAG: 50.0, **SUPPLY, **ENCODER},
}


@pytest.mark.parametrize("scenario", ["default", "person"])
@pytest.mark.parametrize("name", PERTURBED)
def test_it_has_margins(scenario, name):
    assert largest(walk(scenario, **PERTURBED[name])) <= 3.0


def test_without_its_predictor_the_same_cascade_follows_far_worse():
    assert largest(walk(**{"valve.delay": 0.0})) > 2.0


def test_the_predictor_takes_all_that_is_known_of_the_delay():
    nominal = load()
    assert command_lag(nominal.nominal()) == pytest.approx(nominal.valve.delay)
    learned = {"effects.valve_delay.enabled": True, "effects.valve_delay.delay": -2e-3}
    spool = {"effects.valve_lag.enabled": True}
    assert command_lag(load(learned).nominal()) == pytest.approx(nominal.valve.delay - 2e-3)
    lag = 2 * 0.8 / (2 * math.pi * 100.0)
    assert command_lag(load({**learned, **spool}).nominal()) == pytest.approx(
        nominal.valve.delay - 2e-3 + lag
    )
    early = {**learned, "effects.valve_delay.delay": -0.05}
    assert command_lag(load(early).nominal()) == 0.0
