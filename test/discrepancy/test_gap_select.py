# SPDX-License-Identifier: Apache-2.0
"""What the search asks of a further effect."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.discrepancy.fitting.candidates import Candidate, Trial, secant_gain
from pam_orthosis.discrepancy.fitting.fit import Block, Fit, score
from pam_orthosis.discrepancy.fitting.fit import _descended as descended
from pam_orthosis.discrepancy.fitting.free import Free
from pam_orthosis.discrepancy.search import (
    acceptance,
    elimination,
    exchange,
    screening,
    second_chance,
    select,
    selection,
)
from pam_orthosis.discrepancy.search.findings import QUANTILE
from pam_orthosis.discrepancy.systems.system import System
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.model.effects.base import Effect, Quantity
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import silent

SETTINGS = load().gap.evidence
TORQUE = ("muscle_hysteresis", "joint_friction", "extra_foot_mass", "backlash")
EQUATIONS = {name: {"torque"} for name in TORQUE}


def touched(name):
    return EQUATIONS.get(name, {"gas"})


def found_so_far(evidence, alike, present=None):
    problem = SimpleNamespace(
        replay=SimpleNamespace(touched=touched, workers=Workers(1)),
        system=SimpleNamespace(
            catalogue=KNEE.catalogue, shapes=(), recalibrating=lambda _: "", moved_by=lambda _: None
        ),
    )
    problem.system.taken = partial(System.taken, problem.system)
    return selection.Selection(
        problem, None, problem, None, evidence=evidence, alike=alike, present=present or {}
    )


def asked(found, name):
    return selection.threshold(found, name, SETTINGS)


def test_what_could_pass_for_a_large_effect_needs_more_evidence_beside_it():
    found = found_so_far({"muscle_hysteresis": 60_000.0}, {"muscle_hysteresis": {"joint_friction": 0.8}})
    assert asked(found, "joint_friction") == pytest.approx(0.08 * 60_000)
    assert asked(found, "extra_foot_mass") == pytest.approx(0.003 * 60_000)
    assert asked(found, "extensor_leak") == SETTINGS.threshold
    same = found_so_far({"muscle_hysteresis": 60_000.0}, {"muscle_hysteresis": {"joint_friction": 7.0}})
    assert asked(same, "joint_friction") == pytest.approx(0.1 * 60_000)


@pytest.mark.parametrize(
    ("small", "large", "alike", "needed"),
    [
        (80.0, 4500.0, 0.98, 0.1 * 0.98 * 29_000),
        (80.0, 4500.0, 0.01, 0.1 * 0.01 * 29_000),
        (4600.0, 4500.0, 0.98, 0.003 * 3000),
    ],
)
def test_what_was_added_for_a_larger_effect_needs_more_beside_it(small, large, alike, needed):
    """Friction stood for the hysteresis that was added later; what its exact form leaves held it."""
    found = found_so_far(
        {"joint_friction": small, "muscle_hysteresis": large},
        {"joint_friction": {"muscle_hysteresis": alike}, "muscle_hysteresis": {}},
    )
    found.entered = {"joint_friction": 29_000.0, "muscle_hysteresis": 3000.0}
    assert asked(found, "joint_friction") == pytest.approx(max(needed, SETTINGS.threshold))
    assert asked(found, "muscle_hysteresis") == pytest.approx(max(0.1 * alike * small, SETTINGS.threshold))


def test_what_a_model_had_before_is_taken_for_alike():
    found = found_so_far({}, {}, {"muscle_hysteresis": (60_000.0, frozenset({"torque"}))})
    assert asked(found, "extra_foot_mass") == pytest.approx(0.1 * 60_000)


def test_beside_what_chance_decides_anything_needs_a_tenth():
    found = found_so_far({"backlash": 60_000.0}, {"backlash": {}})
    assert asked(found, "extra_foot_mass") == pytest.approx(0.1 * 60_000)


def test_where_the_weakest_effect_is_kept_the_next_one_is_asked(monkeypatch):
    found = found_so_far(dict.fromkeys(TORQUE[:3], 50.0), {name: {} for name in TORQUE[:3]})
    losses = {
        "muscle_hysteresis": (60_000.0, None),
        "joint_friction": (1.0, None),
        "extra_foot_mass": (5.0, None),
    }
    monkeypatch.setattr(elimination, "_seen_in_silence", lambda _, name, *rest: name == "joint_friction")
    assert elimination._weakest(found, losses, SETTINGS) == "extra_foot_mass"
    monkeypatch.setattr(elimination, "_seen_in_silence", lambda *_: True)
    assert elimination._weakest(found, losses, SETTINGS) is None


def test_gains_of_a_round_show_what_is_alike():
    gains = {"muscle_hysteresis": 500.0, "joint_friction": 400.0, "extensor_leak": 1.0}
    step = SimpleNamespace(accepted="muscle_hysteresis", gains=gains)
    assert select._alike(step)["joint_friction"] == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("first", "alike", "own", "evidence", "against", "put"),
    [
        (2800.0, 0.8, 1300.0, 3100.0, 0.0, True),
        (2800.0, 0.8, 1300.0, 1310.0, 0.0, False),  # no better
        (2800.0, 0.8, -90.0, -20.0, 0.0, False),  # better than nothing, but worth no name
        (2800.0, 0.3, 1300.0, 3100.0, 0.0, False),  # it was nothing like it
        (9e5, 0.8, 1300.0, 3100.0, 0.0, False),  # chosen when nothing larger was missing
        (2800.0, 0.8, 1300.0, 3100.0, 10.0, False),  # held-out recordings speak for the first one
    ],
)
@pytest.mark.parametrize("beside", [(), ("extensor_leak",)])  # the same round may add a small one
def test_what_was_chosen_before_a_larger_effect_was_known_may_be_what_resembles_it(
    monkeypatch, first, alike, own, evidence, against, put, beside
):
    """The gain of one sensor stood for that of the other one while friction bent the fit."""
    gain, friction, rival = "extensor_pressure_gain", "joint_friction", "flexor_pressure_gain"
    names = (gain, friction, *beside)
    like = {rival: alike, friction: 0.9, "creep": 0.2}
    found = found_so_far(dict.fromkeys(names, 1.0), {gain: like, friction: {}})
    found.entered = dict(zip(names, (first, 200_000.0, 20.0), strict=False))
    found.final = SimpleNamespace(effects=names)
    problem = SimpleNamespace(weighted=lambda _: None, weights={})
    base = SimpleNamespace(effects=names[1:], hessian=np.eye(1))
    for name, stand_in in {
        "loss": lambda *_: (1300.0, base),
        "_candidates": lambda problem, base, name: [name],
        "fitted_with": lambda _, base, name: (problem, SimpleNamespace(effects=(*base.effects, name))),
        "weighed": lambda _, __, models: [
            (own if one.effects == names else evidence, problem, one) for _, one in models
        ],
        "confirmed": lambda *_: SimpleNamespace(fall=-against),
        "accepted": lambda _, __, ___, able, ranked, gains: SimpleNamespace(
            accepted=able[0][2].effects[-1], ranked=ranked, gains=gains
        ),
    }.items():
        monkeypatch.setattr(exchange, name, stand_in)
    found.final_problem = problem
    step = exchange.exchanged(found, (gain,), problem, SETTINGS, silent)
    assert (step is not None) == put
    if step is not None:
        assert step.accepted == rival
        assert step.ranked == ((rival, evidence), (gain, own))
        assert select._alike(step) == pytest.approx({**like, rival: 1.0, gain: own / evidence})
    assert exchange.exchanged(found, names, problem, SETTINGS, silent) is None  # nothing was added
    base.hessian = np.full((1, 1), np.nan)  # the model without it goes astray
    assert exchange.exchanged(found, (gain,), problem, SETTINGS, silent) is None


def test_a_model_that_goes_astray_has_no_way_down():
    """Its derivatives overflow; what it lacks has the evidence with which it was added."""
    one = Free("mass", 1.0, 0.0, 2.0, 0.1)
    values, residual = {"mass": 1.0}, np.full(3, 1e160)
    blocks = {"force": Block(residual, np.full((3, 1), 1e200), ("mass",))}
    problem = SimpleNamespace(
        system=SimpleNamespace(equations=(), shapes=()), weights={"force": 1.0}, residuals=lambda *_: {}
    )
    assert descended(problem, (), values, [one], blocks) == (values, 0.0, {"force": residual})
    lost = Fit((), values, np.inf, np.eye(1), (one,), 3, blocks)
    assert (
        score(SimpleNamespace(**{**vars(problem), "residuals": lambda *_: {"force": residual}}), lost)
        == np.inf
    )


def test_a_part_of_what_is_named_takes_no_place():
    """The scale of a muscle's force is the level of its force map's misfit."""
    shares = {"extensor_force_scale": 0.9, "creep": 0.7}
    found = found_so_far({"parallel_elasticity": 1.0}, {"parallel_elasticity": shares})
    for effects, rivals in ((), ["extensor_force_scale", "creep"]), (("force_map_misfit",), ["creep"]):
        found.final = SimpleNamespace(effects=("parallel_elasticity", *effects))
        assert exchange._rivals(found, "parallel_elasticity") == rivals


def candidates(**evidence):
    return [Candidate(name, value + 30.0, {}, value, {}, (name,)) for name, value in evidence.items()]


def test_a_candidate_that_cannot_reach_its_bar_neither_is_fitted_nor_hides_the_next():
    problem = SimpleNamespace(replay=SimpleNamespace(touched=touched), weights={"torque": 1.0, "gas": 1.0})
    ranked = candidates(joint_friction=300.0, extra_foot_mass=60.0, extensor_leak=-25.0)
    thresholds = {"joint_friction": 4000.0, "extra_foot_mass": 15.0, "extensor_leak": 15.0}
    chosen = screening.worth_polishing(problem, ranked, thresholds)
    assert [one.name for one in chosen] == ["extra_foot_mass"]
    # residuals that weigh little now may weigh more with the effect
    problem.weights = {"torque": 0.2, "gas": 1.0}
    assert "joint_friction" in [one.name for one in screening.worth_polishing(problem, ranked, thresholds)]


def test_what_needs_no_lift_is_fitted_in_full_whatever_promises_more():
    problem = SimpleNamespace(replay=SimpleNamespace(touched=touched), weights={"torque": 0.2, "gas": 0.2})
    ranked = candidates(
        joint_friction=400.0, extra_foot_mass=390.0, muscle_hysteresis=380.0, extensor_leak=30.0
    )
    thresholds = {one.name: 4000.0 for one in ranked} | {"extensor_leak": 15.0}
    assert [one.name for one in screening.worth_polishing(problem, ranked, thresholds)][-1] == "extensor_leak"


@pytest.mark.parametrize(("larger", "counted"), [("backlash", 20_000.0), ("muscle_hysteresis", 2000.0)])
def test_beside_play_the_upper_limit_of_its_evidence_counts(larger, counted):
    """Added while a late sensor hid it, it has little: what its chance leaves was called a friction."""
    found = found_so_far({larger: 20_000.0}, {larger: {"joint_friction": 1.0}})
    found.entered = {larger: 2000.0}
    assert asked(found, "joint_friction") == pytest.approx(0.1 * counted)


def test_only_what_larger_effects_of_this_search_keep_out_is_looked_for_in_their_silence():
    found = found_so_far({"valve_delay": 60_000.0}, {"valve_delay": {}})
    found.final = SimpleNamespace(samples=20_000)
    gains = {"extensor_leak": 60.0, "polytropic_exponent": 20.0}
    thresholds = {name: asked(found, name) for name in gains}
    assert list(selection.blocked(found, thresholds, gains, (), SETTINGS)) == ["extensor_leak"]
    found.present["supply_sag"] = (1000.0, frozenset({"gas"}))  # asks 100: it is there to stay
    assert selection.blocked(found, thresholds, gains, (), SETTINGS) == {}
    found.apart["extensor_leak"] = frozenset({"valve_delay"})
    found.present.clear()
    assert asked(found, "extensor_leak") == SETTINGS.threshold


@pytest.mark.parametrize(("rival", "chosen"), [(300.0, "angle_gain"), (100.0, "extra_foot_mass")])
def test_what_only_a_larger_effect_keeps_out_competes_where_that_one_is_silent(monkeypatch, rival, chosen):
    """A sensor's gain beside a lag of the valves shows in both equations; a mass would explain it in one."""
    found = found_so_far({"valve_lag": 60_000.0}, {"valve_lag": {}})
    step = selection.Step("extra_foot_mass", None, None, 270.0, 4.0, (), "accepted", blocked=("angle_gain",))
    shown = {"angle_gain": rival, "extra_foot_mass": 200.0}
    way = second_chance.IN_SILENCE._replace(evidence=lambda problem, base, names, large: shown)
    monkeypatch.setattr(second_chance, "IN_SILENCE", way)
    monkeypatch.setattr(second_chance.quiet, "beside", lambda *_: None)
    other = replace(step, accepted="angle_gain", evidence=400.0)
    results = {"Projection": None, "weighed": [(400.0, None, None)], "accepted": other}
    for name, result in results.items():
        monkeypatch.setattr(second_chance, name, lambda *_, result=result: result)
    monkeypatch.setattr(second_chance.refit, "refitted", lambda *_: None)
    assert second_chance.or_in_silence(found, None, step, SETTINGS, silent).accepted == chosen
    assert [one.accepted for one in found.steps] == ([None] if chosen == "angle_gain" else [])


