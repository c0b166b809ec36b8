# SPDX-License-Identifier: Apache-2.0
"""Curves over what is large bend the model: they are fitted again in the model that has them."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.discrepancy.answer import patch, standing
from pam_orthosis.discrepancy.api import (
    Channel,
    Effect,
    Input,
    Model,
    Parameter,
    Quantity,
    describe,
    from_arrays,
)
from pam_orthosis.discrepancy.fitting import measure
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.unknown import description
from pam_orthosis.discrepancy.workflow import search
from pam_orthosis.model.parameters import load

PERIOD, SAMPLES, FINER, NOISE = 0.005, 4000, 10, 2e-5  # s, -, steps a period, m
MOTOR, DAMPING, STIFFNESS, DRAG = 2.05, 0.8, 30.0, 1.0
SMOOTH = 0.01  # m/s, over which dry friction turns
GAP = load().gap


def _model(*effects):
    def equations(s, p):
        s.push = p.motor * s.current - p.damping * s.v - p.stiffness * s.x
        return {"x": s.v, "v": s.push}

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
        effects=effects,
    ).system()


@pytest.fixture(scope="module")
def slide():
    return _model()


@pytest.fixture(scope="module")
def sticky():
    """Return a slide whose rails may resist."""
    return _model(
        Effect(
            "dry_friction",
            "push",
            (Quantity("level", 0.2, "m/s^2", 0.0, 5.0, "dry friction", 0.0),),
            lambda s, p, own: -p.level * ca.tanh(s.v / SMOOTH),
            physics="Rails resist.",
            source="assumption",
        )
    )


def _recording(slide, seed, drag=DRAG, friction=0.0, noise=NOISE):
    """Return a recording of a slide that the air holds back by the square of its velocity, and its rails."""
    random, time = np.random.default_rng(seed), PERIOD * np.arange(SAMPLES)
    waves = [(random.uniform(0.5, 1.5), random.uniform(0.1, 2.0), random.uniform(0, 6)) for _ in range(6)]
    current = sum(size * np.sin(2 * np.pi * rate * time + phase) for size, rate, phase in waves)
    state, x, step = np.zeros(2), np.zeros(SAMPLES), PERIOD / FINER
    for i, driven in enumerate(MOTOR * current):
        x[i] = state[0]
        for _ in range(FINER):
            k1 = _rates(state, driven, drag, friction)
            k2 = _rates(state + step / 2 * k1, driven, drag, friction)
            k3 = _rates(state + step / 2 * k2, driven, drag, friction)
            k4 = _rates(state + step * k3, driven, drag, friction)
            state = state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    columns = {"time": time, "x": x + noise * random.standard_normal(SAMPLES), "current": current}
    return from_arrays(f"of {seed}", slide, columns)


def _rates(state, driven, drag, friction):
    x, v = state
    resisted = DAMPING * v + drag * v * abs(v) + friction * np.tanh(v / SMOOTH)
    return np.array([v, driven - STIFFNESS * x - resisted])


def _left(system, recording, held_out=()):
    """Return how many times the noise a recalibrated model leaves of a recording, or of others."""
    start = begin(system, [recording], held_out, GAP)
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
    # what the curve is beside is in the file too: as it is, it does as much
    nominal = begin(slide.changed(patch.changes_of(again)), [third], [], GAP).configured()
    assert nominal.white[measure.OVERALL] < 2.0 * left[0]
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


def test_what_is_left_beside_named_effects_is_what_a_model_with_both_leaves(sticky):
    own = [_recording(sticky, seed, 0.1, 0.4, 10 * NOISE) for seed in (1, 2)]
    outcome = search(begin(sticky, own[:1], own[1:], GAP), GAP)
    assert outcome.verdict == "described"
    assert [one.name for one in outcome.effects] == ["dry_friction"]
    changes = patch.changes_of(outcome)
    left = _left(sticky.changed(changes), own[0], own[1:])
    assert outcome.left_unknown == pytest.approx(left, rel=0.1)
    assert f"leaves {outcome.left_unknown:.1f} times the noise" in describe(outcome)
    assert f"equation ({outcome.kept[outcome.unknown.equation]:.1f} without it)" in describe(outcome)
    (value, *_), level = outcome.effects[0].parameters["level"], changes["effects.dry_friction.level"]
    assert level != pytest.approx(value, rel=1e-3)
    assert f"beside what is unknown, and so in a model file: effects.dry_friction.level {level:.4g}" in (
        describe(outcome)
    )


@pytest.mark.parametrize("spread", [1.0, np.inf, np.nan])
def test_curves_stay_as_they_are_where_a_model_that_has_them_runs_away(monkeypatch, spread):
    group = SimpleNamespace(weights={}, weighted=lambda _: group, system=None)
    told, again = (
        SimpleNamespace(covariance=np.eye(3)),
        SimpleNamespace(covariance=spread * np.ones((3, 3))),
    )
    monkeypatch.setattr(description, "CurveFit", lambda *_: SimpleNamespace(fit=lambda _: None))
    monkeypatch.setattr(description.periodic, "with_harmonics", lambda *_: ())
    for name, result in {"_spline": None, "_changed": again, "_compared": again}.items():
        monkeypatch.setattr(description, name, lambda *_, result=result: result)
    assert description.refitted(group, group, None, None, [told]) == ((again if spread == 1.0 else told),)
