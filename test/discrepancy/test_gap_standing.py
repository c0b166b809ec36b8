# SPDX-License-Identifier: Apache-2.0
"""Curves over what is large bend the model: they are fitted again in the model that has them."""

from dataclasses import replace

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer import patch, standing
from pam_orthosis.discrepancy.api import Channel, Input, Model, Parameter, from_arrays
from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.workflow import search
from pam_orthosis.model.parameters import load

PERIOD, SAMPLES, FINER, NOISE = 0.005, 4000, 10, 2e-5  # s, -, steps a period, m
MOTOR, DAMPING, STIFFNESS, DRAG = 2.05, 0.8, 30.0, 1.0
GAP = load().gap


@pytest.fixture(scope="module")
def slide():
    def equations(s, p):
        return {"x": s.v, "v": p.motor * s.current - p.damping * s.v - p.stiffness * s.x}

    return Model(
        "slide",
        channels=[Channel("x", "x", "m", "mm", 1e3)],
        inputs=[Input("current", "A")],
        states=["x", "v"],
        equations=equations,
        parameters=[
            Parameter("motor", 2.0, "m/s^2/A", 0.1, "acceleration per current"),
            Parameter("damping", DAMPING, "1/s", 0.1, "viscous friction"),
            Parameter("stiffness", STIFFNESS, "1/s^2", 0.05, "spring"),
        ],
        effects=[],
    ).system()


def _recording(slide, seed):
    """Return a recording of a slide that the air holds back by the square of its velocity."""
    random, time = np.random.default_rng(seed), PERIOD * np.arange(SAMPLES)
    waves = [(random.uniform(0.5, 1.5), random.uniform(0.1, 2.0), random.uniform(0, 6)) for _ in range(6)]
    current = sum(size * np.sin(2 * np.pi * rate * time + phase) for size, rate, phase in waves)
    state, x, step = np.zeros(2), np.zeros(SAMPLES), PERIOD / FINER
    for i, driven in enumerate(MOTOR * current):
        x[i] = state[0]
        for _ in range(FINER):
            k1 = _rates(state, driven)
            k2 = _rates(state + step / 2 * k1, driven)
            k3 = _rates(state + step / 2 * k2, driven)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + _rates(state + step * k3, driven))
    columns = {"time": time, "x": x + NOISE * random.standard_normal(SAMPLES), "current": current}
    return from_arrays(f"of {seed}", slide, columns)


def _rates(state, driven):
    x, v = state
    return np.array([v, driven - DAMPING * v - STIFFNESS * x - DRAG * v * abs(v)])


def _left(system, recording):
    """Return how many times the noise a recalibrated model leaves of a recording."""
    start = begin(system, [recording], [], GAP)
    return measure.gap(start.held_out, start.null).white[measure.OVERALL]


def test_curves_are_fitted_again_in_the_model_that_they_bend(slide, monkeypatch):
    """A quadratic drag of hundreds of times the noise: the first curve leaves a quarter of it."""
    start = begin(slide, [_recording(slide, 1)], [_recording(slide, 2)], GAP)
    again = search(start, GAP)
    monkeypatch.setattr(standing, "ROUNDS", 0)
    once = search(start, GAP)
    assert once.verdict == again.verdict == "described"
    ((curve,), (first,)) = (one.unknown.descriptions for one in (again, once))
    assert (curve.channel, curve.coordinate) == (first.channel, first.coordinate) == ("x", "v")
    assert curve.reduced > 0.995 > first.reduced
    third = _recording(slide, 3)
    left = [_left(slide.changed(patch.changes_of(one)), third) for one in (again, once)]
    assert left[0] < 0.6 * left[1]
    assert left[0] < 0.1 * _left(slide, third)
    drag = DRAG * curve.places * np.abs(curve.places)
    line = np.polynomial.Polynomial.fit(curve.places, curve.values + drag, 1)  # recalibration may have that
    error = curve.values + drag - line(curve.places)
    assert np.std(error[2:-2]) < 0.03 * np.std(drag)


def test_a_curve_that_is_wrong_is_mended_or_does_not_stand(slide, monkeypatch):
    start = begin(slide, [_recording(slide, 1)], [_recording(slide, 2)], GAP)
    outcome = search(start, GAP)
    (curve,) = outcome.unknown.descriptions
    turned = replace(curve, values=-curve.values, shape=-curve.shape)
    worse = replace(outcome, unknown=replace(outcome.unknown, descriptions=[turned]))
    assert standing.standing(start, worse).unknown.reduced > 0.9
    monkeypatch.setattr(standing, "ROUNDS", 0)
    assert standing.standing(start, worse) is None, "it would leave more than nothing does"