SHOWS = second_chance.IN_ANY_FORM.sure * SETTINGS.threshold


@pytest.mark.parametrize(
    ("larger", "alike", "evidence", "named"),
    [
        ("joint_friction", 0.9 * second_chance.ALIKE, SHOWS + 1, True),
        ("joint_friction", 0.9 * second_chance.ALIKE, SHOWS - 1, False),
        ("joint_friction", 1.1 * second_chance.ALIKE, SHOWS + 1, False),
        (
            "muscle_hysteresis",
            1.1 * second_chance.ALIKE,
            SHOWS + 1,
            True,
        ),  # a promise that a fit did not keep
        ("backlash", 0.0, SHOWS + 1, False),  # chance decides what is left of it
        ("force_map_misfit", 0.0, SHOWS + 1, False),
    ],
)
def test_a_small_effect_that_no_form_of_the_larger_one_does_is_added(
    monkeypatch, larger, alike, evidence, named
):
    found = found_so_far({larger: 60_000.0}, {larger: {"extra_foot_mass": alike}})
    found.problem.system.shapes = ("force_map_misfit",)
    found.fitted = {"muscle_hysteresis": {"extra_foot_mass": 0.9 * second_chance.ALIKE}}
    monkeypatch.setitem(EQUATIONS, "force_map_misfit", {"torque"})
    kept = ("extra_foot_mass",)
    step = selection.Step(None, None, None, 80.0, 0.0, (), "too little evidence", blocked=kept)
    way = second_chance.IN_ANY_FORM._replace(
        evidence=lambda problem, base, names, large: dict.fromkeys(names, evidence)
    )
    monkeypatch.setattr(second_chance, "IN_ANY_FORM", way)
    results = {"Projection": None, "weighed": [(80.0, None, None)]}
    results["accepted"] = replace(step, accepted="extra_foot_mass")
    for name, result in results.items():
        monkeypatch.setattr(second_chance, name, lambda *_, result=result: result)
    monkeypatch.setattr(second_chance.quiet, "beside", lambda *_: None)
    monkeypatch.setattr(second_chance.refit, "refitted", lambda *_: None)
    other = second_chance.or_in_any_form(found, None, step, SETTINGS, silent)
    assert other.accepted == ("extra_foot_mass" if named else None)
    assert found.steps == ([step] if named else [])
    assert asked(found, "extra_foot_mass") == SETTINGS.threshold if named else not found.apart


