# SPDX-License-Identifier: Apache-2.0
"""Batches: what is broken is tried again and listed, the rest is done, and done once."""

import json
import os
import shutil
import time
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import pytest

from pam_orthosis.bag.verdict import judge
from pam_orthosis.batch import unit as unit_module
from pam_orthosis.batch.batch import RESULT, SUMMARY, Batch
from pam_orthosis.batch.study import read_study
from pam_orthosis.batch.unit import Unit, work
from pam_orthosis.cli.batch import _named
from pam_orthosis.cli.main import main
from pam_orthosis.errors import OrthosisError

WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"


def printing(folder, name, value):
    """Return a unit whose answer is what a file holds."""
    file = folder / f"{name}.json"
    file.write_text(json.dumps(value))
    return Unit(name, "json.tool", (str(file),))


def python(name, statement, **more):
    """Return a unit that runs a statement of Python and prints no answer."""
    return Unit(name, "timeit", ("-n1", "-r1", statement), **more)


def run(units, folder, retries=1, told=None):
    batch = Batch(units, folder)
    with unit_module.local(2) as (executor, lives):
        batch.run(executor, lives, retries, (lambda _: None) if told is None else told.append)
    return batch.summary()


def test_a_broken_bag_is_tried_again_and_listed_and_the_next_run_does_only_what_is_missing(tmp_path, capsys):
    bags = [tmp_path / name for name in ("ann", "bob", "cid")]
    for bag in bags:
        shutil.copytree(WALK, bag)
    recording = next(bags[1].glob("*.mcap"))
    recording.write_bytes(b"not a recording")
    command = ["batch", "check", *map(str, bags), "--out", str(tmp_path / "out"), "--retries", "1"]

    assert main(command) == 3
    told = json.loads((tmp_path / "out" / SUMMARY).read_text())
    assert (told["yes"], told["no"], told["missing"]) == (["ann", "cid"], [], [])
    assert told["failed"]["bob"]["tries"] == 2
    assert str(recording.name) in told["failed"]["bob"]["why"] or "bob" in told["failed"]["bob"]["why"]
    answer = json.loads((tmp_path / "out" / "ann" / RESULT).read_text())["answer"]
    assert answer["max_abs_error_deg"] == judge(WALK).max_abs_error
    printed = capsys.readouterr()
    assert "failed: bob (2 tries)" in printed.out
    assert printed.err.count("bob: failed") == 2

    shutil.copy(next(WALK.glob("*.mcap")), recording)
    assert main([*command, "--json"]) == 0
    printed = capsys.readouterr()
    assert "2 done before" in printed.err
    assert "bob: yes" in printed.err
    assert "ann:" not in printed.err
    assert json.loads(printed.out)["yes"] == ["ann", "bob", "cid"]


def test_a_bag_that_has_changed_is_judged_anew(tmp_path, capsys):
    bag, out = tmp_path / "today", tmp_path / "out"
    command = ["batch", "check", str(bag), "--out", str(out)]
    shutil.copytree(WALK, bag)
    assert main(command) == 0
    assert main(command) == 0
    assert "1 done before" in capsys.readouterr().err
    recording = next(bag.glob("*.mcap"))
    os.utime(recording, ns=(0, 1))
    assert main(command) == 0
    assert "done before" not in capsys.readouterr().err
    shutil.rmtree(bag)
    assert main(command) == 3
    assert "no bag at" in capsys.readouterr().out


def test_a_no_is_an_answer_and_is_not_tried_again(tmp_path, capsys):
    out = str(tmp_path / "out")
    assert main(["batch", "check", str(WALK), "--out", out, "--bound-deg", "0.1", "--retries", "3"]) == 1
    assert "no: walk\n0 yes, 1 no, 0 failed" in capsys.readouterr().out
    with pytest.raises(OrthosisError, match="result of another command"):
        Batch([Unit("walk", "json.tool", ())], tmp_path / "out")


