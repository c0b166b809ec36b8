# SPDX-License-Identifier: Apache-2.0
"""The workflow from recordings to verdict, model file and page."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pam_orthosis.bag.arrays import write_arrays
from pam_orthosis.bag.record import run_metadata
from pam_orthosis.cli import main as cli
from pam_orthosis.discrepancy import workflow
from pam_orthosis.discrepancy.answer import judgement, noise_floor, patch
from pam_orthosis.discrepancy.answer.contract import as_dict, identifiability_as_dict
from pam_orthosis.discrepancy.answer.last_line import last_line
from pam_orthosis.discrepancy.answer.verdict import describe, describe_data
from pam_orthosis.discrepancy.apparatus import agreed_nominal, apparatus_of, recorded_nominal, unrecorded
from pam_orthosis.discrepancy.fitting import structure
from pam_orthosis.discrepancy.fitting.measure import Gap
from pam_orthosis.discrepancy.preparation import beginning, check
from pam_orthosis.discrepancy.preparation import identifiability as of_data
from pam_orthosis.discrepancy.preparation.beginning import begin
from pam_orthosis.discrepancy.preparation.identifiability import Astray, Identifiability, identifiability
from pam_orthosis.discrepancy.recordings.data import (
    from_arrays,
    from_bag,
    from_csv,
    is_table,
)
from pam_orthosis.discrepancy.replay.replay import Replay
from pam_orthosis.discrepancy.request import unrecorded_words
from pam_orthosis.discrepancy.search import confirmation, findings, selection
from pam_orthosis.discrepancy.search.findings import Named, in_all
from pam_orthosis.discrepancy.systems import knee
from pam_orthosis.discrepancy.workers import Workers
from pam_orthosis.discrepancy.workflow import find_gap
from pam_orthosis.errors import OrthosisError
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.report import gap as gap_page
from pam_orthosis.report import gap_figures

FRICTION = {"plant__effects__joint_friction__enabled": True, "plant__effects__joint_friction__coulomb": 0.6}
COLUMNS = ("time", "angle", "extensor_pressure", "flexor_pressure", "extensor_voltage", "flexor_voltage")


def search(bench, replay=None, **plant):
    training = [bench.recording(1, **plant), bench.recording(2, cycle_time=1.4, **plant)]
    held_out = [bench.recording(3, cycle_time=1.7, **plant)]
    return find_gap(bench.system, training, held_out, bench.parameters.gap, replay=replay or bench.replay)


@pytest.fixture(scope="module")
def friction(bench):
    return search(bench, **FRICTION)


DOCS = Path(__file__).resolve().parents[2] / "docs"


def without_delay(folder):
    """Return the options of `gap` for recordings of the bench, whose loop has no delay."""
    model = folder / "prompt.yaml"
    model.write_text("valve.delay: 0.0\n")
    return ["--model", str(model)]


def table(path, arrays, columns=COLUMNS):
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(columns)
        writer.writerows(zip(*(arrays[name] for name in columns), strict=True))
    return path


def test_nothing_hidden_is_none(bench):
    outcome = search(bench)
    assert outcome.verdict == "none"
    assert outcome.effects == ()
    assert outcome.after.white["overall"] == pytest.approx(1.0, abs=0.05)


def test_friction_is_named_measured_and_closes_the_gap(friction):
    assert friction.verdict == "explained"
    assert [one.name for one in friction.effects] == ["joint_friction"]
    value, unit, low, high = friction.effects[0].parameters["coulomb"]
    assert unit == "N m"
    assert value == pytest.approx(0.6, rel=0.1)
    assert low < value < high
    assert friction.closure["overall"] > 0.95
    assert friction.where[0].equation == "torque"
    assert friction.before.units["angle"] > 3 * friction.after.units["angle"]


BOTH = {
    "plant__effects__joint_friction__enabled": True, "plant__effects__joint_friction__coulomb": 0.8,
    "plant__effects__muscle_hysteresis__enabled": True,
}  # fmt: skip


def test_friction_and_hysteresis_are_named_apart(bench):
    outcome = search(bench, **BOTH)
    assert outcome.verdict == "explained"
    named = {one.name: one.parameters for one in outcome.effects}
    assert set(named) == {"joint_friction", "muscle_hysteresis"}
    assert named["joint_friction"]["coulomb"][0] == pytest.approx(0.8, rel=0.1)
    assert named["muscle_hysteresis"]["half_width"][0] == pytest.approx(12.0, rel=0.1)


def test_one_process_gives_the_same_answer_to_the_last_digit(bench, friction):
    """That of `friction` was found by two."""
    alone = search(bench, Replay(bench.system, Workers(1)), **FRICTION)
    assert alone.selection.final.values == friction.selection.final.values
    assert alone.after.white == friction.after.white
    assert as_dict(alone) == as_dict(friction)


def test_gap_json_keeps_its_contract(friction):
    reported = json.loads(json.dumps(as_dict(friction)))
    assert reported["verdict"] == "explained"
    assert set(reported["effects"][0]) == {
        "name", "wrong_parameter", "equation", "parameters", "evidence", "look_alikes", "with_both",
        "separated_by"
    }  # fmt: skip
    assert reported["look_alikes"] == reported["effects"][0]["look_alikes"]
    assert reported["separated_by"] == reported["effects"][0]["separated_by"]
    assert set(reported["effects"][0]["parameters"]["coulomb"]) == {"value", "unit", "interval", "at_bound"}
    for key in ("gap_before", "gap_after", "noise_floor", "closure"):
        assert set(reported[key]) == {"angle", "extensor_pressure", "flexor_pressure", "overall"}
    assert reported["runner_up"]["behind"] > 0


@pytest.mark.parametrize(
    ("ranked", "reason", "said"),
    [
        ((), "no effect gains anything", "; nothing in the catalogue fits"),
        (
            (("creep", 90.0),),
            "held-out recordings do not confirm it",
            "(best: creep): held-out recordings do not",
        ),
    ],
)
def test_an_answer_without_a_name_says_why(ranked, reason, said):
    place = structure.Where("torque", 81.0, {}, {})
    step = SimpleNamespace(accepted=None, ranked=ranked, reason=reason)
    torque = SimpleNamespace(name="torque", channels=("angle",))
    outcome = SimpleNamespace(
        verdict="unexplained", effects=(), surrogates=(), empty=(), left=[place], steps=[step],
        closure={"overall": 0.0}, unknown=None, strained={}, foreign=False, mistaken=False, skewed=False,
        system=SimpleNamespace(equations=[torque], wrong={}, inputs=(), sensed=()),
        after=Gap({}, {"angle": 9.0}), floor=Gap({}, {"angle": 1.0}),
    )  # fmt: skip
    assert said in last_line(outcome)
    assert "in the torque equation 9.0 times the noise is left" in last_line(outcome)


@pytest.mark.parametrize(("times", "verdict"), [(2.0, "none"), (5.0, "unexplained")])
def test_a_slow_gap_that_whitened_residuals_hardly_show_is_left(times, verdict):
    white = {"angle": 1.1, "overall": 1.1}
    after, floor = Gap({"angle": 1e-4 * times}, white), Gap({"angle": 1e-4}, dict.fromkeys(white, 1.0))
    far = judgement.off(after, floor)
    rest = judgement.Rest(not judgement.beyond(after, floor), 1.1, False, channel_off=bool(far))
    assert far == ({} if verdict == "none" else {"angle": pytest.approx(5.0)})
    assert judgement.verdict_on((), None, rest, ()) == verdict
    assert judgement.verdict_on(("creep",), 0.99, rest, ()) == ("partial" if far else "explained")
    outcome = SimpleNamespace(
        verdict=verdict, effects=(), surrogates=(), empty=(), steps=(), unknown=None, strained={},
        left=[structure.Where("torque", 0.9, {}, {})], closure={"overall": None}, foreign=False,
        mistaken=False, skewed=False, configured=floor, system=SimpleNamespace(
            equations=[SimpleNamespace(name="torque", channels=("angle",))], wrong={}, inputs=(), sensed=(),
            calibrations=(),
        ),
        after=after, floor=floor, selection=SimpleNamespace(final=SimpleNamespace(free=())),
    )  # fmt: skip
    said = "angle is 5.0 times as far off as noise alone leaves it" if far else "leaves noise only"
    assert said in last_line(outcome)


@pytest.mark.parametrize(
    ("residual", "after", "said"),
    [
        (0.9, 1.02, "creep explains 99.9 % of the gap; noise only is left, but nuisance parameters are far"),
        (0.9, 1.6, "in the torque equation 1.6 times the noise is left, and nuisance parameters are far"),
        (9.0, 1.02, "left in the torque equation is small, but more than noise, and nuisance parameters are"),
    ],
)
def test_what_is_left_is_called_noise_where_it_is(residual, after, said):
    torque = SimpleNamespace(name="torque", channels=("angle",))
    outcome = SimpleNamespace(
        verdict="partial", effects=[SimpleNamespace(name="creep", look_alikes=())], surrogates=(), empty=(),
        left=[structure.Where("torque", residual, {}, {})], steps=(), unknown=None, strained={"supply": 7.0},
        closure={"overall": 0.999}, foreign=False, mistaken=False, skewed=False,
        system=SimpleNamespace(equations=[torque], wrong={}, inputs=(), sensed=()),
        after=Gap({}, {"angle": after, "overall": after}), floor=Gap({}, {"angle": 1.0, "overall": 1.0}),
    )  # fmt: skip
    assert said in last_line(outcome)


def test_a_closure_says_the_gap_that_it_counts_from(friction):
    """What recalibration has closed already is no merit of the effect."""
    gaps = Gap({}, {"torque": 3.0, "gas": 1.01}), Gap({}, {"torque": 1.0, "gas": 1.0})
    closed = {"torque": 0.99, "gas": 0.98}
    assert judgement._from_configured(*gaps, closed) == ("gas",)
    assert judgement._from_configured(*gaps, {"torque": 0.99, "gas": None}) == ()
    assert as_dict(friction)["closure_baseline"]["angle"] == "before"
    marked = replace(friction, from_configured=("angle",))
    assert as_dict(marked)["closure_baseline"]["angle"] == "configured"
    rows = {line.split()[0]: line for line in describe(marked).splitlines()}
    assert rows["angle"].endswith(" % *")
    assert "of the nominal model's gap" in rows["*"]
    assert not rows["times"].endswith("*")


def test_the_model_file_switches_the_effect_on_and_changes_nothing_else(friction, bench, tmp_path):
    final = friction.selection.final
    patch.write(tmp_path / "model.yaml", patch.overrides(friction.system, final.effects, final.values))
    changed, plain = load(patch.read(tmp_path / "model.yaml")).flat(), load().flat()
    different = {key for key in plain if plain[key] != changed[key]}
    assert "effects.joint_friction.enabled" in different
    assert all(key.startswith("effects.joint_friction.") for key in different)


def test_the_effect_added_to_the_model_leaves_nothing_to_find(friction, bench):
    final = friction.selection.final
    added = patch.overrides(friction.system, final.effects, final.values)
    system = type(bench)().system  # the plain model
    assert "joint_friction" in system.candidates
    known = knee.knee(bench.parameters.changed(added))
    assert "joint_friction" not in known.candidates
    outcome = find_gap(
        known, [bench.recording(1, **FRICTION)], [bench.recording(3, 1.7, **FRICTION)], bench.parameters.gap
    )
    assert outcome.verdict == "none"
    assert outcome.floor.white["overall"] == pytest.approx(1.0, abs=0.05)
    earned, equations = outcome.selection.present["joint_friction"]
    assert equations == {"torque"}
    assert earned > 0.2 * friction.selection.evidence["joint_friction"]
    # what its form leaves over is not taken for another small effect
    assert (
        selection.threshold(outcome.selection, "viscous_friction", bench.parameters.gap.evidence)
        > 0.09 * earned
    )


def test_a_catalogue_that_is_used_up_ends_the_search(bench):
    only = {"joint_friction": KNEE.catalogue["joint_friction"]}
    few = knee.knee(bench.parameters, only)
    training, held_out = bench.recording(1, **FRICTION), bench.recording(3, 1.7, **FRICTION)
    outcome = find_gap(few, [training], [held_out], bench.parameters.gap)
    assert [one.name for one in outcome.effects] == list(only)


def test_without_voltages_the_torque_is_judged_and_the_rest_is_said(bench, tmp_path):
    files = [table(tmp_path / f"{seed}.csv", bench.arrays(seed, **FRICTION), COLUMNS[:4]) for seed in (1, 2)]
    recordings = [from_csv(file, bench.system) for file in files]
    outcome = find_gap(bench.system, recordings[:1], recordings[1:], bench.parameters.gap)
    assert [one.name for one in outcome.effects] == ["joint_friction"]
    assert any("extensor_voltage" in remark for remark in outcome.remarks)
    assert set(outcome.after.units) == {"angle"}


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (COLUMNS, "these data show and separate all effects of the catalogue"),
        (COLUMNS[:4], "these data cannot show, without extensor_voltage and flexor_voltage: valve_lag"),
        (COLUMNS[:5], "these data cannot show, without flexor_voltage: valve_lag"),
    ],
)
def test_what_cannot_show_without_voltages_is_named(bench, columns, said):
    catalogue = {name: KNEE.catalogue[name] for name in ("joint_friction", "valve_lag")}
    few = knee.knee(bench.parameters, catalogue)
    arrays = [{name: bench.arrays(seed)[name] for name in columns} for seed in (1, 2)]
    fitted, judged = (from_arrays("run", few, one) for one in arrays)
    start = begin(few, [fitted], [judged], bench.parameters.gap)
    data = identifiability(start.problem, start.null, 15.0, whole=start.whole, missing=start.missing)
    assert describe_data(data).splitlines()[0] == said
    assert ("valve_lag" in identifiability_as_dict(data)["hidden"]) == bool(start.missing)


def test_an_effect_without_a_finite_number_is_said_with_all_its_equations():
    data = Identifiability({}, (), (), (), astray=(Astray("stray", ("gas", "torque"), True),))
    assert describe_data(data).startswith("in these data the gas and torque equations give no finite number")
    assert identifiability_as_dict(data)["astray"] == {"stray": ["gas", "torque"]}


def test_the_verb_names_what_cannot_show_without_voltages(bench, tmp_path, capsys):
    files = [str(table(tmp_path / f"{seed}.csv", bench.arrays(seed), COLUMNS[:4])) for seed in (1, 2)]
    assert cli.main(["gap", files[0], "--held-out", files[1], "--until", "check"]) == 0
    said = next(one for one in capsys.readouterr().out.splitlines() if "cannot show, without" in one)
    assert {"valve_lag", "valve_delay", "extensor_leak"} <= {*said.partition(": ")[2].split(", ")}


def test_a_map_that_recordings_leave_is_told_before_the_search(bench, tmp_path, capsys, monkeypatch):
    files = [str(table(tmp_path / f"{seed}.csv", bench.arrays(seed))) for seed in (1, 2)]
    model = tmp_path / "muscle.yaml"
    model.write_text("muscle.dmsp_20.box.maximum_pressure_gauge: 3.0e+5\n", encoding="utf-8")
    monkeypatch.setattr(of_data, "identifiability", lambda *_: Identifiability({}, (), (), ()))

    def ended(start, *_):
        raise OrthosisError("; ".join(start.remarks))

    monkeypatch.setattr(workflow, "search", ended)
    command = ["gap", files[0], "--held-out", files[1], "--model", str(model)]
    said = "extensor_pressure leaves the box of the muscle's map (1013 to 4013 mbar) in "
    assert cli.main([*command, "--until", "check"]) == 0
    assert f"remark: {said}" in capsys.readouterr().out
    assert cli.main(command) == 2
    assert f"remark: {said}" in (told := capsys.readouterr().err)
    assert f"; {said}" in told


def test_one_voltage_alone_is_not_called_absent(bench):
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS if name != "extensor_voltage"}
    (told, *rest) = check.check(bench.system, [from_arrays("x", bench.system, arrays)], 2.0)
    assert told.endswith(
        "no extensor_voltage: what it drives cannot be judged, nor what flexor_voltage drives"
    )
    assert not any("has no flexor_voltage" in one for one in rest)


def test_the_verb_writes_json_model_and_page(bench, tmp_path, capsys, page_fits):
    files = [str(table(tmp_path / f"{seed}.csv", bench.arrays(seed, **FRICTION))) for seed in (1, 2)]
    out, nominal = tmp_path / "out", without_delay(tmp_path)
    for_gap = {"scenario.control_period": 0.002, "gap.evidence.effects": 1}
    with open(nominal[1], "a", encoding="utf-8") as stream:
        stream.writelines(f"{key}: {value}\n" for key, value in {**for_gap, "scenario.seed": 3}.items())
    written = ["--out", str(out), "--next", str(tmp_path / "next.csv"), "--json"]
    status = cli.main(["gap", files[0], "--held-out", files[1], *nominal, *written])
    reported = json.loads(capsys.readouterr().out)
    assert status == 0
    assert reported == json.loads((out / "gap.json").read_text())
    reference = (DOCS / "reference" / "files.md").read_text(encoding="utf-8")
    assert [key for key in reported if f"`{key}`" not in reference] == []
    assert reported["apparatus_assumed"] == files  # a table does not say of what it is
    assert reported["effects"][0]["name"] == "joint_friction"
    assert (
        (tmp_path / "next.csv")
        .read_text()
        .startswith("time,reference_angle,mean_pressure,valves_closed\n0.00,")
    )
    page = (out / "gap.html").read_text()
    assert "<pre>the apparatus is assumed: " in page
    assert "Missing is joint friction: it closes" in page
    assert f"{reported['effects'][0]['parameters']['coulomb']['value']:.4g} N m" in page
    assert "missing in angle" in page
    model = out / "model.yaml"
    found = patch.read(model)
    assert for_gap.items() <= found.items()
    assert patch.read_nominal(model).keys() == found.keys() - for_gap.keys()  # any verb can take it
    assert load(found).effects.joint_friction.enabled
    assert cli.main(["gap", *files, "--model", str(model), "--until", "check"]) == 0
    page_fits(out / "gap.html")


def test_the_noise_floor_is_that_of_the_recordings_that_judge(bench):
    """Sensors may be worse on the day of the judgement: their noise is no gap that could be closed."""
    quiet = bench.recording(1)
    loud = bench.recording(
        2, plant__sensor__pressure_noise=1.5 * bench.parameters.plant.sensor.pressure_noise
    )
    outcome = find_gap(bench.system, [quiet], [loud], bench.parameters.gap)
    for muscle in ("extensor_pressure", "flexor_pressure"):
        assert outcome.after.white[muscle] > 1.4
        assert outcome.floor.white[muscle] == pytest.approx(outcome.after.white[muscle], rel=0.05)


def test_the_noise_floor_of_a_model_with_effects_counts_from_the_whiteners_noise(friction, monkeypatch):
    """Whiteners and units are made with the bare model's noise; so is what the floor is divided by."""
    seen, bare = [], SimpleNamespace(defaults=lambda _: {})

    def levels(replay, runs, settings, effects, values):
        seen.append(replay)
        return dict.fromkeys(friction.floor.units, 2.0 if replay is bare else 3.0)

    monkeypatch.setattr(noise_floor, "residual_noise", levels)
    monkeypatch.setattr(beginning, "Replay", lambda system, workers: system)
    system = SimpleNamespace(simpler={"joint_friction": None}, bare=lambda: bare)
    replay = SimpleNamespace(system=system, defaults=lambda _: {}, workers=None)
    problem = SimpleNamespace(replay=replay, scored=[])
    found = SimpleNamespace(problem=problem, final=SimpleNamespace(effects=(), values={}))
    units = dict.fromkeys(friction.floor.units, 1.0)
    start = SimpleNamespace(floor=Gap(units, {**units, "overall": 1.0}), held_out=SimpleNamespace(scored=[]))
    floor = noise_floor.final_floor(start, found, None)
    assert seen == [bare, replay]
    assert floor.white["angle"] == pytest.approx(1.5)