@pytest.mark.parametrize(
    ("loss_of_second", "empty"), [(4.0, ()), (5000.0, ("muscle_hysteresis.sliding_distance",))]
)
def test_the_one_that_is_left_is_valued_without_the_dropped_one(monkeypatch, loss_of_second, empty):
    """Dropped for its evidence, or since its parameters make it another effect, whatever its evidence."""
    found = found_so_far({"joint_friction": 9000.0, "muscle_hysteresis": 40.0}, {})
    found.alike = {name: {} for name in found.evidence}
    found.entered = dict(found.evidence)
    both = tuple(found.evidence)
    found.final = SimpleNamespace(effects=both)
    losses = {
        both: dict(zip(both, (16.0, loss_of_second), strict=True)),
        both[:1]: {"joint_friction": 9050.0},
    }

    def loss(found, name):
        effects = tuple(one for one in found.final.effects if one != name)
        return losses[found.final.effects][name], SimpleNamespace(effects=effects, values={}, free=[])

    monkeypatch.setattr(elimination, "loss", loss)
    monkeypatch.setattr(elimination, "_seen_in_silence", lambda *_: False)
    monkeypatch.setattr(elimination, "emptied", lambda system, name, model: empty if name == both[1] else ())
    monkeypatch.setattr(
        elimination, "fit_tempered", lambda problem, effects, *_: (problem, SimpleNamespace(effects=effects))
    )
    monkeypatch.setattr(elimination, "_unsized", lambda _: None)
    elimination.eliminate_weak(found, SETTINGS, silent)
    assert found.final.effects == ("joint_friction",)
    assert found.evidence == {"joint_friction": 9050.0}


