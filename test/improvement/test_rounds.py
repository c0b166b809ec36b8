# SPDX-License-Identifier: Apache-2.0
"""Rounds: experiments are recorded, what is found is used, judged on the same runs, kept only if it helps."""

import json

import pytest
from test_learned import FRICTION, RIGHT

from pam_orthosis.bag.verdict import judge
from pam_orthosis.cli.main import main
from pam_orthosis.discrepancy.answer import patch
from pam_orthosis.improvement import rounds
from pam_orthosis.model.machines import KNEE
from pam_orthosis.model.parameters import load
from pam_orthosis.progress import silent

SHORT = {"scenario.duration": 2.0, "scenario.start_hold": 0.1, "scenario.start_ramp": 0.3,
         "plant.simulation.step": 5e-4}  # fmt: skip
PLAIN = {
    key: value for key, value in RIGHT.items() if "." not in key
}  # no corrections of maps: less to compile


def found(*effects, coulomb=0.8):
    values = {**PLAIN, **FRICTION, "joint_friction.coulomb": coulomb}
    return rounds.Found(effects, values, "explained" if effects else "none", {})


@pytest.fixture
def short(monkeypatch):
    """Two short experiments in place of all; so little is computed that compiling takes longer."""
    monkeypatch.setenv("PAM_ORTHOSIS_NO_COMPILER", "1")
    made = [rounds.Experiment("gait", {"scenario.duration": 0.5}, 7),
            rounds.Experiment("unseen", {"scenario.duration": 0.5}, 8, True)]  # fmt: skip
    monkeypatch.setattr(rounds, "experiments", lambda _: made)
    return load(SHORT)


def test_rounds_go_on_until_no_effect_earns_its_place(tmp_path, short, monkeypatch):
    answers = [found("joint_friction"), found()]
    seen = []

    def find(nominal, bags, _tell):
        seen.append(nominal.effects.joint_friction.enabled)
        assert {name: one.held_out for name, (one, _) in bags.items()} == {"gait": False, "unseen": True}
        assert all(judge(bag).samples == 100 for _, bag in bags.values())
        return answers.pop(0)

    monkeypatch.setattr(rounds, "find_effects", find)
    done = rounds.improve(short, "default", tmp_path, [1], 5)
    assert [one.kept for one in done] == [True, True, False]
    assert seen == [False, True]  # the second search starts from what the first one found
    first, second, last = done
    assert second.tracking.largest < first.tracking.largest
    assert [judge(bag).max_abs_error for bag in second.tracking.bags] == [
        verdict.max_abs_error for verdict in second.tracking.verdicts
    ]
    assert last.model == second.model
    assert last.tracking is None


def test_an_effect_that_does_not_help_is_not_kept(tmp_path, short, monkeypatch):
    monkeypatch.setattr(rounds, "find_effects", lambda *_: found("joint_friction", coulomb=9.0))
    done = rounds.improve(short, "default", tmp_path, [1], 3)
    assert len(done) == 2
    assert not done[1].kept
    assert done[1].tracking.largest > done[0].tracking.largest
    assert done[1].model == {}


def test_the_search_finds_friction_in_bags_of_its_own(tmp_path, monkeypatch):
    """With the gap workflow, on a plant that lacks nothing but friction, in a catalogue of two."""
    exact = {
        **{f"plant.effects.{name}.enabled": name == "joint_friction" for name in KNEE.catalogue},
        **{f"plant.deviation.{name}": 1.0 for name, _ in load().plant.deviation.items()},
        "plant.muscle_law": "polynomial", "valve.dead_band": 0.0,
        "scenario.duration": 10.0, "scenario.start_hold": 0.2, "scenario.start_ramp": 0.5,
    }  # fmt: skip
    monkeypatch.setattr(
        rounds.learned,
        "learnable",
        lambda machine: {n: machine.catalogue[n] for n in ("joint_friction", "extensor_leak")},
    )
    made = [rounds.Experiment("gait", {}, 7), rounds.Experiment("unseen", {}, 8, True)]
    monkeypatch.setattr(rounds, "experiments", lambda _: made)
    parameters = load(exact)
    answer = rounds.find_effects(parameters, rounds.recorded(parameters, "default", tmp_path), silent)
    assert answer.effects == ("joint_friction",)
    assert answer.values["joint_friction.coulomb"] == pytest.approx(0.8, rel=0.05)


def test_the_verb_writes_model_page_table_and_figure(tmp_path, short, monkeypatch, capsys, page_fits):
    answers = [found("joint_friction"), found()]
    monkeypatch.setattr(rounds, "find_effects", lambda *_: answers.pop(0))
    settings = [word for key, value in SHORT.items() for word in ("--param", f"{key}={value}")]
    out = tmp_path / "out"
    assert main(["improve", "--seeds", "1", "--out", str(out), *settings]) == 0
    assert "round 1: + joint friction" in capsys.readouterr().out
    told = json.loads((out / "improve.json").read_text())
    assert [one["kept"] for one in told] == [True, True, False]
    assert patch.read(out / "model.yaml")["effects.joint_friction.enabled"] is True
    assert (out / "improve.png").read_bytes().startswith(b"\x89PNG")
    assert main(["improve", "--out", str(out)]) == 2
    assert "falls from" in (out / "improve.html").read_text(encoding="utf-8")
    page_fits(out / "improve.html")