def test_the_page_draws_what_is_missing_over_every_signal(friction, monkeypatch):
    names = list(friction.where[0].coordinates)
    assert {"phase", "time", "velocity", "angle"} <= set(names)
    for name in names:
        monkeypatch.setattr(gap_figures, "_coordinate", lambda outcome, effect, place, name=name: name)
        (plot,) = gap_figures.missing(friction)
        assert plot.x.startswith(name.replace("_", " "))


def test_the_page_shows_each_effect_where_it_lives(friction):
    """A dead band in the gas over the voltage of its muscle, friction in the torque over the velocity."""
    dead_band = replace(friction.effects[0], name="valve_dead_band")
    lag = replace(dead_band, name="valve_lag")
    both = replace(friction, effects=(dead_band, *friction.effects, lag))
    panels = [
        (title, equation.name, channels, name)
        for title, equation, channels, name in gap_figures._panels(both)
    ]
    assert panels == [
        ("valve dead band and valve lag", "gas", ("extensor_pressure",), "extensor_voltage"),
        ("joint friction", "torque", ("angle",), "velocity"),
    ]
    assert len(gap_figures.missing(both)) == 2
    nothing = replace(friction, effects=())
    assert [(title, e.name) for title, e, *_ in gap_figures._panels(nothing)] == [("", "torque")]


