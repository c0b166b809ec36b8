# SPDX-License-Identifier: Apache-2.0
"""A description says which textbook effect has its shape, and says nothing of any other curve."""

from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.answer.last_line import last_line
from pam_orthosis.discrepancy.api import (
    Channel,
    Input,
    Model,
    Parameter,
    as_dict,
    describe,
    find_gap,
    from_arrays,
)
from pam_orthosis.discrepancy.systems.system import Entry
from pam_orthosis.discrepancy.unknown import textbook
from pam_orthosis.report import gap as page

SPEEDS, PLACES = np.linspace(-2.2, 2.0, 20), np.linspace(-0.6, 0.7, 20)
ROLL, TIMES, VOLTS = np.linspace(-3.0, 3.2, 20), np.linspace(0.0, 40.0, 8), np.linspace(-2.0, 2.1, 8)
FEW = np.linspace(-1.9, 2.1, 8)


def _bump(x):
    return np.exp(-(((x - 0.1) / 0.25) ** 2)) - 0.6 * np.exp(-(((x + 0.3) / 0.12) ** 2))


@pytest.mark.parametrize(
    ("kind", "places", "curve", "said"),
    [
        ("velocity", SPEEDS, lambda v: -1.4 * np.sign(v), "dry friction (the sign of the velocity)"),
        ("velocity", SPEEDS, lambda v: -0.3 * v * np.abs(v), "quadratic drag (v |v|)"),
        ("velocity", FEW, lambda v: -0.3 * v * np.abs(v), "quadratic drag (v |v|)"),
        ("velocity", SPEEDS, lambda v: 0.3 * v * np.abs(v), None),  # it drives
        ("velocity", SPEEDS, lambda v: -0.3 * v**3, None),
        ("velocity", SPEEDS, lambda v: -0.3 * v * np.abs(v) ** 1.4, None),  # between two forms
        ("velocity", SPEEDS, lambda v: _bump(v / 3), None),
        ("position", PLACES, lambda x: -40 * x**3, "a spring that hardens (cubic)"),
        ("position", PLACES, lambda x: 40 * (x - 0.1) ** 3, "a spring that softens (cubic)"),
        (
            "position",
            PLACES,
            lambda x: -9 * np.maximum(x - 0.25, 0),
            "an end stop or one-sided spring (a line above 0.2",
        ),
        (
            "position",
            PLACES,
            lambda x: 9 * np.maximum(-0.2 - x, 0),
            "an end stop or one-sided spring (a line below -0.2",
        ),
        (
            "position",
            PLACES,
            lambda x: -9 * np.sign(x) * np.maximum(np.abs(x) - 0.2, 0),
            "a spring with a dead zone (free from -0.",
        ),
        ("position", PLACES, lambda x: np.sin(2 * np.pi * x / 0.35 + 1), "what repeats over the position"),
        ("position", PLACES, _bump, None),
        ("position", PLACES, lambda x: -np.exp(6 * x), None),
        ("angle", ROLL, lambda q: -3 * np.sin(q + 0.4), "a weight on an arm (sine of the angle)"),
        ("angle", PLACES, lambda q: -3 * np.sin(q), "a spring that softens (cubic)"),
        ("time", TIMES, lambda t: 0.02 * t, "a drift (a line over time)"),
        ("time", TIMES, lambda t: 1 - np.exp(-t / 6), None),
        ("input", VOLTS, lambda u: 0.5 * u + 0.1 * u**2, "the square of the input"),
        ("input", SPEEDS, lambda u: np.clip(u, -0.5, 0.5), "a dead zone or a saturation of the input (kinks"),
    ],
)
@pytest.mark.parametrize("straight", [0.0, 30.0])
def test_a_curve_of_known_covariance(kind, places, curve, said, straight):
    """A parabola of any size beside it, or a line of an input, is what recalibration may have done."""
    seen, covariance = _spline(places, curve, 0.01 * np.std(curve(places)))
    degree = textbook.TAKEN[kind]
    seen += sum(straight * np.std(seen) * (places / np.ptp(places)) ** k for k in range(degree + 1))
    found = textbook.shape_of(kind, places, seen, covariance, "u")
    assert found == said if said is None or found is None else found.startswith(said)


def _spline(knots, curve, noise):
    """Return values at knots of the spline that fits noisy samples of a curve, and their covariance."""
    rng = np.random.default_rng(3)
    at = rng.uniform(knots[0], knots[-1], 4000)
    place = (at - knots[0]) / (knots[1] - knots[0])
    parts = np.maximum(1 - np.abs(place[:, None] - np.arange(len(knots))), 0.0)
    samples = curve(at) + noise * rng.standard_normal(len(at))
    return np.linalg.lstsq(parts, samples, rcond=None)[0], noise**2 * np.linalg.inv(parts.T @ parts)


def test_a_curve_that_is_hardly_known_has_no_shape():
    for noise, is_said in ((0.02, True), (0.6, False)):
        seen = _spline(SPEEDS, lambda v: -0.3 * v * np.abs(v), noise)
        assert (textbook.shape_of("velocity", SPEEDS, *seen, "m/s") is not None) is is_said