@pytest.mark.parametrize(
    ("half", "kept"), [(0.5, ("constant_torque",)), (0.2, ("constant_torque",)), (0.7, ())]
)
def test_what_may_as_well_have_no_size_is_not_named(monkeypatch, half, kept):
    """Free parameters can hide all of it: a model without it is as likely, whatever the evidence says."""
    found = found_so_far({"constant_torque": 41.0}, {"constant_torque": {}})
    found.null = SimpleNamespace(effects=())
    free = [SimpleNamespace(name="constant_torque.torque", lower=-50.0, upper=50.0)]
    values = {"constant_torque.torque": -0.6}
    found.final = SimpleNamespace(effects=("constant_torque",), values=values, free=free)
    monkeypatch.setattr(elimination, "covariance", lambda *_: None)
    monkeypatch.setattr(elimination, "deviations", lambda *_: np.array([half / QUANTILE]))
    elimination.eliminate_weak(found, SETTINGS, silent)
    assert found.final.effects == kept
    assert tuple(found.evidence) == kept


@pytest.mark.parametrize("beside", ["muscle_hysteresis.offset_share", "muscle_damping"])
def test_a_size_that_depends_on_a_detail_is_a_size(monkeypatch, beside):
    """What a recalibration could take over is none."""
    hysteresis = "muscle_hysteresis.half_width"
    found = found_so_far({"muscle_hysteresis": 12000.0}, {"muscle_hysteresis": {}})
    found.null = SimpleNamespace(effects=())
    free = [Free(name, 1.0, -np.inf, np.inf, np.inf) for name in (hysteresis, beside)]
    hessian = np.array([[1.0, 0.999], [0.999, 1.0]])
    values = {hysteresis: 12.0, beside: 0.5}
    found.final = Fit(("muscle_hysteresis",), values, 0.0, hessian, free, 100, {})
    monkeypatch.setattr(elimination, "covariance", lambda _, model: np.linalg.inv(model.hessian))
    monkeypatch.setattr(elimination, "deviations", lambda _, model, spread: np.sqrt(np.diag(spread)))
    elimination.eliminate_weak(found, SETTINGS, silent)
    assert bool(found.final.effects) == beside.startswith("muscle_hysteresis")


