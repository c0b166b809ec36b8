# SPDX-License-Identifier: Apache-2.0
"""Inputs that are read with noise: what filters that noise is no effect, and moves no parameter."""

from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from pam_orthosis.discrepancy.answer.between import remarks_on_inputs
from pam_orthosis.discrepancy.answer.unstated import unstated_noise
from pam_orthosis.discrepancy.api import Channel, Effect, Input, Model, Parameter, Quantity, from_arrays
from pam_orthosis.discrepancy.fitting.fit import fit
from pam_orthosis.discrepancy.fitting.projection import RanAway, _factor
from pam_orthosis.discrepancy.fitting.unbiased import unbiased
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.recordings.stamps import Skew
from pam_orthosis.discrepancy.replay.whitening import drawn
from pam_orthosis.discrepancy.search import select, selection
from pam_orthosis.discrepancy.search.confirmation import confirmed
from pam_orthosis.discrepancy.search.filtered import is_rounding
from pam_orthosis.discrepancy.search.selection import Selection
from pam_orthosis.discrepancy.workflow import search
from pam_orthosis.model.parameters import load

PERIOD, SAMPLES, NOISE, STEP = 0.002, 8000, 0.05, 0.2  # s, A, A
MASS, MOTOR, DAMPING = 2.0, 12.0, 5.0
SWING = 0.1  # A


def _equations(s, p):
    s.force = p.motor * s.current - p.damping * s.velocity
    return {"position": s.velocity, "velocity": s.force / p.mass}


FRICTION = Effect(
    "friction",
    "force",
    (Quantity("level", 3.0, "N", 0.0, 50.0, "dry friction", 0.0),),
    lambda s, p, own: -p.level * ca.tanh(s.velocity / 2e-4),
    physics="The guide resists.",
    source="assumption",
)


def _system(noise):
    return Model(
        name="slide",
        channels=[Channel("position", "position", "m", "mm", 1e3)],
        inputs=[Input("current", "A", noise=noise)],
        states=["position", "velocity"],
        equations=_equations,
        parameters=[
            Parameter("mass", MASS, "kg", 0.3, "mass"),
            Parameter("motor", MOTOR, "N/A", 0.0, "force per current"),
            Parameter("damping", DAMPING, "N s/m", 0.0, "viscous friction"),
        ],
        effects=[FRICTION],
    ).system()


def _recording(system, seed, read):
    """Return a recording in which nothing is hidden; `read`: what is read of the current."""
    rng = np.random.default_rng(seed)
    time = np.arange(SAMPLES) * PERIOD
    waves = zip(rng.uniform(0.3, 2.0, 3), rng.uniform(0, 2 * np.pi, 3), strict=True)
    current = sum(SWING * np.sin(2 * np.pi * f * time + phase) for f, phase in waves)
    position, velocity, seen = 0.0, 0.0, np.empty(SAMPLES)
    decay = np.exp(-DAMPING / MASS * PERIOD)
    for i, amps in enumerate(current):
        seen[i] = position + 5e-6 * rng.standard_normal()
        terminal = MOTOR / DAMPING * amps
        position += terminal * PERIOD + (velocity - terminal) * (1 - decay) * MASS / DAMPING
        velocity = terminal + (velocity - terminal) * decay
    return from_arrays(f"{seed}", system, {"time": time, "position": seen, "current": read(current, rng)})


def _noisy(current, rng):
    return current + NOISE * rng.standard_normal(len(current))


def _rounded(current, _rng):
    return np.round(current / STEP) * STEP


def _start(noise, read=_noisy):
    system = _system(noise)
    one, other = (_recording(system, seed, read) for seed in (1, 2))
    return begin(system, [one], [other], load().gap)


@pytest.fixture(scope="module")
def start():
    return _start(NOISE)


def _with(start, name, **own):
    values = {**start.problem.replay.defaults((name,)), **start.null.values}
    values |= {f"{name}.{key}": value for key, value in own.items()}
    return fit(start.problem, (name,), values, start.null.free, most=1)


