# SPDX-License-Identifier: Apache-2.0
"""A replay is held to its recording: with slow samples too, and not where its model is unstable."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.api import Channel, Input, Model, Parameter
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.unknown import curve_fit
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.parameters import load

NOISE, GAP = 1e-3, load().gap


def tank(s, p):
    return {"level": (p.gain * s.valve - s.level) / p.time}


def pendulum(s, p):
    """One that stands: it falls with a time constant of 0.1 s."""
    return {"angle": s.rate, "rate": p.fall * s.angle + s.push}


def described(equations, channel, states, inputs, parameter, gains=None):
    return Model(
        name="own",
        channels=[Channel(channel, channel, "m", "mm", 1e3)],
        inputs=[Input(inputs, "V")],
        states=states,
        equations=equations,
        parameters=parameter,
        gains=gains or {},
    ).system()


def slow(system, seed):
    """Record the tank every half second, exactly as a held input fills it."""
    draw = np.random.default_rng(seed)
    valve = np.repeat(draw.uniform(0.2, 1.0, 60), 10)
    level, rows = 0.5, []
    for opening in valve:
        rows.append(level)
        level = opening + (level - opening) * np.exp(-0.5 / 8.0)
    shown = np.array(rows) + NOISE * draw.standard_normal(len(rows))
    return from_arrays(
        str(seed), system, {"time": 0.5 * np.arange(len(rows)), "level": shown, "valve": valve}
    )


def test_samples_of_half_a_second_do_not_make_the_observer_unstable():
    parameters = [Parameter("gain", 1.0, "m/V", 0.02, "gain"), Parameter("time", 8.0, "s", 0.2, "time")]
    system = described(tank, "level", ["level"], "valve", parameters)
    start = begin(system, [slow(system, 1)], [slow(system, 2)], GAP)
    assert NOISE < start.floor.units["level"] < 2 * NOISE
    assert start.recalibrated().white["level"] < 1.2


def standing(system, seed):
    """Record the pendulum as it is held upright."""
    draw, period = np.random.default_rng(seed), 0.005
    angle = rate = 0.0
    rows = []
    for _ in range(3000):
        push = -150.0 * angle - 15.0 * rate + draw.normal(0.0, 1.0)
        rows.append((angle, push))
        for _ in range(10):
            angle, rate = angle + 0.1 * period * rate, rate + 0.1 * period * (100.0 * angle + push)
    seen = np.array(rows).T
    shown = seen[0] + 1e-5 * draw.standard_normal(len(rows))
    return from_arrays(
        str(seed), system, {"time": period * np.arange(len(rows)), "angle": shown, "push": seen[1]}
    )


@pytest.mark.parametrize("gains", [None, {"angle": (40.0, 500.0)}])
def test_a_replay_in_which_noise_grows_is_refused_until_it_is_held_more_firmly(gains):
    fall = [Parameter("fall", 100.0, "1/s^2", 1.0, "weight over inertia and length")]
    system = described(pendulum, "angle", ["angle", "rate"], "push", fall, gains)
    recorded = [standing(system, seed) for seed in (1, 2)]
    if gains:
        assert begin(system, recorded[:1], recorded[1:], GAP).recalibrated().white["angle"] < 1.5
    else:
        with pytest.raises(OrthosisError, match=r"angle: noise grows in the replay .* Model\(gains="):
            begin(system, recorded[:1], recorded[1:], GAP)


def test_what_ran_away_is_described_by_nothing(monkeypatch):
    one = object.__new__(curve_fit.CurveFit)
    one._weight, one._deviation = np.ones(2), np.zeros(2)
    one._slopes = [(np.full((2, 5), 1e200), np.arange(2))] * 2
    one._residuals = [np.ones(5)] * 2
    monkeypatch.setattr(one, "_columns", lambda *_: np.zeros((5, 0)))
    found = one._fitted((), ())
    np.testing.assert_array_equal(found.step, 0.0)
    np.testing.assert_array_equal(found.left, [np.ones(5)] * 2)


def test_without_its_names_a_description_is_judged_afresh(monkeypatch):
    """It was called described, and a description that failed would have stayed so."""
    judged = []

    class Told(SimpleNamespace):
        pass

    monkeypatch.setattr(workflow, "replace", lambda told, **new: Told(**(vars(told) | new)))
    monkeypatch.setattr(
        workflow, "_described", lambda start, outcome, *rest: judged.append(outcome.verdict) or outcome
    )
    told = Told(verdict="described", effects=("friction",), unknown="curve")
    assert workflow._or_without_names(SimpleNamespace(problem=None, null=None), told) is told
    assert judged == ["unexplained"]
