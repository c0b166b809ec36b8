# SPDX-License-Identifier: Apache-2.0
"""A system of one's own: sensors that lag, inputs that are declared wrongly, ratios of parameters."""

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer.last_line import last_line
from pam_orthosis.discrepancy.api import Channel, Input, Model, Parameter, check_system, find_gap, from_arrays

PERIOD, SUBSTEPS, COUNT = 0.02, 10, 1500
DECAY, TAU = 0.5, 0.3  # 1/s, s
NOMINAL = {"gain": 2.0, "mass": 1.5, "drag": 3.0, "spring": 6.0}
TOLERANCES = {"gain": 0.02, "mass": 0.045, "drag": 0.09, "spring": 0.34}


def vessel(held=True):
    """Return a vessel whose temperature follows a heater."""
    return Model(
        name="vessel",
        channels=[Channel("temperature", "temperature", "K", "K", 1.0)],
        inputs=[Input("power", "K/s", held=held)],
        states=["temperature"],
        equations=lambda s, p: {"temperature": p.gain * s.power - DECAY * s.temperature},
        parameters=[Parameter("gain", 1.0, "1", 0.02, "of the heater")],
    ).system()


def heated(system, seed, lag=0.0):
    """Return a recording; `lag` of the sensor, s."""
    rng, count = np.random.default_rng(seed), COUNT * SUBSTEPS
    step = PERIOD / SUBSTEPS
    held = np.repeat(rng.choice([0.0, 0.5, 1.0], COUNT // 20), 20 * SUBSTEPS)
    state, shown = np.zeros(count), np.zeros(count)
    for k in range(1, count):
        state[k] = state[k - 1] + step * (held[k - 1] - DECAY * state[k - 1])
        shown[k] = shown[k - 1] + (state[k] - shown[k - 1]) * (1 - np.exp(-step / lag) if lag else 1.0)
    rows = slice(None, None, SUBSTEPS)
    noisy = shown[rows] + 1e-3 * rng.standard_normal(COUNT)
    time = np.arange(COUNT) * PERIOD
    return from_arrays(str(seed), system, {"time": time, "temperature": noisy, "power": held[rows]})


def searched(system, **how):
    check_system(system)
    return find_gap(system, [heated(system, 1, **how)], [heated(system, 2, **how)])


def test_a_sensor_that_lags_is_named_with_its_time_constant():
    outcome = searched(vessel(), lag=TAU)
    (one,) = outcome.effects
    assert (outcome.verdict, one.name) == ("explained", "temperature_lag")
    assert one.parameters["time"][0] == pytest.approx(TAU, rel=0.02)
    assert "temperature_lag: one channel does not tell" in " ".join(outcome.remarks)


def test_delays_that_make_up_for_a_wrongly_declared_input_explain_nothing():
    outcome = searched(vessel(held=False))
    assert outcome.effects
    assert outcome.verdict == "partial"
    assert "power fits better held until the next row: held=True of its Input; " in last_line(outcome)


def slide():
    """Return a mass on a spring of which position alone is measured: it shows ratios of its parameters."""

    def equations(s, p):
        s.force = p.gain * s.current - p.drag * s.velocity - p.spring * s.position
        return {"position": s.velocity, "velocity": s.force / p.mass}

    return Model(
        name="slide",
        channels=[Channel("position", "position", "m", "mm", 1e3)],
        inputs=[Input("current", "A")],
        states=["position", "velocity"],
        equations=equations,
        parameters=[Parameter(name, NOMINAL[name], "1", TOLERANCES[name], name) for name in NOMINAL],
    ).system()


def slid(system, seed, **wrong):
    rng, step = np.random.default_rng(seed), PERIOD / SUBSTEPS
    p = {**NOMINAL, **wrong}
    current = np.repeat(rng.normal(0.0, 1.0, COUNT // 10), 10)
    x = v = 0.0
    position = np.zeros(COUNT)
    for k in range(COUNT):
        position[k] = x
        for _ in range(SUBSTEPS):
            before = v
            v += step * (p["gain"] * current[k] - p["drag"] * v - p["spring"] * x) / p["mass"]
            x += step * (before + v) / 2
    position += 1e-5 * rng.standard_normal(COUNT)
    arrays = {"time": np.arange(COUNT) * PERIOD, "position": position, "current": current}
    return from_arrays(str(seed), system, arrays)


@pytest.mark.parametrize(
    ("wrong", "verdict", "words"),
    [
        ({"mass": 2.0}, "recalibrated", "the size of mass holds if gain, drag, spring are as the model has"),
        ({"gain": 2.6, "drag": 3.9}, "partial", "and spring would be outside of tolerance; "),
    ],
)
def test_of_parameters_that_show_in_ratios_alone_none_is_surely_wrong(wrong, verdict, words):
    system = slide()
    outcome = find_gap(system, [slid(system, 1, **wrong)], [slid(system, 2, **wrong)])
    assert outcome.verdict == verdict
    assert words in "\n".join([*outcome.remarks, last_line(outcome)])