def test_noise_of_a_reading_stays_while_the_reading_rests():
    signals = {"current": np.array([1.0, 1.0, 2.0, 2.0, 2.0, 1.0])}
    run = SimpleNamespace(recording=SimpleNamespace(samples=6, signals=signals))
    system = SimpleNamespace(input_noise={"current": 0.1})
    noise = drawn(np.random.default_rng(0), system, run, {"current": 0.1, "position": 0.1})
    assert [len(np.unique(part)) for part in np.split(noise["current"], (2, 5))] == [1, 1, 1]
    assert len(np.unique(noise["current"])) == 3
    assert len(np.unique(noise["position"])) == 6
    fine = drawn(np.random.default_rng(0), system, run, {"current": 1.0})
    assert len(np.unique(fine["current"])) == 6


def test_a_lag_that_only_filters_noise_is_not_confirmed(start):
    lag = _with(start, "inputs_lag", time=0.004)
    seen = confirmed(start.problem, start.held_out, start.null, lag)
    assert start.held_out.total((), start.null.values) - start.held_out.total(lag.effects, lag.values) > 36
    assert not seen.shows
    assert seen.fall < 0


def test_an_effect_below_the_steps_of_readings_is_refused():
    start = _start(STEP / 12**0.5, _rounded)
    assert is_rounding(start.problem, start.null, _with(start, "friction", level=0.01))
    assert not is_rounding(start.problem, start.null, _with(start, "friction", level=3.0))


def test_noise_of_an_input_moves_no_parameter(start):
    deviation = start.null.values["mass"]
    assert abs(unbiased(start.problem, start.null).values["mass"]) < 0.5 * abs(deviation)


def test_noise_makes_no_input_run_straight(start):
    found = Selection(start.problem, start.null, start.problem, start.null)
    assert remarks_on_inputs(found, load().gap) == []


@pytest.mark.parametrize(("noise", "kept"), [(NOISE, False), (1e-3, True)])
def test_stamps_are_not_doubted_where_noise_alone_is_left(monkeypatch, noise, kept):
    skew = Skew("position", ("current",), 0.008, 0.3)
    monkeypatch.setattr(beginning, "shared_skews", lambda _, many, *__: [(one, [skew]) for one in many])
    start = _start(noise)
    assert bool(start.stamps) is kept
    assert start.skewed is kept


def test_noise_of_an_input_that_is_not_stated_is_said(start):
    assert unstated_noise(start, named=False) == []
    untold = _start(0.0)
    (remark,) = unstated_noise(untold, named=False)
    assert remark.startswith("current varies from row to row by 0.05")
    assert "write Input('current', 'A', noise=0.05) and search again" in remark


def test_a_stated_model_that_leaves_noise_alone_is_not_fitted_to_noise(start, monkeypatch):
    """Else the search would start from parameters that the noise has moved."""
    far = replace(start.null, values={**start.null.values, "mass": 5.0})
    found = select.extended(start.problem, far, start.held_out, load().gap.evidence)
    assert (found.steps, found.final.values["mass"]) == ([], 0.0)
    monkeypatch.setattr(select, "leaves_noise_alone", lambda *_: False)
    monkeypatch.setattr(select, "_round", lambda *_: selection.Step(None, None, None, 0.0, 0.0, (), "none"))
    found = select.extended(start.problem, start.null, start.held_out, load().gap.evidence)
    assert [one.reason for one in found.steps] == ["none"]


def test_a_search_ends_where_derivatives_of_its_model_run_away(start, monkeypatch):
    with pytest.raises(RanAway, match="run away"):
        _factor(np.array([[np.inf, 0.0], [0.0, 1.0]]))
    monkeypatch.setattr(select, "leaves_noise_alone", lambda *_: False)
    monkeypatch.setattr(select, "_round", lambda *_: _factor(np.full((2, 2), np.nan)))
    found = select.extended(start.problem, start.null, start.held_out, load().gap.evidence)
    assert (found.steps, found.final.effects) == ([], ())


def test_a_search_names_nothing_where_noise_is_stated_and_says_so_where_it_is_not(start):
    known, untold = (search(one, load().gap) for one in (start, _start(0.0)))
    assert (known.verdict, known.effects) == ("none", ())
    assert abs(known.selection.final.values["mass"]) < 0.5 * abs(start.null.values["mass"])
    assert untold.verdict == "unexplained"
    assert any("may be why this is left" in one for one in untold.remarks)
    assert not any("may be why this is left" in one for one in known.remarks)