def test_stages_can_be_read_one_by_one(bench, tmp_path, capsys):
    files = [str(table(tmp_path / f"{seed}.csv", bench.arrays(seed, **FRICTION))) for seed in (1, 2)]
    nominal = without_delay(tmp_path)
    assert cli.main(["gap", files[0], "--held-out", files[1], *nominal, "--until", "where"]) == 0
    reported = capsys.readouterr().out
    assert reported.startswith(
        f"the apparatus is assumed: {files[0]} and 1 more without a record of parameters,"
    )
    torque, gas = reported[reported.index("torque equation") :], reported[reported.index("gas equation") :]
    assert "above the noise" in torque.splitlines()[0]
    assert "above the noise" not in gas.splitlines()[0]
    assert "velocity explains" in torque.splitlines()[1]
    angle = next(line for line in reported.splitlines() if line.startswith("angle [deg]"))
    configured, recalibrated, noise = (float(word) for word in angle.split()[2:])
    assert configured > recalibrated > 5 * noise
    assert cli.main(["gap", files[0], "--until", "check", "--json"]) == 2


def test_data_identify_what_they_can_show_and_what_looks_alike(bench):
    """A walk shows what moves the knee; two dead volumes change it in the same way, a small torque hides."""
    settings = bench.parameters.gap
    start = begin(bench.system, [bench.recording(1)], [bench.recording(2)], settings, replay=bench.replay)
    reported = identifiability(start.problem, start.null, settings.evidence.threshold)
    assert reported.evidence["joint_friction"] > 1000
    assert reported.evidence["valve_dead_band"] > 1000
    pairs = [{a, b} for a, b, _ in reported.alike]
    assert {"extensor_dead_volume", "flexor_dead_volume"} in pairs
    assert {"joint_friction", "valve_dead_band"} not in pairs
    assert not any(pair & set(reported.invisible) for pair in pairs)
    assert all(scenario.startswith("diagnostic-") for scenario in reported.experiments)
    # the effects name it, but a recording of it cannot be searched
    assert "diagnostic-locked" in bench.system.catalogue["valve_lag"].separated_by
    assert "diagnostic-locked" not in reported.experiments
    apart = [bench.system.experiments(name) for name in ("valve_lag", "flexor_dead_volume")]
    assert apart == [(), ("diagnostic-decay",)]