def test_few_knots_do_not_show_what_takes_many_parameters():
    places = np.linspace(-0.6, 0.7, 8)
    wave = np.sin(2 * np.pi * places / 0.55)
    assert textbook.shape_of("position", places, wave, 1e-8 * np.eye(8), "m") is None


def _equations(s, p):
    s.force = p.motor * s.current - p.damping * s.velocity - p.spring * s.position
    return {"position": s.velocity, "velocity": s.force / p.mass}


@pytest.fixture(scope="module")
def cart():
    return Model(
        name="cart",
        channels=[Channel("position", "position", "m", "mm", 1e3)],
        inputs=[Input("current", "A")],
        states=["position", "velocity"],
        equations=_equations,
        parameters=[
            Parameter("mass", 2.0, "kg", 0.06, "mass"),
            Parameter("motor", 12.0, "N/A", 1.0, "force per current"),
            Parameter("damping", 5.0, "N s/m", 8.0, "viscous friction"),
            Parameter("spring", 60.0, "N/m", 30.0, "spring"),
        ],
    ).system()


PERIOD, SAMPLES, STEPS, NOISE = 0.005, 7000, 5, 1e-3  # s, -, a period, m


def _recorded(system, seed, hidden, strength):
    """Return a recording of a cart with a hidden force, N, of place and velocity: by Runge and Kutta."""
    rng, time, step = np.random.default_rng(seed), PERIOD * np.arange(SAMPLES), PERIOD / STEPS
    waves = [(rng.uniform(0.3, 1.0), rng.uniform(0.6, 12.5), rng.uniform(0.0, 6.0)) for _ in range(8)]
    current = strength * sum(a * np.sin(w * time + phase) for a, w, phase in waves)
    places, state = np.zeros(SAMPLES), np.zeros(2)
    for i in range(SAMPLES - 1):

        def rate(now, drive=11.8 * current[i]):
            return np.array([now[1], (drive - 5.2 * now[1] - 60.5 * now[0] + hidden(*now)) / 2.03])

        for _ in range(STEPS):
            a = rate(state)
            b = rate(state + step / 2 * a)
            c = rate(state + step / 2 * b)
            state = state + step / 6 * (a + 2 * b + 2 * c + rate(state + step * c))
        places[i + 1] = state[0]
    seen = places + NOISE * rng.standard_normal(SAMPLES)
    return from_arrays(f"run {seed}", system, {"time": time, "position": seen, "current": current})


def _two_bumps(x, v):
    return 2.5 * (np.exp(-(((x - 0.15) / 0.12) ** 2)) - 0.7 * np.exp(-(((x + 0.2) / 0.2) ** 2)))


@pytest.mark.parametrize(
    ("hidden", "strength", "over", "said"),
    [
        (lambda x, v: -1.0 * v * abs(v), 1.0, "velocity", "quadratic drag (v |v|)"),
        (lambda x, v: -1.5 * np.tanh(v / 2e-3), 1.0, "velocity", "dry friction (the sign of the velocity)"),
        (lambda x, v: -20 * max(x - 0.15, 0), 1.2, "position", "an end stop or one-sided spring (a line abo"),
        (_two_bumps, 1.5, "position", None),
    ],
)
def test_what_a_cart_lacks(cart, hidden, strength, over, said):
    outcome = find_gap(cart, *([_recorded(cart, seed, hidden, strength)] for seed in (1, 2)))
    (one,) = outcome.unknown.descriptions
    words, (plot_words,) = describe(outcome), [part.words for part in page._missing(outcome)[:1]]
    told = as_dict(outcome)["unknown"]["curve"]
    assert (outcome.verdict, one.coordinate) == ("described", over)
    assert told["shape_of"] == one.shape_of
    assert "shape" not in last_line(outcome), "a resemblance is no answer"
    assert last_line(outcome).count("a description, no cause") == 1
    if said is None:
        assert one.shape_of is None
        assert "shape of" not in words
    else:
        assert one.shape_of.startswith(said)
        line = f"it has the shape of {one.shape_of}; other causes may have it too"
        assert line in words.split("\n")
        assert line in plot_words


def test_what_a_curve_is_over(cart):
    force = Entry("m/s^2")
    over = [textbook.kind_of(cart, "position", force, s) for s in ("velocity", "position", "time", "current")]
    assert over == ["velocity", "position", "time", "input"]
    assert textbook.kind_of(cart, "position", Entry("-"), "current") is None


def test_no_spring_or_friction_is_seen_in_what_has_no_rate():
    """The level of a tank is no position: nothing there pulls back."""
    levels = {name: Channel(name, name, unit, unit, 1.0) for name, unit in (("level", "m"), ("speed", "m/s"))}
    tank = SimpleNamespace(inputs=("valve",), derived={}, channel=levels.get)
    assert textbook.kind_of(tank, "level", Entry("m/s"), "level") is None
    assert textbook.kind_of(tank, "speed", Entry("m/s/s"), "speed") == "velocity"
    assert textbook.kind_of(tank, "level", Entry("m/s"), "speed") is None
