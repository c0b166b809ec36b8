# SPDX-License-Identifier: Apache-2.0
"""The paper's results again: what is measured is measured right, and the committed figures are these."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from pam_orthosis.report.paper import observer, tracking

ROOT = Path(__file__).resolve().parents[2]
ROWS = json.loads((ROOT / "benchmarks" / "results" / "paper.json").read_text(encoding="utf-8"))["rows"]


@pytest.fixture(scope="module")
def simulated():
    return observer.observe()


@pytest.fixture(scope="module")
def on_hardware():
    return observer.observe(exact=False)


@pytest.fixture(scope="module")
def walked():
    return tracking.track()


def shown(result, unit):
    """Return the first number with a unit of a committed result."""
    (row,) = (row for row in ROWS if row["result"] == result)
    return float(re.search(rf"([\d.]+) {unit}", row["here"])[1])


def test_lag_and_gain_are_found_beside_noise_and_another_frequency():
    time = np.arange(0, 10, 0.005)
    noise = 0.2 * np.random.default_rng(3).standard_normal(len(time))
    other = 1.5 * np.sin(2 * np.pi * 0.5 * time + 0.3)
    true = 2 * np.sin(2 * np.pi * 0.8 * time) + other
    late = 1.8 * np.sin(2 * np.pi * 0.8 * (time - 0.018)) + other + noise
    lag, gain = observer.lag_and_gain(time, true, time, late, (0.8, 0.5))
    assert lag == pytest.approx(0.018, abs=0.001)
    assert gain == pytest.approx(0.9, abs=0.01)


def test_the_disturbance_is_estimated_within_20_ms(simulated, on_hardware):
    settings = simulated.parameters.control.observer
    sensor = on_hardware.parameters.plant.effects.extensor_pressure_delay.delay  # pressures come late there
    for run, late in ((simulated, 0.0), (on_hardware, sensor)):
        assert run.lag <= 0.020
        assert run.lag == pytest.approx((1 + 2 * settings.damping) / settings.pole + late, abs=0.001)
        assert run.gain == pytest.approx(1.0, abs=0.02)


def test_the_pattern_of_the_poles_saves_lag_at_the_same_noise(simulated):
    equal = observer.observe({observer.DAMPING: 1.0})
    assert equal.lag > 1.4 * simulated.lag
    assert simulated.velocity_noise == pytest.approx(equal.velocity_noise, rel=0.15)


def test_what_the_equation_of_motion_lacks_is_the_torque_where_nothing_else_disturbs():
    """The measure of the emulated hardware's disturbance, tried where the answer is known."""
    found = observer.observe(observer.without_hardware_effects(), exact=False)
    middle = found.signals["time"] - found.parameters.scenario.control_period / 2
    frequencies = found.parameters.plant.external_frequency, 1 / found.parameters.scenario.cycle_time
    known = -found.signals["true_torque"]
    settled = middle > observer.SETTLING
    late = found.disturbance_time[settled], found.disturbance[settled]
    lag, gain = observer.lag_and_gain(middle[settled], known[settled], *late, frequencies)
    assert abs(lag) < 0.0005
    assert gain == pytest.approx(1.0, abs=0.01)


def test_the_committed_figures_are_those_that_are_measured(simulated, on_hardware, walked):
    near = {"rel": 0.1}
    assert shown("lag of the estimated disturbance", "ms") == pytest.approx(simulated.lag * 1e3, **near)
    assert shown("the same on the emulated hardware", "ms") == pytest.approx(on_hardware.lag * 1e3, **near)
    noise = np.degrees(simulated.velocity_noise)
    assert shown("noise of the estimated velocity", "deg/s") == pytest.approx(noise, **near)
    assert shown("maximum tracking error", "deg") == pytest.approx(walked.largest, **near)
    assert shown("steady-state error", "deg") == pytest.approx(walked.steady_state, **near)
    assert shown("force model, DMSP-20", "N maximum") <= 30.0
    assert walked.largest <= 3.0
    assert walked.steady_state < 1.0