def starts_of(effect):
    """Return the start positions of a trial beside a model whose residual is a wave of 3 Hz."""
    equation = SimpleNamespace(name="dynamics", channels=("x",))
    wave = np.sin(2 * np.pi * 3.0 * 0.01 * np.arange(1000))[:, None]
    run = SimpleNamespace(recording=SimpleNamespace(samples=1000), period=0.01)
    problem = SimpleNamespace(
        system=SimpleNamespace(
            catalogue={effect.name: effect},
            shapes=(),
            equations=[equation],
            beside=lambda *_: (),
        ),
        replay=SimpleNamespace(
            touched=lambda _: {"dynamics"}, defaults=lambda _: {}, residuals=lambda *_: wave
        ),
        scored=[SimpleNamespace(run=run, white=lambda _, values: values)],
    )
    trial = Trial(SimpleNamespace(problem=problem, base=SimpleNamespace(effects=(), values={})), effect.name)
    return [dict(zip((q.name for q in effect.fitted), p * trial.scale, strict=True)) for p in trial.starts()]


def test_an_effect_says_itself_that_it_is_periodic():
    size = Quantity("size", 1.0, "N", 0.0, 50.0, "", 0.0)
    hertz, turn = Quantity("hertz", 1.0, "Hz", 0.01, 20.0, ""), Quantity("turn", 0.1, "rad", -7.0, 7.0, "")
    wave = Effect("hum", "force", (size, hertz, turn), None, "", "", periodic=("hertz", "turn"))
    assert {round(p["hertz"], 1) for p in starts_of(wave)} >= {1.0, 3.0}
    assert len({p["turn"] for p in starts_of(wave) if round(p["hertz"], 1) == 3.0}) == 4
    named = replace(wave, parameters=(size, replace(hertz, name="frequency")), periodic=None)
    assert {p["frequency"] for p in starts_of(named)} == {1.0}


