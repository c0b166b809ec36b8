# SPDX-License-Identifier: Apache-2.0
"""A curve that repeats over a signal is told with its period and the size of its wave."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer import standing
from pam_orthosis.discrepancy.answer.unknown_words import unknown_words
from pam_orthosis.discrepancy.fitting import signals
from pam_orthosis.discrepancy.systems.system import Entry
from pam_orthosis.discrepancy.unknown import curve_fit, description, periodic, waves
from pam_orthosis.discrepancy.unknown.unknown import Unknown

ENTRY, SIZE, NOISE = Entry("rad/s^2"), 24.6, 0.08
ENDS = 3.1  # rad


def sine(angle):
    return np.sin(angle)


def triangle(angle):
    return 2 / np.pi * np.arcsin(np.sin(angle))


def skew(angle):
    return np.sin(angle) + 0.4 * np.sin(2 * angle + 1.0)


def curves(monkeypatch, unknown, noise=NOISE):
    """Return fits of curves over an angle to two recordings of an unknown of it, which is seen as it is."""
    draw = np.random.default_rng(3)
    one = object.__new__(curve_fit.CurveFit)
    groups = []
    for _ in range(2):
        angle = np.clip(draw.normal(0.0, 1.0, 12000), -ENDS, ENDS)
        run = SimpleNamespace(serial=len(groups), period=0.002)
        groups.append(SimpleNamespace(scored=[SimpleNamespace(run=run, warm_up=0, samples=12000)]))
        groups[-1].signal = angle
    one._groups, one._equation = tuple(groups), None
    one._signals = {k: {"angle": group.signal} for k, group in enumerate(groups)}
    one._weight = one._deviation = np.zeros(0)
    one._slopes = [(np.zeros((0, 12000)), np.zeros(0, int))] * 2
    one._residuals = [-(unknown(g.signal) + noise * draw.standard_normal(12000)) / noise for g in groups]
    one._size = {("angle", ENTRY): 1.0}
    one._model = SimpleNamespace(free=(), values={})
    one._knots, one.simpler = (8, 20, 60), 1e-4
    monkeypatch.setattr(one, "_rates", lambda channel: set())

    def column(group, spline, able):
        return np.column_stack(signals.hats(group.signal, *one.ends(spline), spline.knots)) @ able / noise

    def blocks(group, equation, values):
        return values.reshape(-1, 500).sum(axis=1)

    monkeypatch.setattr(one, "_column", column)
    monkeypatch.setattr(curve_fit, "block_sums", blocks)
    one._without = one.fit(())
    return one


def told(one):
    """Return the wave that the best free curve of some fits is, as it is described."""
    spline = one.best((), (("angle", ENTRY, "angle"),))[1][0]
    wave = periodic.repeating(one, (), spline, periodic.MOST_KNOTS)
    if wave is None or not wave.spline.harmonics:
        return None
    return description._description(one, one.fit((wave.spline,)), 0, wave.share, None)


@pytest.mark.parametrize("cycles", [3, 5, 10, 15])
@pytest.mark.parametrize("form", [sine, triangle])
@pytest.mark.parametrize("noise", [NOISE, 4.0])
def test_a_wave_is_told_with_its_period_and_amplitude(monkeypatch, cycles, form, noise):
    period = 2 * ENDS / cycles
    one = told(curves(monkeypatch, lambda x: SIZE * form(2 * np.pi * x / period + 0.3), noise))
    assert one.period == pytest.approx(period, rel=0.01)
    size, low, high = one.amplitude
    assert size == pytest.approx(SIZE, rel=0.01 if form is sine else 0.1)
    assert low - 0.002 * SIZE < SIZE < high + 0.002 * SIZE  # straight lines between some knots
    assert high - low < 0.25 * SIZE


def test_a_wave_of_some_harmonics_is_as_large_as_half_its_range(monkeypatch):
    one = told(curves(monkeypatch, lambda x: SIZE * skew(9.0 * x)))
    assert one.harmonics == 2
    around = skew(np.linspace(0, 2 * np.pi, 1000))
    assert one.amplitude[0] == pytest.approx(0.5 * SIZE * np.ptp(around), rel=0.005)


@pytest.mark.parametrize(
    "form",
    [
        lambda x: np.exp(-(((x - 0.4) / 0.25) ** 2)) - 0.7 * np.exp(-(((x + 1.2) / 0.4) ** 2)),
        lambda x: np.tanh(6.0 * (x - 0.3)),
        lambda x: np.sin(8.0 * x * (1 + 0.15 * x)),
        lambda x: np.sign(x) * x**2,
    ],
)
def test_what_does_not_repeat_is_no_wave(monkeypatch, form):
    fits = curves(monkeypatch, lambda x: SIZE * form(x))
    spline = fits.best((), (("angle", ENTRY, "angle"),))[1][0]
    assert periodic.repeating(fits, (), spline, periodic.MOST_KNOTS) is None


def test_a_likely_period_is_seen_though_the_outermost_places_are_wrong():
    """All that is beyond them is put there."""
    places = np.linspace(-2.5, 2.6, 60)
    curve = 22.0 * np.sin(12.0 * places) + 3.0 * places**3 / 8
    curve[[0, -1]] += [150.0, -260.0]
    spread = np.full(60, 0.02)
    spread[[0, -1]] = 0.004
    assert waves.wave_period(places, curve, spread) is None
    assert waves.likely_periods(places, curve, spread)[0] == pytest.approx(2 * np.pi / 12, rel=0.01)


def test_straight_lines_have_less_of_a_wave_than_its_values():
    places, fine = np.linspace(0.0, 4.0, 25), np.linspace(0.0, 4.0, 4001)
    hats = np.column_stack(signals.hats(fine, 0.0, 4.0, 25))
    basis = waves.wave_basis(places, 1.0, 1)
    values = basis @ np.linalg.lstsq(hats @ basis, 2.0 + 3.0 * np.sin(2 * np.pi * fine), rcond=None)[0]
    mean, wave = waves.wave_of(places, 1.0, 1)
    assert mean @ values == pytest.approx(2.0, abs=0.01)
    size, variance = waves.wave_swing(places, wave @ values, 0.01 * np.eye(25), 1.0, 1)
    assert size == pytest.approx(3.0, rel=0.003)
    assert np.hypot(*np.linalg.lstsq(basis, values, rcond=None)[0][1:]) > 3.2
    assert variance == pytest.approx(0.01 * 2 / 25, rel=0.1)


def test_a_wave_that_a_model_has_moves_with_its_period():
    places, factors = np.linspace(-3, 3, 120), np.array([0.5, 2.0, 0.0])
    wanted = 0.6 + 2.1 * np.sin(12.0 * places)
    now = waves.wave_basis(places, 2 * np.pi / 11.99, 1) @ factors
    values, period = waves.wave_moved(places, 2 * np.pi / 11.99, factors, wanted - now)
    assert period == pytest.approx(2 * np.pi / 12, rel=1e-4)
    assert values == pytest.approx(wanted, abs=0.01)


def test_an_interval_is_wider_where_the_form_is_not_that_of_the_unknown(monkeypatch):
    """What eight straight lines leave of a wave is no noise."""
    fits = curves(monkeypatch, lambda x: SIZE * np.sin(4.0 * x))
    spline = curve_fit.Spline("angle", ENTRY, "angle", 8)
    found = fits.fit((spline,))
    spread = np.sqrt(np.diag(fits.curve(found, 0)[2]) / np.diag(found.covariance))
    left = np.sqrt(np.mean(found.left[0] ** 2))
    assert left > 10.0
    assert np.all(spread > 0.99 * left)


def test_a_wave_enters_where_it_removes_most():
    known = {"motor": 0.999, "load": 0.99}
    fits = SimpleNamespace(simpler=1e-4, fit=lambda splines: splines, reduced=lambda s: known[s[0].channel])
    wave = periodic.Wave(curve_fit.Spline("load", ENTRY, "motor", 100, 0.5, 1), 0.99)
    places = [(name, ENTRY) for name in known]
    assert periodic.best_placed(fits, (), wave, places).spline.channel == "motor"
    assert periodic.best_placed(fits, (), wave, places[1:]) == wave


@pytest.mark.parametrize(
    ("sizes", "rest"), [((10.0, 11.0, 11.5), 1.0), ((10.0, 11.0), 1.0), ((10.0, 11.0, 12.0), 2.0)]
)
def test_an_amplitude_that_still_moves_is_not_known_better(sizes, rest):
    """A series that halves its steps has its last step before it."""
    places = np.linspace(0.0, 4.0, 80)
    shape = sizes[-1] * np.sin(2 * np.pi * places)
    one = description.Description(
        "angle", ENTRY, "angle", places, shape, shape, np.zeros((80, 80)), 0.9, None, 1.0, harmonics=1
    )
    (told,) = standing._unsettled([one], [np.array([size]) for size in sizes])
    size, low, high = told.amplitude
    assert size == pytest.approx(sizes[-1], rel=1e-3)
    assert high - low == pytest.approx(2 * 1.96 * rest, rel=0.01)
    constant = replace(one, level=100.0, values=0 * shape)
    assert standing._unsettled([constant], [np.array([1.0]), np.array([2.0])]) == [constant]


def test_words_say_what_is_left_and_how_large_the_curve_is():
    """Few of the squares are many times the noise."""
    places = np.linspace(-1.0, 1.0, 60)
    shape = np.cos(np.pi * places)
    one = description.Description(
        "angle", ENTRY, "angle", places, shape - 3 * places**2, shape, 1e-6 * np.eye(60), 0.985, None, None
    )
    system = SimpleNamespace(entries={}, unit=lambda name: "rad")
    (line,) = unknown_words(system, Unknown("dynamics", [one], ()))
    assert ", half its height 0.99" in line
    assert "with a parabola that may be due to the model's parameters instead)" in line
    assert line.endswith("; removes 98% of the squares of the held-out gap")
    wave = replace(one, reduced=0.99999, period=2.0, harmonics=1)
    (line,) = unknown_words(system, Unknown("dynamics", [wave], ()))
    assert "(period 2 rad, 1 rad/s^2), amplitude 0.99" in line
    assert line.endswith("; removes more than 99% of the squares of the held-out gap")


def test_harmonics_are_added_where_the_model_has_the_wave_already(monkeypatch):
    """To first order a large gap hides them."""
    missing = curves(monkeypatch, lambda x: 0.4 * SIZE * np.sin(18.0 * x + 1.0))
    wave = curve_fit.Spline("angle", ENTRY, "angle", 200, 2 * np.pi / 9.0, 1, (0.0, SIZE, 0.0))
    (more,) = periodic.with_harmonics(missing, (wave,))
    assert (more.harmonics, more.factors) == (2, (0.0, SIZE, 0.0, 0.0, 0.0))
    nothing = curves(monkeypatch, lambda x: 0.0 * x)
    assert periodic.with_harmonics(nothing, (wave,)) == (wave,)


@pytest.mark.parametrize(("harmonics", "reduced"), [(1, 0.999), (0, 0.6)])
def test_a_wave_is_judged_in_the_model_that_has_it(monkeypatch, harmonics, reduced):
    """To first order it may leave so much that the machine seems to be another one."""

    @dataclass(frozen=True)
    class Judged:
        verdict: str = "unexplained"
        unknown: Unknown | None = None
        foreign: bool = False
        floor: float = 1.0

        def described(self, left):
            return replace(self, unknown=left, foreign=left.reduced < 0.9)

    one = SimpleNamespace(reduced=0.6, harmonics=harmonics)
    better = Unknown("dynamics", [SimpleNamespace(reduced=0.999, harmonics=1)], ())
    monkeypatch.setattr(workflow, "unknown", lambda *_: Unknown("dynamics", [one], ()))

    def standing_better(start, outcome):
        return replace(outcome, unknown=better) if outcome.verdict == "described" else outcome

    monkeypatch.setattr(workflow, "standing", standing_better)
    told = workflow._described(SimpleNamespace(held_out=None), Judged(), None, None)
    assert (told.unknown.reduced, told.foreign) == (reduced, reduced < 0.9)


@dataclass(frozen=True)
class Told:
    """A part of an outcome."""

    left_unknown: float
    verdict: str = "described"
    remarks: tuple[str, ...] = ("a stamp", "a gap")


@pytest.mark.parametrize(
    ("left", "verdict", "kept"),
    [
        (1.05, "described", ["a gap"]),
        (1.3, "described", ["a stamp", "a gap"]),
        (1.0, "unexplained", ["a stamp", "a gap"]),
    ],
)
def test_stamps_by_which_a_description_leaves_noise_alone_are_right(left, verdict, kept):
    told = workflow._by_its_stamps(SimpleNamespace(stamps=("a stamp",)), Told(left, verdict))
    assert list(told.remarks) == kept