def test_held_out_data_without_excitation_are_refused(bench):
    """Trap 8: a recording at rest would veto every true effect."""
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    still = from_arrays("still", bench.system, {**arrays, "angle": np.full_like(arrays["angle"], 0.6)})
    with pytest.raises(OrthosisError, match="still: angle hardly changes"):
        find_gap(bench.system, [bench.recording(1)], [still], bench.parameters.gap)


@pytest.mark.parametrize("purpose", ["the fit", "the judgement"])
def test_a_channel_that_shows_noise_only_is_refused(bench, purpose):
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(bench.arrays(1)["time"]))
    rest = from_arrays("rest", bench.system, {**bench.arrays(1), "angle": 0.6 + noise})
    pair = [[rest], [bench.recording(1)]][:: 1 if purpose == "the fit" else -1]
    with pytest.raises(OrthosisError, match=f"rest: angle does not move beyond 20 .*; {purpose} needs"):
        find_gap(bench.system, *pair, bench.parameters.gap, replay=bench.replay)
    # a locked knee beside one that walks is of use
    check.check_motion(bench.system, [rest, bench.recording(1)], purpose)


def test_samples_held_in_motion_are_refused_and_a_coarse_encoder_is_not(bench):
    recording = bench.recording(1)

    def checked(change):
        signals = {**recording.signals, "angle": change(recording.signals["angle"])}
        check.check(bench.system, [replace(recording, signals=signals)], 2.0)

    checked(lambda angle: np.round(angle / 0.01) * 0.01)
    for every in (3, 5):
        with pytest.raises(OrthosisError, match="of angle repeat the one before in motion"):
            checked(lambda angle, every=every: np.repeat(angle[::every], every)[: len(angle)])


def broken(name, change):
    return pytest.param(name, change, id=name)


@pytest.mark.parametrize(
    ("reason", "change"),
    [
        broken("not uniform", lambda a: {k: np.delete(v, np.s_[3000::9]) for k, v in a.items()}),
        broken(
            "is infinite", lambda a: {**a, "angle": np.where(a["time"] == a["time"][9], np.inf, a["angle"])}
        ),
        broken("hardly changes", lambda a: {**a, "flexor_pressure": np.full_like(a["time"], 3e5)}),
        broken("lower rate", lambda a: {**a, "angle": np.repeat(a["angle"][::20], 20)[: len(a["time"])]}),
        broken("no signal", lambda a: {k: v for k, v in a.items() if k != "angle"}),
        broken("lasts 3.0 s: the search needs 5 s", lambda a: {k: v[:1500] for k, v in a.items()}),
        broken(
            "has 280 samples, one every 50 ms: the search needs 500",
            lambda a: {k: v[::25] for k, v in a.items()},
        ),
    ],
)
def test_unfit_data_stop_with_the_reason(bench, reason, change):
    arrays = change({name: bench.arrays(1)[name] for name in COLUMNS})
    with pytest.raises(OrthosisError, match=reason):
        find_gap(bench.system, [from_arrays("x", bench.system, arrays)], [], bench.parameters.gap)


