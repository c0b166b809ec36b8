# SPDX-License-Identifier: Apache-2.0
"""What nothing in the catalogue explains is described: as a curve over a signal, as events, or not at all."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.control import effects
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.discrepancy.answer.unknown_words import short, unannounced, unknown_as_dict, unknown_words
from pam_orthosis.discrepancy.fitting import signals
from pam_orthosis.discrepancy.fitting.measure import over_noise
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.replay.injection import Injection, injection
from pam_orthosis.discrepancy.replay.problem import Problem, Scored
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.replay.run import Run
from pam_orthosis.discrepancy.replay.whitening import Whitener
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.systems.system import Channel, Entry, Equation, System
from pam_orthosis.discrepancy.unknown import curve_fit, description, unknown, waves
from pam_orthosis.discrepancy.unknown.curve_fit import Spline
from pam_orthosis.discrepancy.unknown.events import Event, end_of
from pam_orthosis.discrepancy.unknown.parts import parts_of
from pam_orthosis.discrepancy.unknown.unknown import Unknown
from pam_orthosis.model.parameters import load
from pam_orthosis.report import gap_figures
from pam_orthosis.report.plots import packed
from pam_orthosis.testing import case as cases

CYCLES = {1: 2.0, 2: 1.4, 3: 1.7}  # seed -> s


def added(bench, torque):
    """Return recordings whose angle is what an unknown torque, N m, makes of it to first order."""
    made = []
    for seed, cycle in CYCLES.items():
        one, arrays = bench.recording(seed, cycle), bench.arrays(seed, cycle)
        equation, run = bench.system.equations[0], Run(bench.system, one, 40.0)
        values = bench.replay.defaults(())
        linear = injection(bench.replay, run, equation, "angle", values)
        lever = lever_of(bench.replay, run, equation, "angle", linear)
        wanted = torque(run.smooth("angle"), one.start + one.period * np.arange(one.samples))
        moved = arrays["angle"] + linear.response((lever * wanted)[:, None])["angle"][:, 0]
        made.append(from_arrays(f"run {seed}", bench.system, {**arrays, "angle": moved}))
    return made


def lever_of(replay, run, equation, channel, linear, index=0):
    """Return what one unit makes of a rate; `index`: of the entries of the channel."""
    entry = replay.system.entries_of(channel)[index]
    return curve_fit.lever(Problem(replay, []), _Scored(run), equation, channel, entry, linear)


def _described(one):
    shown = {"unit": one.entry.unit, "period": None, "amplitude": (2e4, 1e4, 3e4), "reduced": 0.9}
    return SimpleNamespace(**vars(one), **shown, runner_up=None, is_constant=False, level=0.0, shape_of=None)


class _Scored:
    def __init__(self, run):
        self.run, self.warm_up, self.whiten = run, 0, Whitener({})


@pytest.fixture(scope="module")
def reported(bench):
    """Return (torque of angle and time) -> what is said of it."""

    def described(torque):
        *training, held_out = added(bench, torque)
        start = beginning.begin(bench.system, training, [held_out], bench.parameters.gap, replay=bench.replay)
        return unknown.unknown(start.problem, start.held_out, start.null, start.floor)

    return described


def test_the_linearised_replay_is_that_of_the_model(bench):
    equation, run = bench.system.equations[0], Run(bench.system, bench.recording(1), 40.0)
    values = bench.replay.defaults(("constant_torque",))
    seen = [
        bench.replay.residuals(run, equation, ("constant_torque",), {**values, "constant_torque.torque": x})
        for x in (0.0, 0.2)
    ]
    change = seen[0] - seen[1]
    linear = injection(bench.replay, run, equation, "angle", values)
    back = linear.response(linear.added(change)[:, None])["angle"]
    assert np.std(back - change) < 0.06 * np.std(change)
    lever = lever_of(bench.replay, run, equation, "angle", linear)
    assert 0.2 * lever[1000:].mean() == pytest.approx(linear.added(change)[1000:].mean(), rel=0.05)


def coupled(count):
    """Return the linearised replay of two joints that feel each other, with an unknown in the second one."""
    gains = np.array([[6.0, 0.0], [0.0, 5.0], [20.0, 0.0], [0.0, 15.0]])
    slopes = np.zeros((count, 4, 4))
    slopes[:, 0, 2] = slopes[:, 1, 3] = 1.0
    slopes[:, 2:] = [[-30.0, 8.0, -4.0, 1.0], [6.0, -20.0, 2.0, -5.0]]
    return Injection(slopes, gains, ("a", "b"), [1, 0], [0, 1], {0: 2, 1: 3}, 3, 0.01)


def test_a_response_is_that_of_the_replay_step_by_step():
    rng, count = np.random.default_rng(1), 40
    one = coupled(count)
    added, state = rng.normal(size=(count, 3)), np.zeros((4, 3))
    seen = one.response(added)
    for k in range(count):
        assert seen["a"][k] == pytest.approx(state[0], abs=1e-12)
        assert seen["b"][k] == pytest.approx(state[1], abs=1e-12)
        held = state - 0.01 * one.gains @ state[:2]
        rate = one.slopes[k] @ held
        state = held + 0.01 * rate + 0.5 * 0.01**2 * one.slopes[k] @ rate
        state[3] += 0.01 * added[k]


def test_what_was_added_is_found_back_where_channels_feel_each_other():
    one = replace(coupled(4000), period=0.001)
    wanted = np.sin(np.linspace(0.0, 20.0, 4000))
    seen = one.response(wanted[:, None])
    back = one.added(np.column_stack([seen["b"], seen["a"]]))
    assert back[200:-200] == pytest.approx(wanted[200:-200], abs=0.02)


def test_without_a_candidate_of_a_constant_the_missing_rate_is_described(bench):
    """A model that has a constant torque already has no candidate in whose unit an unknown is reported."""
    system = knee(bench.parameters.changed({"effects.constant_torque.enabled": True}))
    equation, run = system.equations[0], Run(system, bench.recording(1), 40.0)
    assert bench.system.entries_of("angle")[0].unit == "N m"
    (entry,) = system.entries_of("angle")
    assert entry == Entry("rad/s^2")
    replay = Replay(system)
    linear = injection(replay, run, equation, "angle", replay.defaults(()))
    assert (lever_of(replay, run, equation, "angle", linear) == 1.0).all()
    found = SimpleNamespace(
        channel="angle", coordinate="angle", period=None, amplitude=(2.0, 1.0, 3.0), unit=entry.unit,
        entry=entry, is_constant=False, values=np.array([-2.5, 2.5]),
    )  # fmt: skip
    reported = short(system, SimpleNamespace(descriptions=[found], events=()))
    assert reported == "unknown acceleration of angle over angle (2 rad/s^2)"
    found.values, found.period = np.array([0.0, 70.0]), 0.3  # with a parabola, of which it is a small part
    reported = short(system, SimpleNamespace(descriptions=[found], events=()))
    assert reported == "unknown acceleration of angle over angle (35 rad/s^2)"


@pytest.mark.parametrize("harmonics", [0, 1])
@pytest.mark.parametrize(("height", "level"), [(0.001, -0.9), (0.1, 0.0)])
def test_a_curve_over_its_own_signal_that_is_a_constant_alone_is_called_one(harmonics, height, level):
    """Its shape does not show; where it does, the constant may be due to parameters."""
    places, period = np.linspace(0.0, 1.0, 20), 0.4
    values = -0.9 + height * np.sin(2 * np.pi * places / period)
    spline = Spline("x", Entry("m/s^2"), "x", 20, period if harmonics else 0.0, harmonics)
    kept, shape, *_, found = parts_of(places, values, 1e-4 * np.eye(20), True, spline)
    assert found == pytest.approx(level, abs=0.01)
    assert kept + found == pytest.approx(values)
    assert np.abs(shape).max() < 0.2


def test_a_torque_of_the_angle_is_described_with_its_period_and_size(bench, reported):
    found = reported(lambda angle, time: 0.5 * np.sin(14 * angle))
    (one,) = found.descriptions
    assert (found.equation, one.coordinate, one.unit) == ("torque", "angle", "N m")
    assert one.period == pytest.approx(2 * np.pi / 14, rel=0.05)
    assert one.amplitude[0] == pytest.approx(0.5, rel=0.15)
    assert one.reduced > 0.8
    assert short(bench.system, found).startswith("unknown torque of angle (period 0.4")
    assert "removes 9" in unknown_words(bench.system, found)[0]
    assert unknown_as_dict(bench.system, found)["curve"]["coordinate"] == "angle"
    (plot,) = gap_figures.unknown(SimpleNamespace(unknown=found, system=bench.system))
    assert (plot.x, plot.y) == ("angle / rad", "unknown / N m")
    upper = one.shape + 1.96 * one.spread
    assert [trace["x"] for trace in plot.data] == [packed(one.places)] * 3
    assert plot.data[2]["y"] == packed(upper)


def test_pushes_at_instants_of_their_own_are_events(bench, reported):
    def pushes(angle, time):
        return sum(1.5 * np.exp(-(((time - at) / 0.08) ** 2)) for at in (4.0, 7.3, 10.1))

    found = reported(pushes)
    assert not found.descriptions
    assert [event.time for event in found.events] == pytest.approx([4.0, 7.3, 10.1], abs=0.1)
    assert [event.size for event in found.events] == pytest.approx([1.5] * 3, rel=0.35)
    (line,) = unknown_words(bench.system, found)
    assert "equation: no curve of a measured signal explains them; pushes in run 3 at 4.0 s (+1." in line
    assert found.end is None
    assert " N m for 0." in line
    assert {event.channel for event in found.events} == {"angle"}
    assert short(bench.system, found) == "3 pushes (in run 3 at 4.0 s, 7.3 s, 10.1 s)"
    bare = replace(found, events=())
    assert unknown_words(bench.system, bare)[0].endswith(
        "no curve over one measured signal, added to the equation, removes half of the held-out gap (up to 20"
        " points were tried); an error of a sensor that depends on a signal was not tried"
    )
    (drifting,) = unknown_words(bench.system, bare, {"time": 0.6, "angle": 0.1})
    assert "it changes with time: a sensor's zero that drifts" in drifting
    for shares in ({"angle": 0.6, "time": 0.1}, {"time": 0.71, "angle": 0.51}):
        assert unknown_words(bench.system, bare, shares) == unknown_words(bench.system, bare)


def test_pushes_at_one_end_of_a_coordinate_may_be_of_an_end_stop(bench):
    run = Run(bench.system, bench.recording(3), 10.0)
    problem = Problem(bench.replay, [Scored(run, None, 500)])
    angle = run.smooth("angle")
    behind = np.arange(len(angle)) >= 500
    high, half = (np.flatnonzero(behind & (angle >= np.quantile(angle, q))) for q in (0.98, 0.4))
    high, half = (places[[0, len(places) // 2, -1]] for places in (high, half))

    def pushes(places):
        start, period = run.recording.start, run.period
        return [Event(run.recording.name, "angle", start + at * period, 1.0 + at, 0.1) for at in places]

    end = end_of(problem, pushes(high))
    assert (end.signal, end.above) == ("angle", True)
    assert (end.value, end.largest) == (min(angle[high]), angle[high[-1]])
    told = unannounced(bench.system, Unknown("torque", (), pushes(high), end=end))
    assert f"all are where angle is above {end.value:.3g} rad, the largest at" in told
    assert end_of(problem, pushes(half)) is None


def test_a_push_has_the_unit_of_its_channel():
    channels = tuple(Channel(name, name, unit, unit, 1.0) for name, unit in (("place", "m"), ("gas", "Pa")))
    equation = Equation("both", ("place", "gas"), ("place", "gas"), {})
    system = System("two", channels, (), {}, (equation,), (), {}, lambda effects: None)
    (line,) = unknown_words(system, Unknown("both", (), (Event("run", "gas", 3.1, 200.0, 0.2),)))
    assert line.endswith("; push in run at 3.1 s (+2e+02 Pa/s of gas for 0.2 s)")


def test_pushes_are_said_to_be_in_their_recordings():
    channel, equation = Channel("gas", "gas", "Pa", "Pa", 1.0), Equation("all", ("gas",), ("gas",), {})
    system = System("one", (channel,), (), {}, (equation,), (), {}, lambda effects: None)
    places = (("first", 3.1), ("first", 5.0), ("second", 1.2), ("first", 7.0), ("second", 9.0))
    found = Unknown("all", (), [Event(name, "gas", time, 200.0, 0.2) for name, time in places])
    told = "5 pushes (in first at 3.1 s, 5.0 s, 7.0 s; in second at 1.2 s and 1 more)"
    assert short(system, found) == told
    size = " (+2e+02 Pa/s for 0.2 s)"
    said = f"pushes in first at 3.1 s{size}, 5.0 s{size}, 7.0 s{size}; in second at 1.2 s{size}"
    assert unknown_words(system, found)[0].endswith(said)


def test_a_model_file_carries_a_description(bench, reported, tmp_path):
    """The next search has it in its model, and finds the gap that was left; so do the controllers."""
    wave = lambda angle, time: 0.5 * np.sin(14 * angle)  # noqa: E731
    (one,) = reported(wave).descriptions
    path = tmp_path / "model.yaml"
    patch.write(path, patch.of_description(bench.system, one))
    model = bench.parameters.changed(patch.read_nominal(path))
    *training, held_out = added(bench, wave)
    start = beginning.begin(knee(model), training, [held_out], bench.parameters.gap)
    before = beginning.begin(bench.system, training, [held_out], bench.parameters.gap, replay=bench.replay)
    gaps = [b.recalibrated().white["angle"] ** 2 - b.floor.white["angle"] ** 2 for b in (before, start)]
    assert 1 - gaps[1] / gaps[0] == pytest.approx(one.reduced, abs=0.03)
    assert start.system.catalogue.keys() == bench.system.catalogue.keys()
    assert not start.system.entries_of("angle")[0].held  # it holds one already
    feed_forward, angles = effects.added_by_effects(model), np.linspace(-0.2, 1.5, 50)
    torque = [float(feed_forward(q, 0.0, [2e5, 3e5], [], 0.0)[0]) for q in angles]
    assert torque == pytest.approx(np.interp(angles, one.places, one.values), abs=1e-4)


def test_a_rate_of_pressure_is_carried_too(bench):
    """In the search, not by the controllers."""
    entry = bench.system.entries_of("flexor_pressure")[0]
    one = SimpleNamespace(channel="flexor_pressure", coordinate="velocity", places=np.array([-1.0, 1.0]),
                          values=np.array([-2e4, 2e4]), entry=entry)  # fmt: skip
    changes = patch.of_description(bench.system, one)
    assert changes["effects.flexor_unknown_rate.coordinate"] == "velocity"
    system, run = knee(bench.parameters.changed(changes)), bench.recording(1)
    (gas,) = (one for one in system.equations if one.name == "gas")
    seen = []
    for replay in (bench.replay, Replay(system)):
        started = Run(replay.system, run, 40.0)
        seen.append(replay.residuals(started, gas, (), replay.defaults(()))[2000:])
    moved = np.std(seen[1] - seen[0], axis=0)
    assert moved[1] > 500.0
    assert moved[0] == 0.0
    assert unknown_words(bench.system, Unknown("gas", [_described(one)], ()))[1].endswith(
        "as effects.flexor_unknown_rate: gap uses it, controllers do not"
    )


EVEN, ONCE, SELDOM = np.full(12, 1e4), 1e5 * np.eye(12)[3], np.r_[8e4, 6e4, 5e4, 4e4, np.zeros(8)]


@pytest.mark.parametrize(
    ("seen", "unseen", "is_there"),
    [
        (EVEN, EVEN + 1e3 * np.arange(12), True),
        (EVEN, ONCE, False),
        (EVEN, 0.9 * SELDOM, True),
        (EVEN, 0.2 * SELDOM, False),
    ],
)
def test_a_curve_is_confirmed_over_blocks_of_time(seen, unseen, is_there, monkeypatch):
    one = object.__new__(curve_fit.CurveFit)
    one._groups, one._equation = ("training", "held out"), None
    falls = {"training": seen, "held out": unseen}
    monkeypatch.setattr(curve_fit, "block_sums", lambda group, *_: falls[group])
    fitted = SimpleNamespace(left=(np.zeros(1), np.zeros(1)))
    assert one.confirmed(fitted, fitted) == is_there


def test_a_curve_over_the_angle_is_no_gain_by_which_the_replay_follows(bench, monkeypatch):
    """A line over the recorded angle, and a stiffness far off that undoes it in the model, fit anything."""
    rng, n = np.random.default_rng(2), 3000
    residual = 5 * rng.standard_normal(n)
    angle = 0.6 + 0.5 * np.sin(np.arange(n) / 90)
    one = object.__new__(curve_fit.CurveFit)
    one._groups = (SimpleNamespace(system=bench.system),) * 2
    one._weight, one._deviation = np.ones(1), np.zeros(1)
    stiffness = 0.02 * residual - angle  # the model's angle is not quite the recorded one
    one._slopes, one._residuals = [(stiffness[None], np.zeros(1, int))] * 2, [residual] * 2
    knots = np.column_stack(signals.hats(angle, 0.1, 1.1, 8))
    monkeypatch.setattr(one, "_column", lambda group, spline, able: knots @ able)
    one._without = one.fit(())
    spline = curve_fit.Spline("angle", bench.system.entries_of("angle")[0], "angle", 8)
    assert abs(one.reduced(one.fit((spline,)))) < 0.05
    monkeypatch.setattr(curve_fit, "FAR", 1e3)
    assert one.reduced(one.fit((spline,))) > 0.9


def test_what_drifts_in_a_valve_is_described_as_its_gain_over_time(diagnostics, tmp_path):
    """A model file carries it, and its replay lacks less; controllers leave it alone."""
    system, training, held_out = diagnostics(4711, "clean", "medium", ["drifting_valve_gain"], outside=True)
    start = beginning.begin(system, [training], [held_out], load().gap)
    (gas,) = (one for one in system.equations if one.name == "gas")
    (one,) = description.described(start.problem, start.held_out, start.null, gas)
    assert (one.channel, one.entry.name, one.coordinate) == (
        "extensor_pressure", "extensor valve gain", "time"
    )  # fmt: skip
    assert one.reduced > 0.9
    risen = 0.12 / 30 * (one.places[-1] - one.places[0])  # medium size, drawn within -15 and +20 %
    assert 0.8 * risen < 2 * one.amplitude[0] < 1.25 * risen
    path = tmp_path / "model.yaml"
    patch.write(path, patch.of_description(system, one))
    model = cases.nominal().changed(patch.read_nominal(path))
    assert effects.known(model, "opening") == ()
    after = beginning.begin(knee(model), [training], [held_out], load().gap)
    gaps = [over_noise(b.system, b.recalibrated(), b.floor)["gas"] for b in (start, after)]
    assert gaps[0] > 1.4
    assert gaps[1] == pytest.approx(1.0, abs=0.1)


class Curves:
    """Fits of which the shares are given: (curves, as (channel, signal)) -> share."""

    share = staticmethod(lambda *over: 0.0)

    def __init__(self, *_):
        pass

    def fit(self, splines):
        return SimpleNamespace(splines=splines)

    def reduced(self, found):
        return self.share(*((one.channel, one.signal) for one in found.splines))

    def best(self, fixed, term):
        splines = tuple(curve_fit.Spline(*place, 8) for place in term)
        return self.reduced(self.fit((*fixed, *splines))), splines

    def confirmed(self, found, fewer):
        return True

    def moved(self, found):
        return {}

    def is_own(self, spline):
        return False

    def curve(self, found, index):
        return np.linspace(3, 5, 8), np.linspace(-0.1, 0.1, 8), 1e-4 * np.eye(8)


@pytest.fixture
def of_gas(bench, monkeypatch):
    """Return (shares of curves) -> how the gas equation is described."""
    monkeypatch.setattr(description, "CurveFit", Curves)
    monkeypatch.setattr(bench.replay.workers, "forked", lambda work, items: [work(one) for one in items])
    run = Run(bench.system, bench.recording(1), 40.0)
    problem = Problem(bench.replay, [Scored(run, Whitener({}), 100)])

    def described(share):
        monkeypatch.setattr(Curves, "share", staticmethod(share))
        return description.described(problem, problem, None, bench.system.equations[1])

    return described


def shares(flexor, extensor):
    """Return shares that each muscle's curve over the other one's voltage removes, all others 0.1 in all."""
    own = {("flexor_pressure", "extensor_voltage"): flexor, ("extensor_pressure", "flexor_voltage"): extensor}
    return lambda *over: sum(own[one] for one in over if one in own) or 0.1 * bool(over)


def test_of_two_muscles_each_has_a_curve(bench, of_gas, monkeypatch):
    """Neither curve alone removes half of the gap; a third one has no channel left."""
    both = of_gas(shares(0.4, 0.35))
    found = Unknown("gas", both, ())
    seen = {one.channel: (one.coordinate, one.reduced) for one in both}
    assert seen == {
        "flexor_pressure": ("extensor_voltage", pytest.approx(0.4)),
        "extensor_pressure": ("flexor_voltage", pytest.approx(0.35)),
    }
    words = short(bench.system, found)
    assert words.endswith(" and unknown rate of extensor pressure over flexor voltage (0.1 Pa/s)")
    told = unknown_as_dict(bench.system, found)
    assert [told["curve"]["channel"], told["other_curves"][0]["channel"]] == list(seen)
    assert of_gas(shares(0.25, 0.24)) == ()
    assert len(of_gas(shares(0.9, 0.35))) == 1  # less is left than another has to remove
    monkeypatch.setattr(Curves, "confirmed", lambda *_: False)  # by chance
    assert of_gas(shares(0.4, 0.35)) == ()


def test_what_passes_between_actuators_is_described_over_both_pressures(of_gas):
    """By two curves of each, which a model file can carry; no single one tells as much as the angle does."""

    def leak(*over):
        pressures = [{s for c, s in over if c == channel and s.endswith("pressure")} for channel in sides]
        angles = [any(c == channel and s == "angle" for c, s in over) for channel in sides]
        return sum(0.48 * (len(p) == 2) or 0.42 * a for p, a in zip(pressures, angles, strict=True))

    sides = ("extensor_pressure", "flexor_pressure")
    found = of_gas(leak)
    assert [(one.channel, one.coordinate) for one in found] == [(a, b) for a in sides for b in sides]
    assert [one.reduced for one in found] == pytest.approx([0.24] * 4)
    assert found[0].runner_up is None, "its share is of both curves together"
    assert len({one.entry.held for one in found}) == 4


def test_a_signal_that_another_stood_in_for_is_found_beside_the_others(of_gas):
    """Alone, the time removes more; beside what the other muscle lacks, the voltage does."""

    def cross_talk(*over):
        flexor = 0.3 * (("flexor_pressure", "extensor_voltage") in over)
        voltage = ("extensor_pressure", "flexor_voltage") in over
        time = ("extensor_pressure", "time") in over
        return flexor + max(0.6 * voltage * bool(flexor) or 0.4 * voltage, 0.5 * time)

    seen = [(one.channel, one.coordinate) for one in of_gas(cross_talk)]
    assert seen == [("extensor_pressure", "flexor_voltage"), ("flexor_pressure", "extensor_voltage")]


@pytest.mark.parametrize(
    ("angle", "pressure", "pair", "chosen"),
    [
        (0.43, 0.30, 0.42, 2),  # the angle is not of the gas; the recordings hardly tell them apart
        (0.50, 0.30, 0.42, 0),
        (0.43, 0.41, 0.42, 1),  # a second curve has to add something
    ],
)
def test_of_signals_that_do_as_well_those_of_the_equation_are_taken(bench, angle, pressure, pair, chosen):
    entry, gas = bench.system.entries_of("flexor_pressure")[0], bench.system.equations[1]
    own = description.own_signals(bench.system, gas)
    assert own == {"extensor_pressure", "flexor_pressure", "extensor_voltage", "flexor_voltage"}
    assert description.own_signals(bench.system, bench.system.equations[0]) == {"angle", "velocity"}
    over = ["angle"], ["flexor_pressure"], ["extensor_pressure", "flexor_pressure"]
    terms = [tuple(curve_fit.Spline("flexor_pressure", entry, name, 8) for name in names) for names in over]
    best = description._best(list(zip((angle, pressure, pair), terms, strict=True)), 0.1, own)
    assert best.splines == terms[chosen]
    assert best.share == pytest.approx((angle, pressure, pair)[chosen] - 0.1)


def test_where_hardly_anything_is_left_nothing_is_said(reported):
    assert reported(lambda angle, time: 0.0 * angle) is None


def test_a_curve_that_is_no_wave_has_no_period():
    places, sure = np.linspace(0.0, 1.0, 20), np.ones(20)
    assert waves.wave_period(places, np.exp(-(((places - 0.5) / 0.1) ** 2)), sure) is None
    assert waves.wave_period(places, 3 * places + 1, sure) is None
    assert waves.wave_period(places, np.sin(8 * places), sure) is None  # too little of it is seen
    assert waves.wave_period(places, np.abs(places - 0.45) ** 0.5, sure) is None  # arcs at a cusp
    assert waves.wave_period(np.zeros(20), np.zeros(20), sure) is None


def test_a_wave_is_as_large_as_its_waves_whatever_its_ends_do():
    places, rng = np.linspace(0, 2, 40), np.random.default_rng(4)
    spread = np.where((places < 0.1) | (places > 1.9), 0.5, 0.05)
    found = []
    for _ in range(200):
        curve = 0.3 * np.sin(9 * places + 1) + spread * rng.standard_normal(40)
        found.append(waves.wave_amplitude(places, curve, np.diag(spread**2), 2 * np.pi / 9))
    sizes, variances = np.array(found).T
    assert sizes.mean() == pytest.approx(0.3, rel=0.02)
    assert np.mean(np.abs(sizes - 0.3) < 1.96 * np.sqrt(variances)) > 0.9
    assert np.sqrt(variances.mean()) == pytest.approx(sizes.std(), rel=0.15)


def test_a_wave_has_its_period_though_some_places_were_hardly_visited():
    places = np.linspace(0.0, 1.0, 20)
    spread = np.where(places > 0.6, 0.5, 0.01)
    wrong = np.where(places > 0.6, np.random.default_rng(4).normal(0.0, 0.5, 20), 0.0)
    period = waves.wave_period(places, np.sin(17 * places) + wrong, spread)
    assert period == pytest.approx(2 * np.pi / 17, rel=0.05)
    assert waves.wave_period(places, np.sin(17 * places) + wrong, np.ones(20)) is None


def test_what_few_places_tell_is_no_wave():
    """Almost any wave goes through the five places at which a recording rests."""
    places, spread = np.linspace(0.0, 1.0, 8), np.full(8, 0.15)
    spread[[1, 3, 5, 6, 7]] = 0.012
    draw = np.random.default_rng(1)
    steps = [(places > 0.5) + draw.normal(0.0, spread) for _ in range(8)]
    assert not any(waves.wave_period(places, step, spread) for step in steps)


def test_a_signal_that_judges_where_nothing_was_fitted_is_no_coordinate(monkeypatch):
    """A curve over time, fitted to three quarters, says nothing of the last one."""
    shown = {
        "first": {"time": np.arange(3.0), "angle": np.arange(3.0), "phase": np.zeros(3)},
        "last": {"time": np.arange(3.0, 5.0), "angle": np.arange(2.0), "phase": np.zeros(2)},
    }
    monkeypatch.setattr(description, "signals_of", lambda system, one: shown[one])
    groups = [SimpleNamespace(system=None, scored=[name]) for name in shown]
    assert description._coordinates(groups) == ["angle"]
    assert description._coordinates(groups[:1] * 2) == ["angle", "time"]
