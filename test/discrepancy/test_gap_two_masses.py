# SPDX-License-Identifier: Apache-2.0
"""Two masses with a spring and a damper between them: a system of several channels whose clocks may differ.

The recordings are exact samples of the linear system (matrix exponential).
"""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from scipy.signal import cont2discrete

from pam_orthosis.discrepancy.answer import patch, standing
from pam_orthosis.discrepancy.api import (
    Channel,
    Contribution,
    Effect,
    Input,
    Model,
    Parameter,
    Quantity,
    check_system,
    describe,
    find_gap,
    from_arrays,
)
from pam_orthosis.discrepancy.preparation import clocks
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.preparation.identifiability import identifiability
from pam_orthosis.discrepancy.recordings.stamps import skews
from pam_orthosis.discrepancy.replay.run import Run, Shift
from pam_orthosis.discrepancy.workflow import search
from pam_orthosis.model.parameters import load

PERIOD, SAMPLES, NOISE = 0.005, 5000, 3e-5  # s, -, m
TRUE = {"left": 1.02, "right": 0.49, "stiffness": 103.0, "damper": 0.5, "ground": 40.0, "air": 1.0}
UNITS = {"left": "kg", "right": "kg", "stiffness": "N/m", "damper": "N s/m", "ground": "N/m", "air": "N s/m"}
NOMINAL = {"left": 1.0, "right": 0.5, "stiffness": 100.0, "damper": 0.5, "ground": 40.0, "air": 1.0}


def _recording(system, seed, late=0, tilt=0.0, behind=0, phase=None, **changed):
    """Return a recording.

    The right position is `late` rows late, the right mass is pulled by `tilt`, N, and its force acts
    `behind` rows later than recorded. The left mass is pushed with 1.3 Hz in this phase, if in any.
    """
    p, random, time = TRUE | changed, np.random.default_rng(seed), PERIOD * np.arange(SAMPLES)
    k, c = p["stiffness"], p["damper"]
    left = np.array([-(k + p["ground"]), -(c + p["air"]), k, c]) / p["left"]
    right = np.array([k, c, -k, -c]) / p["right"]
    rates = np.array([[0, 1, 0, 0], left, [0, 0, 0, 1], right])
    given = np.array([[0, 0], [1 / p["left"], 0], [0, 0], [0, 1 / p["right"]]])
    step, push, *_ = cont2discrete((rates, given, np.eye(4), np.zeros((4, 2))), PERIOD)
    forces = np.zeros((SAMPLES, 2))
    for _ in range(8):
        waves = 2 * np.pi * random.uniform(0.1, 5.0, 2) * time[:, None] + random.uniform(0, 6, 2)
        forces += random.uniform(0.3, 1.0, 2) * np.sin(waves)
    pushed = 0.0 * time if phase is None else 0.2 * np.sin(2 * np.pi * 1.3 * time + phase)
    states = np.zeros((SAMPLES, 4))
    for i in range(SAMPLES - 1):
        acting = [forces[i, 0] + pushed[i], forces[np.clip(i - behind, 0, SAMPLES - 1), 1] + tilt]
        states[i + 1] = step @ states[i] + push @ acting
    seen = states[:, [0, 2]] + NOISE * random.standard_normal((SAMPLES, 2))
    seen[late:, 1] = seen[: SAMPLES - late, 1]
    signals = {"x": seen[:, 0], "y": seen[:, 1], "force": forces[:, 0], "other": forces[:, 1]}
    return from_arrays(f"run {seed}", system, {"time": time, **signals})


def _equations(s, p):
    s.between = p.stiffness * (s.x - s.y) + p.damper * (s.vx - s.vy)
    s.left_force = s.force - s.between - p.ground * s.x - p.air * s.vx
    return {
        "x": s.vx,
        "vx": s.left_force / p.left,
        "y": s.vy,
        "vy": (s.between + s.other) / p.right,
    }


def _system(**changed):
    level = Quantity("level", 0.3, "N", 0.0, 10.0, "dry friction", 0.0)
    friction = Effect(
        "friction",
        "left_force",
        (level,),
        lambda s, p, own: -p.level * np.tanh(s.vx / 0.005),
        "Rubs.",
        "test",
    )
    settings = {
        "name": "two masses",
        "channels": [Channel("x", "x", "m", "mm", 1e3), Channel("y", "y", "m", "mm", 1e3)],
        "inputs": [Input("force", "N"), Input("other", "N")],
        "states": ["x", "vx", "y", "vy"],
        "equations": _equations,
        "parameters": [Parameter(n, NOMINAL[n], UNITS[n], 0.05 * NOMINAL[n], n) for n in NOMINAL],
        "effects": [friction],
    }
    return Model(**(settings | changed)).system()


