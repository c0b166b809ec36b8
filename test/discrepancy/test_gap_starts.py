# SPDX-License-Identifier: Apache-2.0
"""A fit that went astray: neither does an effect get the credit for it, nor does it hide one."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from pam_orthosis.discrepancy.fitting import refit
from pam_orthosis.discrepancy.fitting.candidates import Candidate, Trial, candidate, twins
from pam_orthosis.discrepancy.fitting.fit import score
from pam_orthosis.discrepancy.fitting.projection import Projection
from pam_orthosis.discrepancy.preparation import beginning
from pam_orthosis.discrepancy.search import delays, second_chance, select
from pam_orthosis.discrepancy.search.delays import _with, or_for_delays
from pam_orthosis.discrepancy.search.screening import _different, shapes_astray, strained
from pam_orthosis.discrepancy.search.selection import Selection, Step
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import silent


def begun(bench, **plant):
    recordings = [bench.recording(seed, **plant) for seed in (1, 2)]
    problem, held_out, _ = beginning.prepared(bench.replay, recordings[:1], recordings[1:], load().gap)
    return *refit.recalibrated(problem, silent), held_out


def effect_on(name, **values):
    return {f"plant__effects__{name}__{key}": value for key, value in {"enabled": True, **values}.items()}


def test_what_tolerances_took_is_found_to_be_the_detail_of_a_spring(bench):
    """A linear spring leans on them: it fits as well here, and a motion that reaches farther refutes it."""
    spring = {"stiffness": 4.0, "rest_angle": 0.7, "hardening": 1.5}
    problem, null, _ = begun(bench, **effect_on("parallel_elasticity", **spring))
    projection = Projection(problem, null)
    trial = Trial(projection, "parallel_elasticity")
    one = candidate(projection, trial, trial.starts())
    _, plain = refit.fitted_with(problem, null, one)
    _, model = refit.refitted(problem, null, one, silent)
    assert plain.values["parallel_elasticity.stiffness"] > 6.0
    for name, value in spring.items():
        assert model.values[f"parallel_elasticity.{name}"] == pytest.approx(value, rel=0.1)


@pytest.fixture(scope="module")
def sound(bench):
    return begun(bench)


def torque(problem, base):
    projection = Projection(problem, base)
    trial = Trial(projection, "constant_torque")
    return candidate(projection, trial, trial.starts())


def with_torque(problem, base):
    return refit.refitted(problem, base, torque(problem, base), silent)


def test_equations_that_an_effect_leaves_alone_follow_the_nuisance_parameters(sound):
    problem, null, _ = sound
    projection = Projection(problem, null)
    moved = projection.position + 0.2
    values = {**null.values, **projection.values(moved)}
    known, linear = projection.state(problem.residuals((), values)), projection.state({}, moved)
    assert linear[1] > projection.state({})[1] + 1000.0
    assert linear[1] == pytest.approx(known[1], rel=0.02)
    assert linear[0] == pytest.approx(known[0], abs=0.02 * abs(known[0]).max())


def test_a_base_that_had_not_come_to_its_end_is_replaced_before_an_effect_is_added(sound):
    problem, null, _ = sound
    lost = replace(null, values={**null.values, "moving_mass": null.values["moving_mass"] + 0.5})
    weighted, model = with_torque(problem, null)
    found = Selection(problem, lost, problem, lost)
    evidence = score(problem, lost) - score(problem, model)
    assert evidence > 100, "an effect that is not there would have the credit"
    assert select._better_base(found, (evidence, weighted, model), silent)
    assert found.null is found.final
    assert score(problem, found.null) == pytest.approx(score(problem, null), abs=3.0)


def test_a_base_that_is_at_its_end_stays(sound):
    problem, null, _ = sound
    found = Selection(problem, null, problem, null)
    weighted, model = with_torque(problem, null)
    assert not select._better_base(found, (20.0, weighted, model), silent)
    assert found.final is null


@pytest.mark.parametrize(
    ("far", "astray", "first", "second", "chosen"),
    [
        (True, True, None, 5.0, "second"),
        (True, True, 4.0, 5.0, "second"),
        (True, True, 5.0, 4.0, "first"),
        (True, True, 5.0, None, "first"),
        (False, True, None, 5.0, None),
        (True, False, None, 5.0, None),
    ],
)
def test_without_shape_corrections_is_looked_where_these_went_astray(
    sound, monkeypatch, far, astray, first, second, chosen
):
    problem, null, held_out = sound
    steps = [step(name, problem, null, gain) for name, gain in (("first", first), ("second", second))]
    seen = iter(steps)
    monkeypatch.setattr(select, "_seen_from", lambda *_, **__: next(seen))
    monkeypatch.setattr(select, "is_far", lambda _: far)
    monkeypatch.setattr(select, "shapes_astray", lambda *_: astray)
    monkeypatch.setattr(select.refit, "unshaped", lambda *_: (problem, null))
    monkeypatch.setattr(
        select, "weighed", lambda _problem, _base, models: [(m.cost, p, m) for p, m in models]
    )
    found = select._round(Selection(problem, null, problem, null), held_out, load().gap.evidence, silent)
    assert found.accepted == chosen
    assert next(seen, None) is (None if far and astray else steps[1])


def step(name, problem, null, gain):
    if gain is None:
        return Step(None, None, None, 0.0, 0.0, (), "nothing")
    return Step(name, replace(null, cost=gain), problem, gain, 0.0, (), "accepted")


def test_a_second_look_leaves_all_unnamed_shape_corrections_out(sound):
    problem, null, _ = sound
    lost = replace(null, values={**null.values, "force_map_misfit.extensor_c00": 40.0})
    assert shapes_astray(problem.system, lost)
    assert not shapes_astray(problem.system, replace(lost, effects=("force_map_misfit",)))
    assert not shapes_astray(problem.system, null)
    _, plain = refit.unshaped(problem, lost, silent)
    assert {one.name.partition(".")[0] for one in plain.free}.isdisjoint(problem.system.shapes)
    assert plain.values["force_map_misfit.extensor_c00"] == 0.0
    _, named = refit.unshaped(problem, replace(lost, effects=("force_map_misfit",)), silent)
    assert any(one.name == "force_map_misfit.extensor_c00" for one in named.free)


@pytest.mark.parametrize("named", [(), ("force_map_misfit",)])
def test_a_fit_that_shape_corrections_hold_fast_starts_anew_without_those_that_have_no_name(
    sound, monkeypatch, named
):
    problem, null, _ = sound
    key, fitted, starts = "force_map_misfit.extensor_c00", refit.fitted_with, []

    def held_fast(problem, base, one):
        starts.append(one.values[key])
        weighted, model = fitted(problem, base, one)
        if not one.values[key]:
            return weighted, model
        lost = replace(model, values={**model.values, key: 40.0})
        return problem.weighted(dict.fromkeys(problem.weights, 0.1)), lost

    monkeypatch.setattr(select, "fitted_with", held_fast)
    one = torque(problem, null)
    one = replace(one, values={**one.values, key: 40.0})
    ((weighted, model),) = select._refitted_all(problem, replace(null, effects=named), [one], silent)
    assert starts == ([40.0] if named else [40.0, 0.0])
    assert (model.values[key] == 40.0) == bool(named)
    assert (min(weighted.weights.values()) > 0.5) != bool(named)
    starts.clear()
    shapes = [name for name in one.values if name.partition(".")[0] in problem.system.shapes]
    plain = replace(one, values={**one.values, **dict.fromkeys(shapes, 0.0)})
    posed = problem.weighted(dict.fromkeys(problem.weights, 0.1))
    monkeypatch.setattr(select, "is_far", lambda _problem: True)
    monkeypatch.setattr(select, "shapes_astray", lambda *_: True)
    select._refitted_all(posed, replace(null, effects=named), [plain], silent)
    assert starts == [0.0]  # it has begun without them


def test_a_sensor_that_only_strained_tolerances_give_to_the_other_muscle_is_that_of_its_own(bench):
    name = "extensor_pressure_gain"
    hidden = {"enabled": True, "gain": 1.1}
    problem, null, _ = begun(bench, **{f"plant__effects__{name}__{key}": v for key, v in hidden.items()})
    projection = Projection(problem, null)
    trial = Trial(projection, "flexor_pressure_gain")
    other = candidate(projection, trial, trial.starts())
    judged = select._judged(problem, null, (problem, null), [other], silent)
    assert [model.effects for *_, model in judged] == [(name,), (other.name,)]
    assert judged[0][2].values[f"{name}.gain"] == pytest.approx(1.1, abs=0.005)
    assert strained(judged[1][2])
    assert not strained(judged[0][2])


def test_twins_are_the_same_effect_of_another_actuator(bench):
    named = bench.system.twins
    assert named("extensor_leak") == ("flexor_leak",)
    assert named("flexor_pressure_delay") == ("extensor_pressure_delay",)
    assert not any(named(name) for name in ("joint_friction", "angle_gain", "valve_delay", "leg_masses"))


def test_a_twin_that_the_model_has_already_is_not_tried_again(sound):
    problem, null, _ = sound

    def tried(*known):
        around = SimpleNamespace(problem=problem, base=replace(null, effects=known))
        return [one.name for one in twins(around, replace(null, effects=(*known, "extensor_leak")))]

    assert set(tried()) == {"flexor_leak"}
    assert not tried("flexor_leak")


def test_effects_that_move_together_are_fitted_once(sound):
    problem, null, _ = sound
    known = (*null.effects, "valve_delay")
    around = SimpleNamespace(problem=problem, base=replace(null, effects=known, values=null.values))
    both = replace(null, effects=(*known, "flexor_pressure_delay", "extensor_pressure_delay"))
    assert not twins(around, both)
    alone = replace(null, effects=(*known, "extensor_pressure_delay"))
    assert {one.name for one in twins(around, alone)} == {"flexor_pressure_delay"}
    pair = ("extensor_pressure_delay", "flexor_pressure_delay")
    ranked = [
        Candidate(name, 9.0, {}, 9.0, {}, names)
        for name, names in zip((*pair, "creep"), (pair, pair[::-1], ("creep",)), strict=True)
    ]
    assert _different(ranked) == [ranked[0], ranked[2]]


def test_all_sensors_are_not_tried_beside_a_dead_time_and_all_but_one(sound, monkeypatch):
    """They are the same model, counted from the one that is left out."""
    problem, null, held_out = sound
    asked = []
    sensors = delays._sensors(problem.replay)
    late = replace(null, values={**null.values, **{f"{name}.delay": 1e-3 for name in sensors}})
    monkeypatch.setattr(delays, "LEFT_OVER", 0.0)
    monkeypatch.setattr(delays, "_with", lambda *args: asked.append(args) or (problem, late))
    for known in (sensors[1:], sensors[2:]):
        final = replace(
            null, effects=("valve_delay", *known), values={**late.values, "valve_delay.delay": 0.0}
        )
        or_for_delays(
            Selection(problem, null, problem, final), held_out, NOTHING, load().gap.evidence, silent
        )
        assert bool(asked) == (len(known) == 1)


LATE = ("angle_delay", "extensor_pressure_delay")
NOTHING = Step(None, None, None, 0.0, 0.0, (), "no effect gains anything")


def with_delay_of_the_valve(problem, null):
    projection = Projection(problem, null)
    trial = Trial(projection, "valve_delay")
    one = candidate(projection, trial, trial.starts())
    weighted, model = refit.refitted(problem, null, one, silent)
    evidence = {"valve_delay": 500.0}
    return Selection(
        problem, null, weighted, model, evidence=evidence, entered=evidence, alike={"valve_delay": {}}
    )


def test_sensors_that_are_late_together_are_found_at_once_in_place_of_what_hid_them(bench, monkeypatch):
    late = {f"plant__effects__{name}__enabled": True for name in LATE}
    late |= {f"plant__effects__{name}__delay": 4e-3 for name in LATE}
    problem, null, held_out = begun(bench, **late)
    found = with_delay_of_the_valve(problem, null)
    monkeypatch.setattr(delays, "_promised", lambda *_: 0.0)  # a dead time may hide all that they would gain
    step = or_for_delays(found, held_out, NOTHING, load().gap.evidence, silent)
    assert set(LATE) <= set(step.fit.effects)
    assert found.steps == [NOTHING]
    assert select._added(found, step, silent)
    assert "valve_delay" not in found.evidence
    assert set(found.evidence) == set(found.final.effects)
    for name in LATE:
        assert found.final.values[f"{name}.delay"] == pytest.approx(4e-3, abs=5e-4)


def test_where_no_fit_keeps_its_promise_the_next_ones_are_fitted(sound, monkeypatch):
    problem, null, held_out = sound
    names = ["constant_torque", "parallel_elasticity", "joint_friction", "viscous_friction"]
    promise = [Candidate(name, 100.0, null.values, 90.0, {}, (name,)) for name in names]
    promise.append(Candidate("creep", 10.0, null.values, -1.0, {}, ("creep",)))
    asked = []

    def none_keeps_it(_problem, _base, _around, worth, _progress):
        asked.append([one.name for one in worth])
        return [(-1.0, problem, replace(null, effects=(one.name,))) for one in worth]

    monkeypatch.setattr(select, "fitted_candidates", lambda *_: (promise, {}))
    monkeypatch.setattr(select, "_judged", none_keeps_it)
    found = Selection(problem, null, problem, null)
    step = select._seen_from((problem, null), found, held_out, load().gap.evidence, silent)
    assert step.accepted is None
    assert asked == [names[:3], names[3:]]


@pytest.mark.parametrize(("late", "tried"), [(LATE, True), ((), False)])
def test_delays_are_tried_where_they_promise_something(bench, monkeypatch, late, tried):
    changed = {f"plant__effects__{name}__enabled": True for name in late}
    changed |= {f"plant__effects__{name}__delay": 4e-3 for name in late}
    problem, null, held_out = begun(bench, **changed)
    asked = []
    monkeypatch.setattr(delays, "LEFT_OVER", 1.0)
    monkeypatch.setattr(delays, "HOPELESS", 1000.0)
    monkeypatch.setattr(delays, "_with", lambda *args: asked.append(args) or _with(*args))
    found = Selection(problem, null, problem, null)
    or_for_delays(found, held_out, NOTHING, load().gap.evidence, silent)
    assert bool(asked) == tried


def test_sensors_that_all_are_as_late_are_a_dead_time(bench, monkeypatch):
    late = {"plant__effects__valve_delay__enabled": True, "plant__effects__valve_delay__delay": 4e-3}
    problem, null, held_out = begun(bench, **late)
    monkeypatch.setattr(delays, "HOPELESS", 1000.0)
    found = Selection(problem, null, problem, null)
    step = or_for_delays(found, held_out, NOTHING, load().gap.evidence, silent)
    assert (step.accepted, step.fit.effects) == ("valve_delay", ("valve_delay",))
    assert step.fit.values["valve_delay.delay"] == pytest.approx(4e-3, abs=5e-4)


PAIR = ("joint_friction", "muscle_hysteresis")


def beside_friction(sound, monkeypatch, evidence, left=1.0, cleaner=True):
    """Return a search that has named friction with its details, beside which an effect has some evidence."""
    problem, null, _ = sound
    posed = problem.weighted(dict.fromkeys(problem.weights, left**-0.5))
    found = Selection(posed, null, posed, null, evidence={PAIR[0]: 10_000.0})
    model = SimpleNamespace(effects=PAIR, values={"muscle_hysteresis.half_width": 12.0})
    monkeypatch.setattr(second_chance, "_alike_pairs", lambda *_: [PAIR])
    monkeypatch.setattr(second_chance, "_details", lambda _: {PAIR[0]: {}})
    monkeypatch.setattr(second_chance, "_cleaner", lambda *_: cleaner)
    monkeypatch.setattr(second_chance, "emptied", lambda *_: ())
    for fitted in ("without_details", "with_both"):
        monkeypatch.setattr(second_chance.refit, fitted, lambda *_: (posed, model))
    monkeypatch.setattr(second_chance, "weighed", lambda *_: [(evidence, posed, model)])
    confirmed = replace(NOTHING, accepted=PAIR[1])
    monkeypatch.setattr(second_chance, "accepted", lambda *_: confirmed)
    monkeypatch.setattr(second_chance.selection, "larger", lambda *_: frozenset(PAIR[:1]))
    return found, confirmed


@pytest.mark.parametrize(
    ("left", "cleaner", "evidence", "named", "noted"),
    [
        (1.2, False, 40.0, True, True),
        (1.2, False, 5.0, False, True),
        (1.2, False, -20.0, False, False),
        (4.0, False, 40.0, False, True),
        (4.0, True, 40.0, True, True),
    ],
)
def test_an_effect_in_place_of_details(sound, monkeypatch, left, cleaner, evidence, named, noted):
    """Where much is left it has to leave less; where it does as well, that is noted."""
    found, confirmed = beside_friction(sound, monkeypatch, evidence, left, cleaner)
    step = second_chance.or_for_details(found, None, NOTHING, load().gap.evidence, silent)
    assert step is (confirmed if named else NOTHING)
    assert found.both == ({PAIR[0]: {PAIR[1]: {"muscle_hysteresis.half_width": 12.0}}} if noted else {})
    # neither is then dropped for what the other would have explained
    assert found.apart == ({PAIR[1]: {PAIR[0]}, PAIR[0]: {PAIR[1]}} if named else {})


@pytest.mark.parametrize(("evidence", "named"), [(19.0, False), (21.0, True)])
def test_an_effect_beside_one_like_it_with_the_details_of_both(sound, monkeypatch, evidence, named):
    """What the form of a large effect leaves over needs more, the larger that is."""
    found, confirmed = beside_friction(sound, monkeypatch, evidence)
    step = second_chance.or_for_both(found, None, NOTHING, load().gap.evidence, silent)
    assert step is (confirmed if named else NOTHING)
    assert set(found.apart) == (set(PAIR) if named else set())


def test_a_valve_that_is_late_stays_one_and_what_fits_is_let_be(bench):
    settings = load().gap.evidence
    late = {"plant__effects__valve_delay__enabled": True, "plant__effects__valve_delay__delay": 4e-3}
    problem, null, held_out = begun(bench, **late)
    found = with_delay_of_the_valve(problem, null)
    left = found.final_problem.weighted(dict.fromkeys(problem.weights, 0.5))
    for posed in (found.final_problem, left):
        found.final_problem = posed
        assert or_for_delays(found, held_out, NOTHING, settings, silent) is NOTHING