def test_a_copy_of_what_is_fitted_does_not_judge(bench):
    """By another name, another clock, at a lower rate, or a part of it."""
    fitted = bench.recording(1)
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    copies = [
        {**arrays, "time": arrays["time"] + 100.0},
        {name: values[::5] for name, values in arrays.items()},
        {name: values[:5000] for name, values in arrays.items()},
        {name: np.array([float(f"{value:.9g}") for value in values]) for name, values in arrays.items()},
    ]
    for one in copies:
        copy = from_arrays("copy", bench.system, one)
        with pytest.raises(OrthosisError, match=r"copy: .* of its samples are those of run 1; what was"):
            check.check_unseen([bench.recording(2), fitted], [copy])
        for training, held_out in (([fitted, copy], []), ([bench.recording(2)], [fitted, copy])):
            with pytest.raises(OrthosisError, match="those of run 1; give each recording once"):
                check.check_unseen(training, held_out)
    check.check_unseen([fitted], [bench.recording(2)])
    with pytest.raises(OrthosisError, match="cannot judge"):
        find_gap(bench.system, [fitted], [from_arrays("copy", bench.system, arrays)], bench.parameters.gap)


def test_coarse_readings_of_two_slow_motions_are_no_copies(bench):
    """Rows recur where few values are possible; sequences of them do not."""
    coarse = [
        from_arrays(name, bench.system, {key: _coarse(bench.arrays(seed), key) for key in COLUMNS})
        for name, seed in (("one", 1), ("other", 2))
    ]
    rows = [{*zip(*(one.signals[name] for name in sorted(one.signals)), strict=True)} for one in coarse]
    assert len(rows[1] & rows[0]) > 0.5 * len(rows[1]), "else nothing is asked of the check"
    check.check_unseen(coarse[:1], coarse[1:])


def _coarse(arrays, key):
    """Return a column with few different values, all but one of them at rest."""
    if key == "time":
        return arrays[key]
    noise = np.random.default_rng(int(1e6 * arrays[key][-1] % 1e6)).integers(0, 5, len(arrays[key]))
    return (
        0.2 + 0.1 * np.round(5 * arrays[key]) + 0.01 * noise
        if key == "angle"
        else np.full_like(arrays[key], 2e5)
    )


def test_a_delay_beside_the_models_is_told_with_both(bench):
    """Alone, a negative one reads as nonsense."""
    late = replace(bench.system, late=0.0099)
    one = Named("valve_delay", "gas", {"delay": (-0.0098, "s", -0.0099, -0.0097)}, 1e5)
    assert in_all(late, one) == " beside the 9.9 ms that the model has (0.10 ms in all)"
    assert in_all(bench.system, one) == ""
    other = Named("joint_friction", "torque", {"coulomb": (0.4, "N m", 0.3, 0.5)}, 1e5)
    assert in_all(late, other) == ""


def test_the_second_of_a_round_is_compared_with_the_others_not_with_itself(bench):
    """The best effect of a round may be refused by held-out data and the next one accepted."""
    ranked = (("creep", 900.0), ("backlash", 400.0), ("stretch_reflex", 395.0), ("valve_lag", 5.0))
    step = SimpleNamespace(accepted="backlash", fit=None, ranked=ranked, evidence=400.0)
    final, problem = SimpleNamespace(effects=["backlash"]), bench.problem
    found = SimpleNamespace(final=final, steps=[step], problem=problem, both={})
    settings = bench.parameters.gap.evidence
    assert findings._look_alikes(found, "backlash", settings) == ("creep", "stretch_reflex")
    assert findings.runner_up_of(found) == ("creep", -500.0)
    nothing = SimpleNamespace(final=SimpleNamespace(effects=[]), steps=[])
    assert findings.runner_up_of(nothing) is None
    assert findings.first_accepted(nothing, ()) is None


def test_each_effect_has_its_own_look_alikes_and_none_that_is_named(friction, bench):
    rounds = [
        ("backlash", (("backlash", 400.0), ("valve_lag", 398.0), ("creep", 395.0))),
        # in silence the ranking has evidence of its own
        ("valve_lag", (("valve_lag", 60.0), ("valve_delay", 58.0), ("backlash", 57.0))),
    ]
    steps = [
        SimpleNamespace(accepted=name, fit=None, ranked=ranked, evidence=400.0) for name, ranked in rounds
    ]
    final = SimpleNamespace(effects=["backlash", "valve_lag"])
    found = SimpleNamespace(final=final, steps=steps, problem=bench.problem, both={})
    settings = bench.parameters.gap.evidence
    assert findings._look_alikes(found, "backlash", settings) == ("creep",)
    assert findings._look_alikes(found, "valve_lag", settings) == ("valve_delay",)
    assert findings.runner_up_of(found) == ("creep", 5.0)
    first = replace(friction.effects[0], name="backlash", look_alikes=("creep",))
    second = replace(
        first, name="valve_lag", look_alikes=("valve_delay",), separated_by=("diagnostic-cocontraction",)
    )
    assert findings.first_accepted(found, [second, first]) is first
    reported = describe(replace(friction, effects=(first, second), look_alikes=("creep",)))
    assert (
        "do not separate backlash from: creep; the size holds if nothing of that is there too\n" in reported
    )
    assert "do not separate valve_lag from: valve_delay; the size" in reported
    assert "--scenario diagnostic-cocontraction" in reported
    assert as_dict(replace(friction, effects=(first, second)))["effects"][0]["with_both"] == {}


def test_what_does_as_well_beside_an_effect_is_told_with_both_sizes(friction, bench):
    """Details of friction can do what a hysteresis does: its size then is that of both."""
    values = {**friction.selection.final.values, "muscle_hysteresis.half_width": 12.0}
    both = {"joint_friction": {"muscle_hysteresis": {**values, "joint_friction.coulomb": 0.4}}}
    found, settings = replace(friction.selection, both=both), bench.parameters.gap.evidence
    deviation = np.full(len(found.final.free), 1e-3)
    (one,) = (findings.named_effect(bench.system, found, deviation, "joint_friction", settings),)
    assert one.look_alikes == ("muscle_hysteresis",)
    assert one.parameters["coulomb"][2] == 0.4  # its interval holds that size too
    reported = replace(friction, effects=(one,), look_alikes=one.look_alikes)
    said = "separate it from: muscle_hysteresis; with muscle_hysteresis (12 N) it is 0.4 N m, which explains"
    assert said in describe(reported)
    assert last_line(reported) == "EXPLAINED by joint friction (or 0.4 N m with muscle hysteresis)"
    assert as_dict(reported)["effects"][0]["with_both"] == {
        "muscle_hysteresis": [{"value": 0.4, "unit": "N m"}, {"value": 12.0, "unit": "N"}]
    }
    dropped = replace(found, both={}, dropped=["parallel_elasticity", "valve_lag"])
    assert findings._taken_by(dropped, "force_map_misfit") == ["parallel_elasticity"]
    named = replace(found, final=replace(found.final, effects=("joint_friction", "muscle_hysteresis")))
    assert "muscle_hysteresis" not in findings._look_alikes(named, "joint_friction", settings)