def _left(outcome, run):
    """Return how many times the noise a model with what was found leaves of a third recording."""
    better = outcome.system.changed(patch.changes_of(outcome))
    start = begin(better, [run], [], load().gap)
    return start.recalibrated().white["overall"] / start.floor.white["overall"]


def test_two_coordinates_of_one_clock_show_no_skew():
    """What a damper between them does is seen by the other one's velocity."""
    system = _system()
    assert skews(system, _recording(system, 1)) == []
    late = skews(system, _recording(system, 1, late=3))
    known = system.changed({"effects.y_delay.enabled": True, "effects.y_delay.delay": 0.015})
    assert skews(known, _recording(system, 1, late=3)) == []
    assert {one.channel for one in late} == {"y"}
    assert late[0].seconds == pytest.approx(-0.015, abs=3e-4)


@pytest.mark.parametrize(
    ("late", "changed"),
    [(2, {}), (0, {"right": 0.7}), (6, {"stiffness": 150.0}), (0, {"left": 1.6, "stiffness": 60.0})],
)
def test_a_late_channel_and_a_wrong_parameter_are_named(late, changed):
    system = _system()
    runs = [_recording(system, seed, late, **changed) for seed in (1, 2)]
    start = begin(system, runs[:1], runs[1:], load().gap)
    assert identifiability(start.problem, start.null, 15.0).together == (), "forces in N set the scale"
    outcome = search(start, load().gap)
    named = {one.name: next(iter(one.parameters.values())) for one in outcome.effects}
    expected = {"y_delay": PERIOD * late} if late else {}
    expected |= {f"wrong_{name}": value for name, value in changed.items()}
    assert outcome.verdict == ("explained" if late else "recalibrated")
    assert {name: value for name, (value, *_) in named.items()} == pytest.approx(expected, rel=0.01)
    assert all(("a wrong " + name) in describe(outcome) for name in changed)
    assert _left(outcome, _recording(system, 3, late, **changed)) < 1.1


@pytest.mark.parametrize("name", ["wrong_left", "inputs_delay", "force_delay", "x_delay"])
def test_what_a_model_has_under_such_a_name_is_meant_by_it(name):
    """Its `wrong_left` is no other value of `left`, though both have a `value`."""
    value = Quantity("value", 0.3, "N", 0.0, 10.0, "a pull", 0.0)
    pull = Effect(
        name, "left_force", (value,), lambda s, p, own: Contribution({"left_force": p.value}), "", ""
    )
    system = _system(effects=[pull])
    check_system(system)
    assert system.catalogue[name] is pull
    assert set(system.wrong) == {f"wrong_{one}" for one in NOMINAL} - {name}
    known = system.changed({f"effects.{name}.enabled": True, f"effects.{name}.value": 0.2})
    assert name not in known.catalogue
    assert (known.late, known.later, known.aged) == (0.0, {}, {}), "a pull is not late"


def test_a_parameter_without_tolerance_or_influence_is_no_candidate():
    exact = [Parameter(name, NOMINAL[name], UNITS[name], 0.0, name) for name in NOMINAL]
    system = _system(parameters=[*exact, Parameter("unused", 1.0, "m", 0.1, "nowhere")])
    assert not system.wrong
    late = {"inputs_delay", *(f"{name}_delay" for name in ("force", "other", "x", "y"))}
    lags = {f"{name}_lag" for name in ("force", "other", "x", "y")}
    assert set(system.catalogue) == {"friction", *late, *lags}  # a zero is a constant


def test_a_model_without_any_tolerance_is_searched_too():
    exact = [Parameter(name, NOMINAL[name], UNITS[name], 0.0, name) for name in NOMINAL]
    system = _system(parameters=exact)
    outcome = find_gap(system, *([_recording(system, seed, **NOMINAL)] for seed in (1, 2)))
    assert outcome.verdict == "none"


def test_a_constant_that_the_model_lacks_is_no_curve_over_a_signal():
    system = _system()
    runs = [[_recording(system, seed, **NOMINAL, tilt=0.1)] for seed in (1, 2)]
    start = begin(system, *runs, load().gap)
    outcome = search(start, load().gap)
    assert outcome.verdict == "described"
    (constant,) = [one for one in outcome.unknown.descriptions if one.channel == "y"]
    assert constant.is_constant
    assert constant.level == pytest.approx(0.2, rel=0.05)
    assert "unknown acceleration of y that is constant (0." in describe(outcome)
    assert _left(outcome, _recording(system, 3, **NOMINAL, tilt=0.1)) < 1.2
    assert standing.standing(start, outcome) is not None
    turned = [replace(one, level=-one.level) for one in outcome.unknown.descriptions]
    worse = replace(outcome, unknown=replace(outcome.unknown, descriptions=turned))
    mended = {one.channel: one for one in standing.standing(start, worse).unknown.descriptions}
    assert mended["y"].level == pytest.approx(0.2, rel=0.05)
    free = [replace(one, entry=replace(one.entry, held="")) for one in turned]
    unheld = replace(outcome, unknown=replace(outcome.unknown, descriptions=free))
    assert standing.standing(start, unheld) is unheld, "no model can be asked"
    assert "no model file can carry this description" not in describe(outcome)