def test_a_candidate_whose_replay_runs_away_gains_nothing():
    """Its residuals are finite, but not their squares."""
    base = SimpleNamespace(blocks={"torque": SimpleNamespace(residual=np.ones(9))})
    level = SimpleNamespace(solve=lambda right: right, gradient=lambda position: np.zeros(1))
    effect = SimpleNamespace(fitted=[SimpleNamespace(neutral=0.0, minimum=-1.0, maximum=1.0)])
    projection = SimpleNamespace(
        base=base, state=lambda _: (np.zeros(1), 9.0), correlated=lambda name, rows: np.zeros(1),
        problem=SimpleNamespace(system=SimpleNamespace(catalogue={"bold": effect})), levels=[level],
        position=None, cost_at=lambda *_: 9.0, floor=9.0,
    )  # fmt: skip
    for far, gain in ((2.0, 9.0), (1e155, 0.0)):
        trial = SimpleNamespace(name="bold", residuals=lambda _, far=far: {"torque": np.full(9, far)})
        with np.errstate(over="ignore"):
            assert secant_gain(projection, trial, np.zeros(1)) == pytest.approx(gain)


def test_what_an_effect_closes_counts_from_the_noise():
    """Of residuals that are hardly above the noise no model removes much."""
    blocks = {"torque": Block(np.zeros(100), np.zeros((100, 0)), ())}
    base, model = (SimpleNamespace(effects=names, values={}, blocks=blocks) for names in ((), ("creep",)))
    squares = {(): 480.0, ("creep",): 404.0}
    problem = SimpleNamespace(weights={"torque": 2.0}, total=lambda effects, values: squares[effects])
    assert acceptance._closed(problem, base, model) == pytest.approx(0.95)
    assert acceptance._closed(problem, model, base) < 0
    squares[()] = 400.0
    assert acceptance._closed(problem, base, model) == 0.0, "nothing is above the noise"