def _counted(monkeypatch, answers, cut=None):
    """Count recordings and searches; the search of this number is interrupted."""
    calls, record = {"bags": [], "searches": 0}, rounds.record_run

    def counted(parameters, scenario, bag):
        calls["bags"].append(bag.name)
        record(parameters, scenario, bag)

    def find(*_):
        calls["searches"] += 1
        if calls["searches"] == cut:
            raise KeyboardInterrupt
        return answers.pop(0)

    monkeypatch.setattr(rounds, "record_run", counted)
    monkeypatch.setattr(rounds, "find_effects", find)
    return calls


def _files(folder):
    return {one.relative_to(folder): one.read_bytes() for one in sorted(folder.rglob("*")) if one.is_file()}


def _command(out, *more):
    settings = [word for key, value in SHORT.items() for word in ("--param", f"{key}={value}")]
    return ["improve", "--seeds", "1", "--out", str(out), *settings, *more]


def test_what_was_cut_short_continues_to_the_same_result(tmp_path, short, monkeypatch, capsys):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    with monkeypatch.context() as patch_:
        counts = _counted(patch_, [found("joint_friction"), found()])
        assert main(_command(whole)) == 0
    assert len(counts["bags"]) == 6  # two runs that judge, two experiments in each of two rounds
    with monkeypatch.context() as patch_:
        begun = _counted(patch_, [found("joint_friction")], cut=2)
        assert main(_command(cut)) == 3
    before = _files(cut)
    assert not (cut / "model.yaml").exists()
    with monkeypatch.context() as patch_:
        again = _counted(patch_, [found()])
        assert main(_command(cut)) == 0
    assert begun["bags"] + again["bags"] == counts["bags"]
    assert (again["bags"], again["searches"]) == ([], 1)
    assert "continuing" in capsys.readouterr().err
    assert _files(cut) == _files(whole)
    assert before.items() <= _files(cut).items()


def test_a_bag_that_was_cut_short_is_made_again(tmp_path, short, monkeypatch):
    def dies(_parameters, _scenario, bag):
        bag.mkdir()
        (bag / "half.mcap").write_bytes(b"half")
        raise KeyboardInterrupt

    with monkeypatch.context() as patch_:
        patch_.setattr(rounds, "record_run", dies)
        assert main(_command(tmp_path / "out")) == 3
    assert not list((tmp_path / "out").rglob("half.mcap"))
    calls = _counted(monkeypatch, [found()])
    assert main(_command(tmp_path / "out")) == 1
    assert len(calls["bags"]) == 3


@pytest.mark.parametrize("more", [("--rounds", "2"), ("--seeds", "2"), ("--param", "control.position.c1=25")])
def test_other_arguments_do_not_continue_what_was_begun(tmp_path, short, monkeypatch, capsys, more):
    calls = _counted(monkeypatch, [], cut=1)
    assert main(_command(tmp_path / "out")) == 3
    made, before = list(calls["bags"]), _files(tmp_path / "out")
    capsys.readouterr()
    assert main(_command(tmp_path / "out", *more)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "other arguments" in line
    assert calls["bags"] == made
    assert _files(tmp_path / "out") == before


def test_a_folder_of_somebody_else_and_finished_results_stay(tmp_path, short, monkeypatch, capsys):
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "file").write_text("mine")
    assert main(_command(tmp_path / "foreign")) == 2
    assert set(_files(tmp_path / "foreign").values()) == {b"mine"}
    calls = _counted(monkeypatch, [found()])
    assert main(_command(tmp_path / "out")) == 1
    made, before = list(calls["bags"]), _files(tmp_path / "out")
    assert main(_command(tmp_path / "out")) == 2
    assert "model.yaml exists" in capsys.readouterr().err
    assert (calls["bags"], _files(tmp_path / "out")) == (made, before)


@pytest.mark.parametrize("text", ["{", "[]", '{"effects": 1, "values": {}, "verdict": "", "told": {}}', "{}"])
def test_findings_that_are_none_are_refused_in_one_line(tmp_path, short, monkeypatch, capsys, text):
    _counted(monkeypatch, [], cut=1)
    assert main(_command(tmp_path / "out")) == 3
    (tmp_path / "out" / "round-1" / "found.json").write_text(text)
    capsys.readouterr()
    assert main(_command(tmp_path / "out")) == 2
    assert "found.json" in capsys.readouterr().err.splitlines()[-1]


def test_each_recording_of_a_round_is_told(tmp_path, short, monkeypatch):
    told = []
    monkeypatch.setattr(rounds, "find_effects", lambda *_: found())
    rounds.improve(short, "default", tmp_path, [1, 2], 1, lambda *words: told.append(words))
    assert [words[1:3] for words in told] == [(0, 2), (1, 2), (0, 2), (1, 2)]