def test_one_of_two_inputs_that_acts_late_is_named():
    """An amplifier of its own: the other force acts 15 ms later than it is stamped, or is stamped so."""
    system = _system()
    late, early = (
        search(begin(system, runs[:1], runs[1:], load().gap), load().gap)
        for runs in ([_recording(system, seed, behind=rows) for seed in (1, 2)] for rows in (3, -3))
    )
    assert [one.name for one in late.effects] == ["other_delay"]
    assert late.effects[0].parameters["delay"][0] == pytest.approx(0.015, abs=1e-4)
    assert late.verdict == "explained"
    assert _left(late, _recording(system, 3, behind=3)) < 1.1
    short = system.changed({"effects.other_delay.enabled": True, "effects.other_delay.delay": 0.025})
    runs = [_recording(short, seed, behind=3) for seed in (1, 2)]
    rest = search(begin(short, runs[:1], runs[1:], load().gap), load().gap)
    assert [one.name for one in rest.effects] == ["other_delay"]
    assert "beside the 25 ms that the model has (15" in describe(rest)
    assert patch.changes_of(rest)["effects.other_delay.delay"] == pytest.approx(0.015, abs=1e-4)
    assert early.effects == ()
    assert "looks as if other were stamped late: other_delay.delay = -0.015" in describe(early)


def test_an_input_that_is_later_than_the_others_is_held_by_its_mean():
    """A kernel knows one instant within a period at which inputs change."""
    system = _system()
    one, rows = _recording(system, 1), slice(100, 200)
    run, start = Run(system, one, 40.0), 3 * len(system.channels) - 2
    usual, later = (run.data(("x", "y"), Shift(later=more)) for more in ({}, {"other": 1.25 * PERIOD}))
    changed = sorted(set(np.flatnonzero(np.any(usual != later, axis=0))))
    assert changed == [start + 1, start + 3]
    recorded = one.signals["other"]
    mean = 0.75 * recorded[99:199] + 0.25 * recorded[98:198]
    assert later[rows, start + 1] == pytest.approx(mean)
    assert later[rows, start + 3] == pytest.approx(mean)


def test_a_periodic_push_has_a_phase_of_its_own_in_each_recording():
    """Recordings that are begun by hand know nothing of its phase."""
    push = Effect(
        "push",
        "left_force",
        (
            Quantity("amplitude", 0.1, "N", 0.0, 10.0, "amplitude", 0.0),
            Quantity("frequency", 1.0, "Hz", 0.01, 20.0, "frequency"),
            Quantity("phase", 0.0, "rad", -7.0, 7.0, "phase at the time 0"),
        ),
        lambda s, p, own: p.amplitude * ca.sin(2 * ca.pi * p.frequency * s.time + p.phase),
        "Somebody pushes.",
        "test",
        periodic=("frequency", "phase"),
    )
    system = _system(effects=[push])
    own, same = (
        search(begin(system, runs[:2], runs[2:], load().gap), load().gap)
        for runs in (
            [_recording(system, seed, phase=phase) for seed, phase in enumerate(phases, 1)]
            for phases in ((0.3, 2.6, -1.7), (0.3, 0.3, 0.3))
        )
    )
    for outcome in (own, same):
        assert [one.name for one in outcome.effects] == ["push"]
        found = {name: value for name, (value, *_) in outcome.effects[0].parameters.items()}
        assert found["amplitude"] == pytest.approx(0.2, rel=0.03)
        assert found["frequency"] == pytest.approx(1.3, abs=1e-3)
        assert outcome.verdict == "explained"
    said = "the recordings' clocks have no common zero"
    assert [any(one.startswith(said) for one in outcome.remarks) for outcome in (own, same)] == [True, False]
    assert search(begin(_system(), [_recording(system, 1)], [], load().gap), load().gap).verdict == "none"


def test_a_harmonic_of_the_motion_is_known_as_one():
    """Where all motion is one sine, what a model lacks shows at its harmonics."""
    time = PERIOD * np.arange(SAMPLES)
    motion = np.sin(2 * np.pi * 1.1 * time) + 0.1 * np.sin(2 * np.pi * 0.3 * time)
    orders = {
        frequency: clocks._harmonic(motion, PERIOD, frequency) for frequency in (1.1, 2.2, 3.31, 1.5, 0.55)
    }
    assert orders == {1.1: 1, 2.2: 2, 3.31: 3, 1.5: 0, 0.55: 0}