@pytest.mark.parametrize(
    ("excess", "sensor", "alike"),
    [
        (0.06, 13.7, ("flexor_pressure_gain",)),
        (0.06, 12.0, ()),
        (1.0, 13.7, ()),  # what recalibration leaves tells them apart
    ],
)
def test_a_sensor_may_be_what_a_wrong_parameter_does_where_tolerances_decide(bench, excess, sensor, alike):
    ranked = (("valve_supply_pressure", 26.1), ("flexor_pressure_gain", sensor), ("valve_lag", 13.7))
    step = SimpleNamespace(accepted="valve_supply_pressure", fit=None, ranked=ranked, evidence=26.1)
    final = SimpleNamespace(effects=["valve_supply_pressure"])
    problem = bench.problem.weighted({"torque": 1.0, "gas": (1 + excess) ** -0.5})
    found = SimpleNamespace(final=final, steps=[step], problem=problem, both={})
    assert findings._look_alikes(found, "valve_supply_pressure", bench.parameters.gap.evidence) == alike


def test_an_effect_of_another_equation_is_no_look_alike(bench):
    ranked = (
        ("valve_delay", 400.0),
        ("muscle_hysteresis", 399.0),
        ("valve_lag", 398.0),
        ("angle_delay", 397.0),
    )
    step = SimpleNamespace(accepted="valve_delay", fit=None, ranked=ranked, evidence=400.0)
    final = SimpleNamespace(effects=["valve_delay"])
    found = SimpleNamespace(final=final, steps=[step], problem=bench.problem, both={})
    assert findings._look_alikes(found, "valve_delay", bench.parameters.gap.evidence) == (
        "valve_lag",
        "angle_delay",
    )
    assert findings.runner_up_of(found) == ("valve_lag", 2.0)


def test_what_is_left_although_it_is_explained_is_reported(friction):
    left = [structure.Where("torque", 9.04, {}, {}), structure.Where("gas", 1.1, {}, {})]
    white = {**friction.after.white, "angle": 2.0 * friction.floor.white["angle"]}
    after = Gap(friction.after.units, white)
    reported = describe(replace(friction, verdict="explained", left=left, after=after)).splitlines()
    assert reported[-2] == "left in the torque equation: 2.0 times the noise"
    assert not any(line.startswith("left in the gas") for line in reported)
    quiet = {"left": left[1:], "after": Gap(friction.after.units, {**friction.after.white, "overall": 1.5})}
    reported = describe(replace(friction, verdict="explained", **quiet)).splitlines()
    assert reported[-2].startswith("left in the held-out recordings: a gap of 1.5 times")
    assert "left in" not in describe(friction)


def test_a_recording_that_is_too_short_to_divide_is_refused(bench):
    recording = bench.recording(1)
    short = recording.part(0, round(8.0 / recording.period), "short")
    with pytest.raises(OrthosisError, match=r"short lasts 8.0 s: too short .* --held-out"):
        find_gap(bench.system, [short], [], bench.parameters.gap, replay=bench.replay)


@pytest.mark.filterwarnings("error")
def test_one_block_of_held_out_time_has_no_t_value(monkeypatch):
    monkeypatch.setattr(confirmation, "_falls", lambda falls, *_: (np.array(falls), 7.0))
    assert confirmation.confirmed([2.0, 2.0], [3.0], None, None) == (0.0, 1.5, 3.0, 7.0)
    seen = confirmation.confirmed([2.0, 2.0], [3.0, 3.5, 2.5], None, None)
    assert seen.t == pytest.approx(3.0 / (0.5 / np.sqrt(3)))


def spoilt(name, said, change):
    return pytest.param(said, change, id=name)


def test_the_least_pressure_is_that_of_the_place(bench, tmp_path):
    """A laboratory at altitude, 67.6 kPa, gives its ambient pressure; gauge pressures count from it, too."""
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    gauge = arrays["flexor_pressure"] - arrays["flexor_pressure"].min()
    arrays["flexor_pressure"] = gauge + 67.6e3
    file = table(tmp_path / "x.csv", arrays)
    with pytest.raises(OrthosisError, match=r"is 80027 or more where .* 101300: .* valve\.ambient_pressure"):
        from_csv(file, bench.system)
    high = knee.knee(bench.parameters.changed({"valve.ambient_pressure": 67.6e3}))
    assert from_csv(file, high).signals["flexor_pressure"].min() == pytest.approx(67.6e3)
    names = [name.replace("flexor_pressure", "flexor_pressure (Pa gauge)") for name in COLUMNS]
    file = table(tmp_path / "y.csv", {**arrays, "flexor_pressure (Pa gauge)": gauge}, names)
    assert from_csv(file, high).signals["flexor_pressure"].min() == pytest.approx(67.6e3)


@pytest.mark.parametrize(
    ("said", "change"),
    [
        spoilt(
            "degrees", r"angle from .* leaves -0.3 to 1.8 rad in .*; check its unit", ("angle", np.degrees)
        ),
        spoilt("milliseconds", r"samples are 2 apart; time must be in s \(is it in ms\?\)", ("time", 1e3)),
        spoilt("bar", "extensor_pressure from .* in bar, or gauge", ("extensor_pressure", 1e-5)),
        spoilt(
            "gauge", "flexor_pressure from .* in bar, or gauge", ("flexor_pressure", lambda p: p - p.min())
        ),
        spoilt("tenfold", "flexor_pressure from .* leaves 80027 to 1.*e.06 Pa", ("flexor_pressure", 10.0)),
        spoilt("millivolt", "extensor_voltage from .* leaves -2 to 12 V", ("extensor_voltage", 1e3)),
    ],
)
def test_a_table_in_other_units_is_refused(bench, tmp_path, said, change):
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    name, how = change
    arrays[name] = how(arrays[name]) if callable(how) else how * arrays[name]
    with pytest.raises(OrthosisError, match=said):
        from_csv(table(tmp_path / "x.csv", arrays), bench.system)