def test_a_wrong_argument_is_refused_before_any_bag_is_tried(tmp_path, capsys):
    command = ["batch", "check", str(WALK), "--out", str(tmp_path / "out"), "--with=--skip-seconds 2"]
    assert main(command) == 2
    wrong = "unrecognized arguments: --skip-seconds 2; see `pam-orthosis check --help`"
    assert capsys.readouterr().err == f"pam-orthosis: error: {wrong}\n"
    assert not (tmp_path / "out").exists()


def test_a_crash_and_a_unit_that_hangs_take_nothing_with_them(tmp_path):
    units = [
        printing(tmp_path, "before", {"a": 1}),
        python("crash", "__import__('os').abort()"),
        python("hang", "__import__('time').sleep(600)", seconds=2.0),
        printing(tmp_path, "list", [1]),
        printing(tmp_path, "after", {"b": 2}),
    ]
    lines = []
    summary = run(units, tmp_path / "out", retries=2, told=lines)
    assert summary["yes"] == ["before", "after"]
    assert {name: one["tries"] for name, one in summary["failed"].items()} == dict.fromkeys(
        ("crash", "hang", "list"), 3
    )
    assert summary["failed"]["hang"]["why"] == "not done after 2 s"
    assert summary["failed"]["list"]["why"] == "printed no answer"
    assert len(lines) == 2 + 3 * 3


def test_a_unit_that_fails_once_is_done_in_the_end(tmp_path):
    once = (
        f"p = __import__('pathlib').Path({str(tmp_path / 'mark')!r}); q = p.exists(); p.touch(); q or 1 / 0"
    )
    summary = run([python("flaky", once, answers=False)], tmp_path / "out")
    assert summary["yes"] == ["flaky"]
    assert json.loads((tmp_path / "out" / "flaky" / RESULT).read_text())["tries"] == 2


def test_what_is_done_is_kept_when_the_executor_is_gone(tmp_path):
    class Leaving(ThreadPoolExecutor):
        """Answers the first unit, and never again."""

        def submit(self, function, unit):
            future = Future()
            if unit.name == "first":
                future.set_result(function(unit))
            return future

    units = [printing(tmp_path, name, {"is": name}) for name in ("first", "second")]
    batch = Batch(units, tmp_path / "out")
    living = iter([True, False])
    with pytest.raises(OrthosisError, match=r"does what is missing; 1 of 2 results are kept in .*out$"):
        batch.run(Leaving(), lambda: next(living), 1)
    assert json.loads((tmp_path / "out" / SUMMARY).read_text())["missing"] == ["second"]
    assert Batch(units, tmp_path / "out").skipped == ("first",)


def test_a_study_walks_with_each_set_and_seed(tmp_path, page_fits):
    study, out = tmp_path / "study.yaml", tmp_path / "out"
    study.write_text(
        "set: {scenario.duration: 0.5, plant.simulation.step: 5.0e-4}\n"
        "seeds: [1, 2]\ngrid: {plant.sensor.angle_noise: [0.0003]}\n"
    )
    assert main(["batch", "study", str(study), "--out", str(out)]) == 0
    found = [json.loads((out / f"walk-{number}" / RESULT).read_text())["answer"] for number in range(2)]
    assert found[0]["samples"] == 100
    assert found[0]["rms_error_deg"] != found[1]["rms_error_deg"]
    assert judge(out / "walk-1" / "bag").rms_error == found[1]["rms_error_deg"]
    assert f"maximum error {found[0]['max_abs_error_deg']:.3f} deg" in (out / "batch.html").read_text()
    page_fits(out / "batch.html")
    assert main(["batch", "study", str(study), "--out", str(out)]) == 0, "its own page is replaced"
    (out / "batch.html").write_text("mine")
    assert main(["batch", "study", str(study), "--out", str(out)]) == 2, "another's page is not"


