# SPDX-License-Identifier: Apache-2.0
"""No verdict is wrong in kind: what is not explained is not called so, and nothing assumed goes unsaid."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import foreign_joint
import numpy as np
import pytest
from scipy.signal import butter, lfilter

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer import judgement, patch, verdict
from pam_orthosis.discrepancy.answer import last_line as last_line_of
from pam_orthosis.discrepancy.answer.contract import as_dict
from pam_orthosis.discrepancy.answer.last_line import with_rivals
from pam_orthosis.discrepancy.answer.verdict import _share, describe, describe_data
from pam_orthosis.discrepancy.apparatus import without_record
from pam_orthosis.discrepancy.fitting.measure import Gap, closure, over_noise, reduced
from pam_orthosis.discrepancy.preparation import beginning, check
from pam_orthosis.discrepancy.preparation.glitches import OF_POSITIONS, glitches, without_glitches
from pam_orthosis.discrepancy.preparation.identifiability import Identifiability
from pam_orthosis.discrepancy.recordings.data import from_arrays
from pam_orthosis.discrepancy.request import assumed_words
from pam_orthosis.discrepancy.search import acceptance, confirmation
from pam_orthosis.discrepancy.search.select import short_of
from pam_orthosis.discrepancy.search.selection import Step
from pam_orthosis.discrepancy.systems.knee import knee
from pam_orthosis.discrepancy.unknown.events import Event
from pam_orthosis.discrepancy.unknown.unknown import Unknown
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE, RIG
from pam_orthosis.model.parameters import load
from pam_orthosis.report import gap as gap_page

FRICTION = {"plant__effects__joint_friction__enabled": True, "plant__effects__joint_friction__coulomb": 0.6}


@pytest.fixture(scope="module")
def friction(bench):
    training = [bench.recording(1, **FRICTION), bench.recording(2, cycle_time=1.4, **FRICTION)]
    held_out = [bench.recording(3, cycle_time=1.7, **FRICTION)]
    settings = bench.parameters.gap
    start = beginning.begin(bench.system, training, held_out, settings, replay=bench.replay)
    return start, workflow.search(start, settings), settings


def test_the_held_out_gap_is_the_same_with_the_model_that_is_written(bench, friction, tmp_path):
    """`model.yaml` holds all that was found: recalibrated, it leaves what the search left."""
    _, outcome, settings = friction
    file, named = tmp_path / "model.yaml", [one.name for one in outcome.effects]
    patch.write(file, patch.overrides(outcome.system, named, outcome.selection.final.values))
    training = [bench.recording(1, **FRICTION), bench.recording(2, cycle_time=1.4, **FRICTION)]
    held_out = [bench.recording(3, cycle_time=1.7, **FRICTION)]
    again = beginning.begin(
        knee(bench.parameters.changed(patch.read_nominal(file))), training, held_out, settings
    )
    gap = again.recalibrated()
    assert outcome.before.units["angle"] > 5 * outcome.after.units["angle"]
    assert gap.units == pytest.approx(outcome.after.units, rel=0.02)


def test_another_joint_read_as_the_default_knee_is_not_explained(tmp_path, capsys):
    """It names nothing, and says that the recordings seem to be of another machine."""
    files = [foreign_joint.write(tmp_path / f"{seed}.csv", seed) for seed in (1, 3)]
    out = tmp_path / "out"
    with_next = ["--next", str(tmp_path / "next.csv")]
    status = main(["gap", files[0], "--held-out", files[1], "--out", str(out), *with_next])
    said, reported = capsys.readouterr().out.splitlines(), json.loads((out / "gap.json").read_text())
    assert status == 1
    assert (reported["verdict"], reported["effects"], reported["unknown"]) == ("unexplained", [], None)
    assert max(place["over_noise"] for place in reported["left"]) > 20
    assert said.pop().startswith("next: no experiment is known")
    assert not (tmp_path / "next.csv").exists()
    assert said[-1].startswith(
        "UNEXPLAINED: nothing I know; something large is missing, or the recordings are of another machine "
    )
    assert not any(line.startswith(("wrong parameter", "effect", "unknown")) for line in said)
    assert said[0].startswith(f"the apparatus is assumed: {files[0]} and 1 more")
    assert said[0].endswith("read as the default knee")
    assert reported["apparatus_assumed"] == files


@pytest.mark.parametrize(
    ("closed", "kept", "gone", "empty", "verdict"),
    [
        (0.999, 1.4, False, (), "explained"),
        (0.999, 1.6, False, (), "partial"),
        (0.999, 1.0, False, ("creep.stiffness",), "partial"),
        (0.999, 1.0, False, ("creep.stiffness", "stretch_reflex.threshold"), "unexplained"),
        (0.49, 1.0, False, (), "unexplained"),
        (0.999, 1.0, True, (), "recalibrated"),
        (None, 1.0, True, (), "recalibrated"),
    ],
)
@pytest.mark.parametrize("clean", [True, False])
def test_explained_needs_little_left_and_effects_that_mean_something(
    closed, kept, gone, empty, verdict, clean
):
    reported = judgement.verdict_on(
        ("stretch_reflex", "creep"), closed, judgement.Rest(clean, kept, gone), empty
    )
    assert reported == (verdict if clean or closed is not None else "partial")


def test_nothing_is_explained_by_nuisance_parameters_far_off():
    """Neither where no effect of their equation is named, nor where many of them bend the model."""
    astray, foreign = (
        judgement.Rest(True, 1.0, True, strained=True),
        judgement.Rest(True, 1.0, True, True, True),
    )
    reported = [judgement.verdict_on(names, 1.0, astray, ()) for names in ((), ("creep",))]
    assert reported == ["unexplained", "partial"]
    assert judgement.verdict_on(("creep",), 1.0, foreign, ()) == "unexplained"
    bent = judgement.Rest(True, 1.0, False, shapes_strained=True)
    assert [judgement.verdict_on(names, 1.0, bent, ()) for names in ((), ("creep",))] == reported


def test_what_is_far_off_counts_where_no_effect_of_its_equation_is_named(friction):
    _, outcome, _ = friction
    final = outcome.selection.final
    for name, astray in (("conductance", ["conductance"]), ("moving_mass", [])):
        one = next(free for free in final.free if free.name == name)
        moved = replace(final, values={**final.values, name: 8.0 * one.sd})
        assert judgement._astray(outcome.system, moved) == astray


def test_a_parameter_surely_off_is_excused_by_no_effect_beside_it(friction):
    _, outcome, _ = friction
    final = outcome.selection.final
    one = next(free for free in final.free if free.name == "moving_mass")
    moved = replace(final, values={**final.values, one.name: 10.5 * one.sd})
    assert judgement._astray(outcome.system, moved) == ["moving_mass"]


def test_effects_that_are_no_delay_may_make_up_for_stamps_that_are_off(friction):
    _, outcome, _ = friction
    outcome = replace(outcome, remarks=("off", "another"))
    alone = outcome.of_skewed(["off"], clearly=True)
    assert (alone.verdict, alone.remarks) == (outcome.verdict, ["another"]), "it explains all: none is off"
    outcome = replace(outcome, effects=(*outcome.effects, replace(outcome.effects[0], name="backlash")))
    assert outcome.of_skewed(["off"], clearly=False) is outcome
    skewed = outcome.of_skewed(["off"], clearly=True)
    assert (skewed.verdict, skewed.skewed, skewed.remarks) == ("partial", True, outcome.remarks)
    assert "but stamps seem off: mend them and search again" in describe(skewed).splitlines()[-1]
    late = replace(outcome, effects=(*outcome.effects, replace(outcome.effects[0], name="valve_delay")))
    assert late.of_skewed(["off"], clearly=True) is late
    nothing = replace(outcome, verdict="none", effects=()).of_skewed(["off"], clearly=True)
    assert (nothing.verdict, nothing.remarks) == ("none", ["another"])


@pytest.mark.parametrize(("added", "skewed"), [("valve_delay", True), ("joint_friction", False)])
def test_a_delay_that_the_search_added_speaks_for_stamps_that_are_off(friction, monkeypatch, added, skewed):
    """However far off the tolerances are beside it."""
    start, outcome, settings = friction
    final = replace(outcome.selection.final, effects=(added,))
    found = replace(outcome.selection, final=final)
    far = replace(outcome, verdict="unexplained", effects=(), foreign=True, strained={"supply_pressure": 9.0})
    monkeypatch.setattr(workflow.select, "extended", lambda *_: found)
    monkeypatch.setattr(workflow, "remarks_on_agreement", lambda *_: [])
    monkeypatch.setattr(workflow, "remarks_on_inputs", lambda *_: [])
    monkeypatch.setattr(workflow, "outcome_of", lambda *_: far)
    told = workflow.search(replace(start, skewed=True), settings)
    assert (told.skewed, told.foreign) == (skewed, not skewed)
    lines = describe(told).splitlines()
    assert lines[-1].startswith("UNEXPLAINED: stamps seem off: mend them and search again") == skewed
    (off,) = (line for line in lines if "outside their tolerance (multiples" in line)
    assert off.startswith("with stamps that are off") == skewed
    assert ("calibration first" in off) != skewed


def test_a_description_of_one_equation_does_not_describe_the_other(friction):
    _, outcome, _ = friction
    left = SimpleNamespace(equation="torque", descriptions=[SimpleNamespace()], reduced=0.99, events=())

    def reported(angle, pressure):
        white = {**outcome.after.white, "angle": angle, "flexor_pressure": pressure}
        floor, gap = Gap({}, dict.fromkeys(white, 1.0)), Gap({}, white)
        # an effect that is no explanation leaves what is there without it
        before = gap if outcome.effects == () else outcome.before
        return replace(outcome, verdict="partial", before=before, after=gap, floor=floor).described(left)

    assert reported(20.0, 1.0).verdict == "described"
    assert reported(20.0, 3.0).verdict == "partial"
    for angle, pressure in ((300.0, 1.0), (20.0, 30.0), (300.0, 30.0)):
        foreign = reported(angle, pressure)
        assert (foreign.verdict, foreign.effects, foreign.unknown) == ("unexplained", (), None)
        assert "of another machine than the given one" in describe(foreign).splitlines()[-1]
    outcome = replace(outcome, effects=())
    assert reported(300.0, 1.0).verdict == "described", "99 % are: the sensor is a good one"
    left.reduced = 0.8
    assert reported(300.0, 1.0).verdict == "unexplained"


def _swapped(arrays):
    names = ("pressure", "voltage")
    return {
        f"{a}_{n}": arrays[f"{b}_{n}"]
        for n in names
        for a, b in (("extensor", "flexor"), ("flexor", "extensor"))
    }


def test_pushes_are_no_description(friction):
    """No model can carry what comes at instants of its own, however much of the gap it is."""
    _, outcome, _ = friction
    events = Event("run", "angle", 3.1, 1.5, 0.2), Event("run", "angle", 7.4, -1.2, 0.3)
    pushes = Unknown("torque", (), events)
    white = {**outcome.after.white, "angle": 25.0}
    open_ = replace(outcome, verdict="unexplained", effects=(), after=Gap(outcome.after.units, white))
    reported = open_.described(pushes)
    assert (reported.verdict, reported.foreign) == ("unexplained", False)
    last = describe(reported).splitlines()[-1]
    assert last.endswith("2 pushes (in run at 3.1 s, 7.4 s); no curve of a measured signal explains them")
    assert open_.described(replace(pushes, events=())).foreign


def test_a_parameter_that_is_recalibrated_beyond_its_tolerance_is_said(friction):
    _, outcome, _ = friction
    final = outcome.selection.final
    shape = next(one for one in final.free if one.name == "volume_misfit.flexor_cx")
    moved = {"muscle_damping": 0.9, "angle_offset": -5e-3, shape.name: 4.4 * shape.sd}
    far = replace(final, values={**final.values, **moved})
    assert judgement.moved_beyond(outcome.system, far) == pytest.approx(
        {"muscle_damping": 4.5, "angle_offset": -5e-3 / 1.5e-3, shape.name: 4.4}
    )
    within = replace(final, values={**final.values, shape.name: 3.9 * shape.sd})
    assert not judgement.moved_beyond(outcome.system, within)
    assert not judgement.moved_beyond(
        outcome.system, replace(final, values={**final.values, "angle_offset": 4e-3})
    )
    clean = judgement.Rest(True, 1.0, True, beyond_tolerance=True)
    assert judgement.verdict_on((), None, clean, ()) == "recalibrated"
    assert judgement.verdict_on((), None, clean._replace(strained=True), ()) == "unexplained"
    assert judgement.verdict_on((), None, clean._replace(beyond_tolerance=False), ()) == "none"
    reported = replace(
        outcome, verdict="recalibrated", effects=(), selection=replace(outcome.selection, final=far)
    )
    within = replace(far, values={**final.values, "muscle_damping": 0.36})
    little = replace(reported, verdict="none", selection=replace(outcome.selection, final=within))
    furthest = "noise only; it moved furthest: muscle_damping 1.36 times as large (1.8 times its tolerance)"
    near = (
        f"{furthest}; nearest to a name is joint_friction (evidence 12): held-out recordings are against it"
    )
    for evidence, last in (9.2, furthest), (12.3, near):
        ranked, reason = (("joint_friction", evidence), ("creep", 3.0)), "held-out recordings are against it"
        steps = [replace(outcome.steps[0], ranked=ranked, reason=reason)]
        assert describe(replace(little, steps=steps)).splitlines()[-1].endswith(last)
    ranked = (("valve_supply_pressure", 13.0), ("flexor_pressure_gain", 5.5), ("creep", 5.0))
    steps = [replace(outcome.steps[0], ranked=ranked, reason=reason)]
    either = f"is valve_supply_pressure (evidence 13, or flexor_pressure_gain 6): {reason}"
    assert describe(replace(little, steps=steps)).splitlines()[-1].endswith(either)
    white = {**little.floor.white, "overall": 9 * little.floor.white["overall"]}
    large = replace(little.configured, white=white)
    last = describe(replace(little, configured=large)).splitlines()[-1]
    said = "; the nominal model leaves 9 times the noise: if the tolerances of muscle damping are wider than"
    assert said in last
    assert " are wider than" not in describe(little)
    named = replace(reported, effects=outcome.effects)
    pages = [gap_page.page(one, describe(one)) for one in (reported, named)]
    for meant, told in ((gap_page.MEANINGS["recalibrated"], [True, False]), (gap_page.NAMED, [False, True])):
        assert [meant in page for page in pages] == told
    last = describe(reported).splitlines()[-1]
    assert last.startswith(
        "RECALIBRATED: the model leaves noise only with muscle_damping 1.9 times as large (4.5 "
    )
    assert "angle_offset -0.005 rad off (3.3 times its tolerance)" in last
    assert "volume_misfit.flexor_cx (4.4 times its tolerance)" in last
    assert "; nearest to a name is joint_friction (evidence " in last


def test_muscles_that_are_swapped_are_no_effect(bench):
    names = "joint_friction", "constant_torque"
    few = replace(bench.system, catalogue={name: bench.system.catalogue[name] for name in names})
    runs = [{**a, **_swapped(a)} for a in (bench.arrays(1), bench.arrays(3, 1.7))]
    training, held_out = ([from_arrays(f"run {n}", few, one)] for n, one in enumerate(runs))
    outcome = workflow.find_gap(few, training, held_out, bench.parameters.gap)
    assert (outcome.verdict, outcome.effects, outcome.foreign) == ("unexplained", (), True)


def test_no_more_than_the_whole_gap_is_explained():
    assert closure(5.0, 0.97, 1.0) == 1.0
    assert closure(5.0, 3.0, 1.0) == 0.5
    assert closure(1.02, 0.97, 1.0) is None


def test_a_description_that_by_chance_removes_more_than_the_gap_leaves_noise():
    assert reduced(3.0, 0.0) == pytest.approx(3.0)
    assert reduced(3.0, 0.5) == pytest.approx(5.0**0.5)
    assert reduced(1.5, 2.0) == 1.0


def test_a_surrogate_that_makes_held_out_recordings_worse_is_not_shown(friction, monkeypatch):
    start, outcome, settings = friction
    final = outcome.selection.final
    final = replace(final, values={**final.values, "joint_friction.coulomb": 20.0})
    monkeypatch.setattr(workflow.select, "extended", lambda *_: replace(outcome.selection, final=final))
    monkeypatch.setattr(workflow, "unknown", lambda *_: None)
    monkeypatch.setattr(workflow, "remarks_on_agreement", lambda _, __, model: [f"with {model.effects}"])
    reported = workflow.search(start, settings)
    assert [one for one in reported.remarks if one.startswith("with ")] == ["with ()"]
    assert reported.after.white["overall"] == pytest.approx(reported.before.white["overall"])
    assert reported.verdict == "unexplained"
    assert "no explanation" not in describe(reported)


@pytest.mark.parametrize("mistake", [(), ("CHECK THE RECORDINGS: does time run backwards?",)])
def test_a_search_that_fails_says_what_mistake_the_recordings_seem_to_have(friction, monkeypatch, mistake):
    def fail(*_):
        raise OrthosisError("no minimum")

    monkeypatch.setattr(workflow.select, "extended", fail)
    start = replace(friction[0], mistaken=bool(mistake), remarks=("noisy", *mistake))
    with pytest.raises(OrthosisError) as told:
        workflow.search(start, friction[2])
    assert str(told.value) == (f"{mistake[0]} (no minimum)" if mistake else "no minimum")


@pytest.mark.parametrize(
    ("verdict", "against", "judged"),
    [("explained", False, "partial"), ("explained", True, "explained"), ("partial", True, "partial")],
)
def test_what_makes_up_for_a_mistake_is_no_answer(friction, monkeypatch, verdict, against, judged):
    """But for what drives a coordinate that seemed to move against all forces: it is known then."""
    start, outcome, settings = friction
    doubt = "CHECK THE RECORDINGS: angle moves against the forces on it"
    monkeypatch.setattr(workflow.select, "extended", lambda *_: outcome.selection)
    monkeypatch.setattr(workflow, "outcome_of", lambda *_: replace(outcome, verdict=verdict, remarks=[doubt]))
    found = workflow.search(replace(start, mistaken=True, against=doubt if against else ""), settings)
    doubted = judged != "explained"
    assert (found.verdict, doubt in found.remarks, bool(found.mistaken)) == (judged, doubted, doubted)
    assert ("may only make up for it" in describe(found).splitlines()[-1]) == doubted


def test_what_is_left_has_one_measure(friction):
    """The root mean square over the noise, in the table, the file and the verdict alike."""
    _, outcome, _ = friction
    angle = outcome.after.white["angle"] / outcome.floor.white["angle"]
    left = {one["equation"]: one["over_noise"] for one in as_dict(outcome)["left"]}
    assert left["torque"] == pytest.approx(angle, rel=1e-5)
    assert left == pytest.approx(over_noise(outcome.system, outcome.after, outcome.floor), rel=1e-5)
    loud = Gap(outcome.after.units, {**outcome.after.white, "flexor_pressure": 4.0})
    assert over_noise(outcome.system, loud, outcome.floor)["gas"] > 3.5
    place = replace(outcome.left[0], equation="torque", density=900.0)
    reported = describe(replace(outcome, verdict="unexplained", left=[place]))
    small = "what is left in the torque equation is small, but more than noise; "
    assert small in reported.splitlines()[-1]
    assert "900" not in reported


def test_a_model_that_closes_less_than_half_names_nothing(friction, monkeypatch):
    """However far the next effect is behind."""
    start, outcome, settings = friction
    found = outcome.selection
    alone = replace(found, steps=[replace(step, ranked=(("joint_friction", 1e4),)) for step in found.steps])
    for share, names in ((0.2, []), (0.6, ["joint_friction"])):
        closed = dict.fromkeys(outcome.closure, share)
        monkeypatch.setattr(judgement, "_closures", lambda *_, closed=closed: closed)
        reported = judgement.outcome_of(start, alone, settings)
        assert [one.name for one in reported.effects] == names
        assert [one.name for one in reported.surrogates] == ([] if names else ["joint_friction"])
    reported = describe(replace(outcome, verdict="unexplained", effects=(), surrogates=outcome.effects))
    assert reported.splitlines()[-1].endswith("no model of the catalogue explains half of the gap")
    (surrogate,) = (line for line in reported.splitlines() if "is no explanation" in line)
    named = next(line for line in describe(outcome).splitlines() if line.startswith("effect: joint_friction"))
    assert surrogate == named.replace("effect", "fits best, but is no explanation", 1), "its size is printed"


def test_an_effect_at_a_bound_that_empties_it_is_no_explanation(friction):
    start, outcome, settings = friction
    final = outcome.selection.final
    wide = replace(final, values={**final.values, "joint_friction.transition_velocity": 0.76})
    reported = judgement.outcome_of(start, replace(outcome.selection, final=wide), settings)
    assert reported.empty == ("joint_friction.transition_velocity",)
    assert reported.verdict == "unexplained"
    assert reported.effects == ()
    assert as_dict(reported)["empty_of_meaning"] == ["joint_friction.transition_velocity"]
    said = "joint_friction would not be what the name says (joint_friction.transition_velocity = 0.76)"
    assert said in describe(reported)
    assert outcome.empty == ()
    assert outcome.verdict == "explained"


def test_an_effect_that_would_be_another_one_is_not_added(friction):
    start, outcome, _ = friction
    found = outcome.selection
    wide = replace(found.final, values={**found.final.values, "joint_friction.transition_velocity": 0.76})
    able = [(1e4, found.final_problem, wide)]
    step = acceptance.accepted(start.problem, start.null, start.held_out, able, (), {})
    assert step.accepted is None
    assert step.reason.endswith("not be what its name says: joint_friction.transition_velocity = 0.76")
    able = [(1e4, found.final_problem, found.final)]
    assert acceptance.accepted(start.problem, start.null, start.held_out, able, (), {}).accepted


def test_noise_alone_is_left_where_each_channel_of_each_recording_is_clean(friction):
    start, outcome, _ = friction
    for base, clean in ((start.null, False), (outcome.selection.final, True)):
        assert confirmation.leaves_noise_alone(start.held_out, base) == clean


def test_what_is_due_of_a_right_model_falls(friction):
    """Of friction, in recordings that were not fitted; nothing is of a model that is the same."""
    start, outcome, _ = friction
    final = outcome.selection.final
    problem = start.problem.weighted(outcome.selection.final_problem.weights)
    held_out = start.held_out.weighted(problem.weights)
    seen = confirmation.confirmed(problem, held_out, start.null, final)
    assert seen.due > 1000
    assert abs(seen.fall - seen.due) < 0.5 * seen.due
    assert not seen.cannot_show
    same = confirmation.confirmed(problem, held_out, final, final)
    assert (same.fall, same.due) == (0.0, 0.0)
    assert same.cannot_show


def test_values_at_a_bound_and_the_coefficients_of_a_map_are_marked(friction):
    _, outcome, _ = friction
    (one,) = outcome.effects
    reported = describe(replace(outcome, effects=(replace(one, at_bound=("coulomb",)),)))
    assert "N m (0." in reported
    assert ", at its bound), stribeck" in reported
    assert as_dict(replace(outcome, effects=(replace(one, at_bound=("coulomb",)),)))["effects"][0][
        "parameters"
    ]["coulomb"]["at_bound"]
    many = {f"c{i}": (1e-3 * i, "-", 0.0, 0.1) for i in range(22)}
    reported = describe(replace(outcome, effects=(replace(one, parameters=many),)))
    assert "c21" in reported
    assert " and 19 more coefficients (gap.json); evidence" in reported


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda v: lfilter(*butter(2, 0.4), v), "filtered, slow"),
        (lambda v: np.convolve(v, np.full(5, 0.2), "same"), "filtered, slow"),
        (
            lambda v: np.convolve(v, np.full(15, 1 / 15), "same"),
            "a mean over several samples does (filtered)",
        ),
        (lambda v: np.round(v, 2), "quantised"),
        (lambda v: np.sin(np.arange(len(v)) / 200), "no noise"),
        (lambda v: v, ""),
    ],
)
def test_a_noise_floor_that_is_no_measure_of_the_sensor_is_said(bench, changed, said):
    arrays = bench.arrays(1)
    one = from_arrays("run", bench.system, {**arrays, "angle": changed(arrays["angle"])})
    remarks = [line for line in check.check(bench.system, [one], 2.0) if "noise floor" in line]
    assert all(line.startswith("run: angle ") and said in line for line in remarks)
    assert bool(remarks) == bool(said)


def test_a_doubt_on_noise_is_said_once_for_all_recordings(bench):
    arrays = bench.arrays(1)
    coarse = {**arrays, "angle": np.round(arrays["angle"], 2)}
    runs = [from_arrays(name, bench.system, coarse) for name in ("first", "second", "third")]
    (remark,) = (line for line in check.check(bench.system, runs, 2.0) if "noise floor" in line)
    assert remark.startswith("first: angle has steps ")
    assert "(quantised), in 2 more recordings too; its noise floor" in remark


def test_evidence_below_nothing_is_none():
    assert short_of("leak", -1.2, 15.0) == "leak has no evidence, it would need 15"
    assert short_of("leak", 3.4, 15.0) == "leak has evidence 3, it would need 15"


def test_effects_that_are_confounded_pair_by_pair_are_one_line():
    pairs = (("b", "a", 0.96), ("d", "c", 0.98), ("e", "b", 0.99), ("e", "a", 0.97))
    assert describe_data(Identifiability({}, (), pairs, ())).splitlines() == [
        "confounded in these data: d and c (cosine of their sensitivities 0.98)",
        "confounded in these data: b, a and e (cosine of their sensitivities 0.96 .. 0.99)",
    ]


@pytest.mark.parametrize(
    ("changed", "seen"),
    [
        (lambda v: np.minimum(v, np.quantile(v, 0.9)), True),
        (lambda v: np.maximum(v, np.quantile(v, 0.1)), True),
        (lambda v: np.round(v, -4), False),  # coarse everywhere
        (lambda v: v, False),
    ],
)
def test_a_sensor_that_saturates_is_told(bench, changed, seen):
    arrays = bench.arrays(1)
    one = from_arrays(
        "run", bench.system, {**arrays, "extensor_pressure": changed(arrays["extensor_pressure"])}
    )
    remarks = [line for line in check.check(bench.system, [one], 2.0) if "saturate" in line]
    assert len(remarks) == seen
    assert all("10% of the samples of extensor_pressure are" in line for line in remarks)


@pytest.mark.parametrize(
    ("end", "value", "sides", "ends"),
    [
        ("maximum_pressure_gauge", 3.0e5, ("extensor_pressure", "flexor_pressure"), "1013 to 4013 mbar"),
        ("minimum_contraction", 0.03, ("flexor contraction",), "30 to 125.2 mm"),
        ("maximum_pressure_gauge", 3.44e5, (), ""),  # by no more than noise
        ("minimum_contraction", 0.0, (), ""),
    ],
)
def test_recordings_beyond_what_a_muscles_map_knows_are_told(bench, end, value, sides, ends):
    """The map is held at the edge of its box: a search would name what is not there."""
    system = knee(bench.parameters.changed({f"muscle.dmsp_20.box.{end}": value}))
    told = check.beyond_boxes(system, [bench.recording(1), bench.recording(2)])
    assert [one.partition(f" leaves the box of the muscle's map ({ends}) in ")[0] for one in told] == [*sides]
    assert all(one.endswith(": it is held at the edge there; identify a wider one") for one in told)


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_samples_that_jump_and_are_back_are_bridged_and_told(bench, samples):
    one = bench.recording(1)
    at = [1500, 4000]
    places = np.concatenate([np.arange(start, start + samples) for start in at])
    broken = {**one.signals, "angle": one.signals["angle"].copy()}
    broken["angle"][places] = 0.0
    mended = without_glitches(bench.system, replace(one, signals=broken))
    assert np.abs(mended.signals["angle"] - one.signals["angle"]).max() < 0.02
    (told,) = mended.remarks
    assert told.startswith("run 1: angle jumps by up to")
    assert f"in {2 * samples} of {one.samples} samples, the first at 3.000 s: bridged" in told


def test_many_glitches_of_a_position_do_not_hide_each_other(bench):
    one = bench.recording(1)
    broken = {**one.signals, "angle": one.signals["angle"].copy()}
    broken["angle"][::150] = 0.0
    mended = without_glitches(bench.system, replace(one, signals=broken))
    assert np.abs(mended.signals["angle"] - one.signals["angle"])[1:-1].max() < 0.02


@pytest.mark.parametrize("changed", [lambda v: v, lambda v: np.round(v, 2), lambda v: v + 0.3 * (v > 0.6)])
@pytest.mark.parametrize("every", [1, 10])
def test_what_moves_by_itself_is_no_glitch(bench, changed, every):
    signals = {name: changed(values[::every]) for name, values in bench.recording(1).signals.items()}
    never = np.zeros(len(signals["angle"]), dtype=bool)
    assert not any(glitches(values, never).any() for values in signals.values())
    assert not glitches(signals["angle"], never, OF_POSITIONS).any()


def test_a_position_that_leaps_behind_a_voltage_is_bridged_all_the_same(bench):
    one = bench.recording(1)
    broken = {name: one.signals[name].copy() for name in ("angle", "extensor_voltage")}
    broken["angle"][1500] = 0.0
    broken["extensor_voltage"][1498:1500] = 10.0
    mended = without_glitches(bench.system, replace(one, signals={**one.signals, **broken}))
    assert np.abs(mended.signals["angle"] - one.signals["angle"]).max() < 0.02


@pytest.mark.parametrize(("lead", "kept"), [(0, False), (1, True), (4, True), (7, False)])
def test_a_jump_that_follows_upon_a_pulse_of_a_voltage_is_kept(bench, lead, kept):
    """A hose drops pressure while air flows: its sensor does jump, and is back."""
    one = bench.recording(1)
    broken = {name: one.signals[name].copy() for name in ("extensor_pressure", "extensor_voltage")}
    broken["extensor_pressure"][1500:1502] += 1e5
    broken["extensor_voltage"][1500 - lead : 1502 - lead] = 10.0
    mended = without_glitches(bench.system, replace(one, signals={**one.signals, **broken}))
    same = np.array_equal(mended.signals["extensor_pressure"], broken["extensor_pressure"])
    assert same == kept
    assert bool(mended.remarks) != kept


@pytest.mark.parametrize(
    ("effect", "parameter", "empty", "meant"),
    [
        ("stretch_reflex", "threshold", (0.0, 8.0), (0.05, 1.0)),
        ("stretch_reflex", "lag", (0.005, 0.015, 0.3), (0.025, 0.04, 0.1)),  # drag is faster
        ("joint_friction", "transition_velocity", (0.76, 1.0), (0.001, 0.1)),
        ("joint_friction", "bristles", (), (0.0, 0.5, 1.0)),
        ("muscle_hysteresis", "sliding_distance", (5e-5, 0.02), (1e-4, 1e-3)),
        ("creep", "time_constant", (0.05, 30.0), (0.1, 10.0)),
        ("valve_delay", "delay", (0.05, -0.05), (-8e-3, 1e-3, 8e-3)),
        ("valve_lag", "natural_frequency", (5.0, 1000.0), (12.0, 200.0)),
        ("valve_lag", "damping_ratio", (0.3,), (0.5, 0.8, 5.0)),
        ("joint_friction", "stribeck", (2.0,), (0.0, 0.2)),
        ("parallel_elasticity", "rest_angle", (-1.0, 2.0), (0.0, 0.6)),
        ("volume_misfit", "extensor_c0", (-0.3, 0.3), (0.0, 0.15)),
        ("valve_curve_misfit", "flexor_vent_1", (0.5,), (0.25,)),
        ("valve_curve_misfit", "flexor_vent_5", (), (-0.5, 0.5)),
    ],
)
def test_bounds_that_empty_an_effect_are_separated_from_those_that_do_not(effect, parameter, empty, meant):
    q = next(q for q in KNEE.catalogue[effect].parameters if q.name == parameter)
    assert all(q.is_empty(value) for value in empty)
    assert not any(q.is_empty(value) for value in meant)


def test_every_effect_means_something_at_its_typical_values():
    for effect in (*KNEE.catalogue.values(), *RIG.catalogue.values()):
        for q in effect.parameters:
            assert not q.is_empty(q.typical), f"{effect.name}.{q.name}"
            if q.meaningful:
                assert q.minimum <= q.meaningful[0] < q.meaningful[1] <= q.maximum
        assert effect.fitted[0].meaningful is None or effect.shape  # a size at a bound is never meant


def test_an_apparatus_that_nothing_records_is_said_to_be_assumed(tmp_path):
    stamps, signals = np.array([0, 2_000_000]), {"angle": np.zeros(2)}
    write_arrays(tmp_path / "ours", stamps, signals, run_metadata(load().nominal(), "test"))
    write_arrays(tmp_path / "foreign", stamps, signals, {})
    table, ours, foreign = tmp_path / "x.csv", tmp_path / "ours", tmp_path / "foreign"
    assert without_record([table, ours, foreign]) == [table, foreign]
    assert assumed_words([], 1, None) == ""
    assert "read as the apparatus of the other recordings" in assumed_words([table], 2, None)
    model = Path("mine.yaml")
    assert "read as the default knee with what mine.yaml changes" in assumed_words([table], 1, model)


def test_a_share_of_nothing_has_no_sign():
    outcome = SimpleNamespace(closure={"angle": -0.0003}, from_configured=())
    assert _share(outcome, "angle") == "0.0 %"


def test_the_last_line_says_what_the_data_do_not_separate():
    system = SimpleNamespace(wrong={"leg_cogwheel_diameter": "leg.cogwheel_diameter"})
    one = SimpleNamespace(name="valve_lag", look_alikes=("valve_delay", "leg_cogwheel_diameter"), both={})
    assert with_rivals(system, one) == "valve lag (or valve delay, or a wrong leg.cogwheel_diameter)"
    assert with_rivals(system, SimpleNamespace(name="valve_lag", look_alikes=())) == "valve lag"


def test_a_motion_that_turns_at_once_is_no_glitch():
    """The values are of a joint that rests for most of the time."""
    values = 5e-5 * np.random.default_rng(1).standard_normal(400)
    values[200:210] = [0.0, 0.0, 0.0691, 0.0663, 0.0647, 0.0643, 0.0650, 0.0667, 0.0691, 0.0725]
    values[210:] += 0.0725
    values[:202] += 0.0720
    still = np.zeros(len(values), bool)
    assert not glitches(values, still, OF_POSITIONS)[203:208].any()
    values[205] += 0.02
    assert np.flatnonzero(glitches(values, still, OF_POSITIONS)).tolist() == [205]


def test_only_a_system_with_pressures_is_asked_for_absolute_ones(bench):
    said = verdict._strain(bench.system, {"supply_pressure": 20.0})
    assert said.endswith("check units, zeros (absolute pressure?) and calibration first")
    carriage = replace(bench.system, channels=bench.system.channels[:1])
    assert verdict._strain(carriage, {"mass": 20.0}).endswith("check units, zeros and calibration first")
    assert verdict._strain(carriage, {"mass": 20.0}, explained=True).endswith("mass +20.0")


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((0.28, 0.279995, 0.280005), "0.28 N (0.279995 .. 0.280005)"),
        ((11.94, 11.7, 12.2), "11.94 N (11.7 .. 12.2)"),
        ((5.0, 5.0, 5.0), "5 N (interval unknown)"),
    ],
)
def test_an_interval_has_the_digits_that_show_its_width(numbers, said):
    value, lower, upper = numbers
    assert verdict._with_interval(value, "N", lower, upper) == said


@pytest.mark.parametrize("unit", ["-", "1"])
def test_a_pure_number_has_no_unit(unit):
    assert verdict._with_interval(0.13, unit, 0.11, 0.15) == "0.13 (0.11 .. 0.15)"


@pytest.mark.parametrize(("delay", "longest"), [(0.05, True), (-0.006, False)])
def test_a_delay_as_long_as_any_that_is_tried_says_so(bench, delay, longest):
    (q,) = bench.system.catalogue["valve_delay"].fitted
    assert q.maximum == 0.05
    model = SimpleNamespace(values={"valve_delay.delay": delay})
    said = confirmation.at_values(bench.system, model, ["valve_delay.delay"])
    assert said.startswith(f"valve_delay.delay = {delay:.4g}")
    assert ("the longest delay that is tried" in said) == longest


def test_an_effect_may_close_the_gap_of_its_own_equation_alone(bench):
    """What is left in another equation is not of it; what feels nothing of its own, or a sensor, does not."""
    found = SimpleNamespace(final_problem=SimpleNamespace(system=bench.system, replay=bench.replay))
    channels = [channel for one in bench.system.equations for channel in one.channels]
    large, small = Gap({}, dict.fromkeys(channels, 9.0)), Gap({}, dict.fromkeys(channels, 1.0))
    closed = {name: 0.0 if name == "angle" else 0.9 for name in channels}
    assert judgement._closes_own(found, "valve_lag", large, closed)
    assert not judgement._closes_own(found, "joint_friction", large, closed)
    assert not judgement._closes_own(found, "valve_lag", small, closed)
    assert not judgement._closes_own(found, "valve_lag", large, dict.fromkeys(channels, 0.7))
    assert not judgement._closes_own(found, "extensor_pressure_delay", large, dict.fromkeys(channels, 0.9))


def test_what_stamps_seem_to_do_is_not_described(friction, monkeypatch):
    start, outcome, settings = friction
    late = Step(None, None, None, 99.0, 5.0, (), f"valve_delay {confirmation.EMPTY}: d = -0.004", closes=0.99)
    found = replace(outcome.selection, steps=[late], final=start.null, final_problem=start.problem)
    monkeypatch.setattr(workflow.select, "extended", lambda *_: found)
    monkeypatch.setattr(workflow, "unknown", lambda *_: pytest.fail("it was described"))
    told = workflow.search(start, settings)
    assert told.verdict == "unexplained"
    last = describe(told).splitlines()[-1]
    assert "as if extensor_voltage and flexor_voltage were stamped late" in last
    assert "; mend the stamps and search again" in last
    assumed = replace(
        told, remarks=("if the period is shorter than 20 ms, they are too old to drive the model",)
    )
    said = (
        "; is the loop faster than they change, and are they too old? Give scenario.control_period, or mend"
    )
    assert said in describe(assumed).splitlines()[-1]


@pytest.mark.parametrize("worn", [False, True])
def test_masses_that_are_off_may_be_forces_unless_a_person_is_there(friction, worn):
    _, outcome, _ = friction
    final = replace(outcome.selection.final, values={**outcome.selection.final.values, "moving_mass": 0.13})
    known = [one for one in outcome.system.calibrations if one.name != "person_mass"]
    person = replace(known[0], name="person_mass")
    system = replace(outcome.system, calibrations=(*known, person) if worn else tuple(known))
    far = replace(outcome, system=system, selection=replace(outcome.selection, final=final))
    told = last_line_of._moved(far, {"moving_mass": 4.3})
    forces = " (or all forces 0.885 times)" * (not worn)
    assert told == f"moving_mass 1.13 times as large{forces} (4.3 times its tolerance)"