def test_a_bag_in_other_units_is_refused(bench, tmp_path):
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    stamps = np.round(arrays.pop("time") * 1e9).astype(np.int64)
    for factor in (1.0, 1e-5, 10.0):
        spoilt = arrays | {"extensor_pressure": factor * arrays["extensor_pressure"]}
        write_arrays(tmp_path / f"{factor:g}", stamps, spoilt, {})
        if factor == 1.0:
            assert set(from_bag(tmp_path / "1", bench.system).signals) == set(arrays)
        else:
            with pytest.raises(OrthosisError, match="extensor_pressure from"):
                from_bag(tmp_path / f"{factor:g}", bench.system)


def test_a_replay_that_runs_away_is_refused(bench):
    arrays = {name: bench.arrays(1)[name] for name in COLUMNS}
    wild = from_arrays("wild", bench.system, {**arrays, "angle": np.degrees(arrays["angle"])})
    with pytest.raises(OrthosisError, match="wild: the replay of the torque equation runs away"):
        find_gap(bench.system, [wild], [bench.recording(2)], bench.parameters.gap, replay=bench.replay)


def test_what_spreadsheets_write_is_read(bench, tmp_path):
    arrays = {name: bench.arrays(1)[name][:20] for name in COLUMNS}
    plain = table(tmp_path / "plain.csv", arrays)
    excel = tmp_path / "EXCEL.CSV"
    excel.write_bytes(b"\xef\xbb\xbf" + plain.read_bytes() + b"\r\n,,,,,\r\n")
    read, expected = (from_csv(path, bench.system).signals for path in (excel, plain))
    assert all(np.array_equal(read[name], expected[name]) for name in COLUMNS[1:])
    assert is_table(excel)
    assert recorded_nominal(excel) == {}


FOUR = "time,angle,extensor_pressure,flexor_pressure\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"{FOUR}0,1,1,1\n\n0.1,one,1,1\n", "line 4, column angle: 'one' is no number"),
        (f"{FOUR}0,1,1,1\n0.1,inf,1,1\n", "line 3, column angle: 'inf' is not finite"),
        (f"{FOUR}0,1,2,1,1\n", "line 2: 5 cells below 4 names"),
        ("time,angle,angle\n0,1,2\n0.1,1,2\n", "two columns give 'angle'"),
        ("time,angle\n0,1\n", "no column extensor_pressure, flexor_pressure; there are: time, angle; say"),
        (FOUR, "no rows of numbers"),
        ("", "is empty"),
    ],
)
def test_a_table_that_cannot_be_read_names_the_place(bench, tmp_path, text, said):
    file = tmp_path / "x.csv"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(OrthosisError, match=said):
        from_csv(file, bench.system)


@pytest.mark.parametrize(
    ("effects", "closed", "after", "verdict"),
    [
        ((), None, 1.04, "none"),
        ((), -40.0, 41.0, "unexplained"),
        (("creep",), 0.7, 1.1, "explained"),
        (("creep",), 0.7, 1.4, "partial"),
        (("creep",), 0.95, 1.4, "explained"),
        (("creep",), 0.999, 1.6, "partial"),
    ],
)
def test_a_gap_that_is_left_is_not_called_none(effects, closed, after, verdict):
    """Parameters that could follow the held-out recordings are no reason to call the model right."""
    left = [structure.Where("torque", 1.2, {"angle": 0.1}, {"angle": (0.0, 1.0)})]
    gaps = Gap({}, {"angle": after, "overall": after}), Gap({}, {"angle": 1.0, "overall": 1.0})
    clean = structure.clean(left) and not judgement.beyond(*gaps)
    reported = judgement.verdict_on(effects, closed, judgement.Rest(clean, after, False), ())
    assert reported == verdict
    system = SimpleNamespace(
        equations=[SimpleNamespace(name="torque", channels=("angle",))],
        wrong={},
        inputs=(),
        sensed=(),
        calibrations=(),
    )
    outcome = SimpleNamespace(
        verdict=reported, effects=[SimpleNamespace(name=name, look_alikes=()) for name in effects],
        surrogates=(), left=left,
        after=gaps[0], floor=gaps[1], empty=(), closure={"overall": closed}, system=system, steps=(),
        unknown=None, strained={}, foreign=False, mistaken=False, skewed=False, configured=gaps[1],
        selection=SimpleNamespace(final=SimpleNamespace(free=())),
    )  # fmt: skip
    said = last_line(outcome)
    if verdict == "unexplained":
        assert f"leave what was fitted (the gap is {after:.1f} times" in said
    if verdict == "partial":
        assert said == (
            f"PARTIAL: creep explains {100 * closed:.1f} % of the gap; in the torque equation {after:.1f}"
            " times the noise is left"
        )


def bag_of(folder, **recorded_nominal):
    """Write a bag of our own with a nominal model."""
    parameters = load({name.replace("__", "."): value for name, value in recorded_nominal.items()}).nominal()
    write_arrays(folder, np.array([0, 2_000_000]), {"angle": np.zeros(2)}, run_metadata(parameters, "test"))
    return folder


def test_recordings_of_different_apparatus_are_refused(tmp_path, capsys):
    plain = bag_of(tmp_path / "plain", scenario__cycle_time=1.5, effects__creep__stiffness=2e4)
    heavy = bag_of(tmp_path / "heavy", leg__knee_mass=2.0)
    bare = tmp_path / "x.csv"
    paths = [bare, plain, bag_of(tmp_path / "same"), heavy]
    # a table has no nominal model; neither scenarios nor effects that are off separate apparatus
    assert agreed_nominal(paths[:3], knee.APPARATUS)["scenario.cycle_time"] == 1.5
    assert agreed_nominal([bare], knee.APPARATUS) == {}
    assert agreed_nominal(paths, knee.APPARATUS, given=("leg.knee_mass",))
    assert cli.main(["gap", str(plain), "--held-out", str(heavy)]) == 2
    said = capsys.readouterr().err
    assert f"leg.knee_mass is {load().leg.knee_mass} in {plain}, 2.0 in {heavy}" in said


def older(folder, **recorded_nominal):
    """Write a bag of ours by a version that had no row of the loop's delay."""
    run = run_metadata(load(recorded_nominal).nominal(), "test")
    reported = json.loads(run["parameters"])
    del reported["valve.delay"]
    run["parameters"] = json.dumps(reported)
    write_arrays(folder, np.array([0, 2_000_000]), {"angle": np.zeros(2)}, run)
    return folder