def test_a_study_combines_what_it_is_given(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(
        "scenario: person\nseeds: [1, 2, 3]\nsets: [{}, {control.position.c1: 30.0}]\n"
        "random: {count: 2, seed: 5, between: {leg.person.mass: [60, 90]}}\n"
    )
    walks = read_study(file)
    assert len(walks) == 2 * 2 * 3
    masses = {walk["leg.person.mass"] for walk in walks}
    assert len(masses) == 2
    assert all(60 <= mass <= 90 for mass in masses)
    assert {walk["scenario.seed"] for walk in walks} == {1, 2, 3}
    assert all(walk["leg.person.present"] for walk in walks)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- 1", "a study has entries of"),
        ("sweep: {}", "a study has entries of"),
        ("seeds: 3", "seeds is not a list"),
        ("grid: {leg.person.mass: 70}", "a list of values"),
        ("sets: [3]", "list of parameter sets"),
        ("grid: {leg.person.weight: [70]}", "walk 0: unknown parameter"),
        ("random: {count: 0, between: {}}", "random has count"),
        ("random: {count: 2, between: {leg.person.mass: [90, 60]}}", "random has count"),
    ],
)
def test_unusable_studies_are_told_in_one_line(tmp_path, capsys, text, words):
    file = tmp_path / "study.yaml"
    file.write_text(text)
    assert main(["batch", "study", str(file), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_bags_of_the_same_name_keep_apart():
    bags = [Path("/a/one/bag"), Path("/a/two/bag"), Path("/a/two/other")]
    assert list(_named(bags)) == ["one-bag", "two-bag", "other"]
    assert list(_named([bags[0], bags[0]])) == ["bag"]


def test_bags_of_one_name_anywhere_have_names_of_their_own_below_the_folder():
    paths = [Path(p) for p in ("/data/walk", "/backup/data/walk", "/a-b/c", "/a/b-c", "/walk")]
    names = list(_named(paths))
    assert len(set(names)) == len(paths)
    assert not any("/" in name for name in names)


@pytest.mark.parametrize(
    "text",
    [
        "random: {count: .inf, between: {leg.person.mass: [60, 90]}}",
        "random: {count: 2.9, between: {leg.person.mass: [60, 90]}}",
        "random: {count: 2, seed: -1, between: {leg.person.mass: [60, 90]}}",
        "random: {count: 2, between: {leg.person.mass: [-1e308, 1e308]}}",
        "random: {count: 2, between: {}}",
        "grid: {1: [2]}",
        "grid: {leg.person.mass: [60]}\nrandom: {count: 1, between: {leg.person.mass: [60, 90]}}",
    ],
)
def test_studies_that_mean_nothing_are_refused_in_one_line(tmp_path, capsys, text):
    study = tmp_path / "study.yaml"
    study.write_text(text + "\n")
    assert main(["batch", "study", str(study), "--out", str(tmp_path / "out")]) == 2
    assert str(study) in capsys.readouterr().err


def test_units_end_with_the_program():
    waiting = python("long", "import time; time.sleep(60)")
    began = time.monotonic()
    futures = []

    def interrupted():
        with unit_module.local(1) as (executor, _):
            futures.extend(executor.submit(work, waiting) for _ in range(3))
            while not unit_module._RUNNING:
                time.sleep(0.01)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert futures[0].result().complaint
    assert all(future.cancelled() for future in futures[1:])
    assert time.monotonic() - began < 30.0


def test_the_page_of_other_bags_is_replaced_only_if_that_is_asked_for(tmp_path, capsys):
    for name in ("one", "two"):
        shutil.copytree(WALK, tmp_path / name)
    command = ["batch", "check", "--out", str(tmp_path / "out")]
    assert main([*command, str(tmp_path / "one")]) == 0
    before = (tmp_path / "out" / "batch.html").read_bytes()
    capsys.readouterr()
    assert main([*command, str(tmp_path / "two")]) == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert "batch.html exists, with one: give these too, choose another --out, or --overwrite" in said
    assert (tmp_path / "out" / "batch.html").read_bytes() == before
    assert main([*command, str(tmp_path / "two"), "--overwrite"]) == 0
    assert main([*command, str(tmp_path / "two")]) == 0  # the same again
    assert main([*command, str(tmp_path / "two"), str(tmp_path / "one")]) == 0  # and more
