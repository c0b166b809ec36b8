# SPDX-License-Identifier: Apache-2.0
"""The experiment that would help next is a table that a controller can follow."""

import csv
from itertools import pairwise
from types import SimpleNamespace

import pytest

from pam_orthosis.bag.examples import write_example
from pam_orthosis.cli import gap_next
from pam_orthosis.cli.main import main
from pam_orthosis.model.parameters import experiments, load


def _found(*separated_by, foreign=False):
    effects = [SimpleNamespace(separated_by=separated_by)]
    return SimpleNamespace(effects=effects, surrogates=[], foreign=foreign)


def test_what_separates_comes_before_what_shows_most():
    useful = ["any words", "diagnostic-decay"]
    assert gap_next.next_experiment(_found("diagnostic-triangle"), useful) == "diagnostic-triangle"
    assert gap_next.next_experiment(_found("words of a system"), useful) == "diagnostic-decay"
    assert gap_next.next_experiment(_found(), ["words"]) == ""
    assert gap_next.next_experiment(_found("diagnostic-triangle", foreign=True), useful) == ""


@pytest.mark.parametrize("name", experiments())
def test_each_experiment_is_a_table_within_what_the_machine_can_do(name):
    parameters = load()
    rows = list(csv.DictReader(gap_next.references(name, parameters).splitlines()))
    times = [float(row["time"]) for row in rows]
    assert times == pytest.approx([0.01 * number for number in range(len(rows))])
    angles = [float(row["reference_angle"]) for row in rows]
    assert parameters.leg.joint.minimum <= min(angles) <= max(angles) <= parameters.leg.joint.maximum
    assert max(abs(b - a) for a, b in pairwise(angles)) < 0.05
    means = [float(row["mean_pressure"]) for row in rows if row["valves_closed"] == "0"]
    assert 3e5 < min(means) <= max(means) < 5.5e5
    closed = sum(row["valves_closed"] == "1" for row in rows)
    assert (closed > 0) == (name in ("diagnostic", "diagnostic-decay", "diagnostic-hold"))


def test_the_advice_names_what_to_do_and_what_to_record():
    said = gap_next.advice("diagnostic-triangle", load())
    assert experiments()["diagnostic-triangle"] in said
    assert "record angle, extensor_pressure, flexor_pressure, extensor_voltage, flexor_voltage" in said


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--until", "check", "--json"], "leave --out and --json out"),
        (["--system", "own.py"], "none of a --system"),
        ([], "exists; choose another --next"),
        (["--until", "check"], "exists; choose another --next"),
    ],
)
def test_next_is_refused_before_the_search(tmp_path, capsys, more, message):
    file = tmp_path / "next.csv"
    file.write_text("mine")
    assert main(["gap", "bags/walk", "--next", str(file), *more]) == 2
    assert message in capsys.readouterr().err
    assert file.read_text() == "mine"


def test_the_stages_before_the_search_write_what_would_show_most(tmp_path, capsys):
    *_, bag = write_example("friction", tmp_path / "case")
    file = tmp_path / "next.csv"
    assert main(["gap", str(bag), "--until", "check", "--next", str(file)]) == 0
    assert "next: " in capsys.readouterr().out.splitlines()[-1]
    assert file.read_text().startswith("time,reference_angle,mean_pressure,valves_closed")


def test_refusals_name_the_option_that_was_given(tmp_path, capsys):
    (tmp_path / "mine").write_text("mine")
    assert main(["identify", "bags/walk", "--figures", str(tmp_path / "mine")]) == 2
    assert "choose another --figures" in capsys.readouterr().err
    command = ["plan", "--out", str(tmp_path / "new.yaml"), "--page", str(tmp_path / "mine")]
    assert main(command) == 2
    assert "choose another --page" in capsys.readouterr().err
    assert main(["identify", "bags/walk"]) == 2
    assert "give bags of `pam-orthosis rig`, or tables of a muscle" in capsys.readouterr().err