def test_a_delay_that_no_recording_holds_is_not_taken_in_silence(tmp_path):
    old, new = older(tmp_path / "old"), bag_of(tmp_path / "new", valve__delay=5e-3)
    today, key = load(), "valve.delay"
    (tmp_path / "x.csv").touch()
    for paths, given, assumed, taken in (
        ([old], {}, {key: today.valve.delay}, today.valve.delay),
        ([old, new], {}, {key: 5e-3}, 5e-3),
        ([new], {}, {}, 5e-3),
        ([old], {key: 4e-3}, {}, 4e-3),
        ([tmp_path / "x.csv"], {}, {}, today.valve.delay),  # of a table the whole apparatus is assumed
    ):
        apparatus = apparatus_of(paths)
        parameters = apparatus.nominal(paths, given)
        rows = unrecorded(paths, parameters, apparatus.keys, given)
        assert (rows, parameters.valve.delay) == (assumed, taken)
    words = unrecorded_words({key: today.valve.delay}, today)
    assert "without these parameters; taken: valve.delay = 0.0099 s; give what is right" in words
    assert words.count("\n") == 1
    assert unrecorded_words({}, today) == ""


def test_a_recording_cannot_be_fitted_and_judge(tmp_path, capsys):
    plain = bag_of(tmp_path / "plain")
    assert cli.main(["gap", str(plain), "--held-out", f"{plain}/../plain"]) == 2
    assert "is given to fit and to judge by" in capsys.readouterr().err


def test_what_data_can_identify_does_not_follow_the_gap_that_is_there(bench):
    """A gap in the torque tempers its residuals; the same recordings still show a small effect there."""
    settings = bench.parameters.gap
    start = begin(bench.system, [bench.recording(1)], [bench.recording(2)], settings, replay=bench.replay)
    blocks = {
        name: replace(b, residual=0.1 * b.residual, slopes=0.1 * b.slopes, weight=0.1 * b.weight)
        for name, b in start.null.blocks.items()
    }
    weights = {name: 0.1 * weight for name, weight in start.problem.weights.items()}
    tempered = start.problem.weighted(weights), replace(start.null, blocks=blocks)
    pairs = (start.problem, start.null), tempered
    plain, same = (identifiability(*pair, settings.evidence.threshold) for pair in pairs)
    assert same.invisible == plain.invisible
    assert same.evidence["joint_friction"] == pytest.approx(plain.evidence["joint_friction"])


def test_a_locked_knee_is_no_other_apparatus_that_a_model_file_could_unlock(tmp_path, capsys):
    plain = bag_of(tmp_path / "plain")
    locked = bag_of(tmp_path / "locked", leg__joint__locked=True)
    model = tmp_path / "model.yaml"
    patch.write(model, {"leg.joint.locked": False})
    for options in ([], ["--model", str(model)]):
        assert cli.main(["gap", str(plain), "--held-out", str(locked), *options]) == 2
        said = capsys.readouterr().err
        assert "locked knee's recording cannot be used together with others: leave it out" in said
        assert "--model" not in said


def test_the_nominal_model_is_that_of_the_leg(tmp_path):
    legs = json.dumps({"left": {}, "right": {"leg.shank.mass": 4.0}})
    run = run_metadata(load().nominal(), "test", legs)
    write_arrays(tmp_path / "two", np.array([0, 2_000_000]), {"angle": np.zeros(2)}, run)
    assert recorded_nominal(tmp_path / "two", "right")["leg.shank.mass"] == 4.0
    assert recorded_nominal(tmp_path / "two", "/left")["leg.shank.mass"] == load().leg.shank.mass
    nominal = agreed_nominal([tmp_path / "two"], knee.APPARATUS, namespace="/right")
    assert nominal["leg.shank.mass"] == 4.0
    nominal = apparatus_of([tmp_path / "two"]).nominal([tmp_path / "two"], {}, "/right")
    assert nominal.leg.shank.mass == 4.0


@pytest.mark.parametrize(("every", "kept"), [(1, True), (5, False)])
def test_voltages_that_were_recorded_more_rarely_than_they_changed_are_left_out(bench, tmp_path, every, kept):
    """A controller of the position that is slower than the loop changes the voltages no less often."""
    arrays = {name: bench.arrays(1)[name][::every] for name in COLUMNS}
    stamps = np.round(arrays.pop("time") * 1e9).astype(np.int64)
    reported = bench.parameters.changed({"control.position.every": 2}).nominal()
    write_arrays(tmp_path / "bag", stamps, arrays, run_metadata(reported, "test"))
    one = from_bag(tmp_path / "bag", bench.system)
    assert ("extensor_voltage" in one.signals) is kept
    assert (
        any(
            "change every 2 ms by scenario.control_period and were recorded every 10 ms" in said
            for said in one.remarks
        )
        is not kept
    )


@pytest.mark.parametrize(
    ("measured", "held_out", "said"),
    [
        (["a"], ["a/a_0.mcap"], "is given to fit and to judge by"),
        (["a/a_0.mcap"], ["a"], "is given to fit and to judge by"),
        (["a", "a"], [], "a is given twice, and would count twice"),
        (["a", "b", "a/../a/a_0.mcap"], [], "are the same recording"),
        (["b"], ["a", "a/a_0.mcap"], "are the same recording"),
    ],
)
def test_a_recording_counts_once(tmp_path, capsys, measured, held_out, said):
    for name in "ab":
        bag_of(tmp_path / name)
    judging = ["--held-out", *(str(tmp_path / name) for name in held_out)] if held_out else []
    assert cli.main(["gap", *(str(tmp_path / name) for name in measured), *judging]) == 2
    assert said in capsys.readouterr().err


def test_a_folder_that_cannot_be_made_is_told_before_the_search(bench, tmp_path, capsys, monkeypatch):
    file = table(tmp_path / "x.csv", bench.arrays(1))
    monkeypatch.setattr(beginning, "begin", lambda *_: pytest.fail("the search has begun"))
    assert cli.main(["gap", str(file), "--out", str(file / "out")]) == 2
    assert f"{file} is no folder" in capsys.readouterr().err


def test_a_page_that_cannot_be_written_does_not_take_the_verdict_with_it(
    friction, bench, tmp_path, capsys, monkeypatch
):
    def full(*_):
        raise OSError(28, "No space left on device")

    nothing = SimpleNamespace(problem=None, null=None, doubtful=False, whole=None, missing=())
    monkeypatch.setattr(beginning, "begin", lambda *_: nothing)
    monkeypatch.setattr(of_data, "identifiability", lambda *_: Identifiability({}, (), (), ()))
    monkeypatch.setattr(workflow, "search", lambda *_: friction)
    monkeypatch.setattr(gap_page, "page", full)
    file = table(tmp_path / "x.csv", bench.arrays(1))
    assert cli.main(["gap", str(file), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert "EXPLAINED by joint friction" in said.out
    assert "No space left on device" in said.err
