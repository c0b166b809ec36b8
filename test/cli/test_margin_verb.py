# SPDX-License-Identifier: Apache-2.0
"""The verb `margin`: what it prints and writes, and what it refuses."""

import json

import pytest

from pam_orthosis.batch import margin as units
from pam_orthosis.batch.unit import Answer, Unit
from pam_orthosis.cli.main import main
from pam_orthosis.control import margin
from pam_orthosis.errors import RunFailed
from pam_orthosis.model.parameters import load


@pytest.fixture
def known(monkeypatch):
    """An error of 1 deg that grows by 1 deg a millisecond of delay, and the units done in this process."""

    def error(parameters):
        away = abs(margin.perturbations(parameters)["delay"].nominal - 7.9)
        return float("inf") if away > 10.1 else 0.01 + 0.01 * away

    def work(unit):
        overrides, name, direction, nominal = unit.arguments
        told = units.one(load(json.loads(overrides)), name, direction, float(nominal))
        return Answer(0, json.loads(json.dumps(told)), "", 0.0)

    monkeypatch.setattr(margin, "maximum_error", error)
    monkeypatch.setattr(units, "work", work)


def test_page_table_picture_and_json(known, tmp_path, capsys, page_fits):
    out = tmp_path / "margin"
    assert main(["margin", "--duration", "3", "--param", "scenario.seed=7", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in printed.out.splitlines() if "|" in line
    ]
    assert rows[0] == ["perturbation", "unit", "nominal", "error doubles", "knee is lost"]
    assert len(rows) == 2 + 2 * len(margin.NAMES)
    told = {row[0]: row[1:] for row in rows[2:]}
    assert told["delay, more"] == ["ms", "7.9", "8.78 .. 8.9", "17.9 .. 18.9"]
    assert told["delay, less"] == ["ms", "7.9", "7.03 .. 6.9", "< 1.5"]
    assert told["supply, less"] == ["bar", "6.89", "< 3.5", "< 3.5"]
    assert "seed 7" in printed.out
    assert sorted(file.name for file in out.iterdir()) == [
        "margin.html", "margin.json", "margin.md", "margin.png"
    ]  # fmt: skip
    assert (out / "margin.md").read_text() == printed.out
    assert (out / "margin.png").read_bytes().startswith(b"\x89PNG")
    written = json.loads((out / "margin.json").read_text())
    assert (written["scenario"], written["duration_s"], written["seed"]) == ("default", 3.0, 7)
    delay = written["margins"][0]
    assert (delay["perturbation"], delay["direction"]) == ("delay", "more")
    assert delay["doubled"]["kept"] < 8.9 <= delay["doubled"]["reached"] + 1e-9
    assert [run["max_abs_error_deg"] for run in delay["runs"]][-1] is None
    assert main(["margin", "--out", str(out)]) == 2
    assert "not an empty folder" in capsys.readouterr().err
    page_fits(out / "margin.html")


def test_json_alone_on_standard_output_and_what_is_not_there(known, capsys):
    arguments = ["margin", "--json", "--param", "plant.effects.valve_lag.enabled=false"]
    assert main(arguments) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["not_there"] == ["valve frequency"]
    assert len(told["margins"]) == 2 * (len(margin.NAMES) - 1)
    assert main([one for one in arguments if one != "--json"]) == 0
    assert "Not in this hardware: valve frequency." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--scenario", "moon"], "no scenario 'moon'"),
        (["--duration", "nan"], "scenario.duration"),
        (["--duration", "soon"], "invalid float value"),
        (["--duration", "1.5"], "too short: the motion begins after 3 s"),
        (["--param", "valve.delay=0.01", "--param", "valve.delay=0.02"], "valve.delay is given twice"),
        (["--param", "plant.delay.computing=1e-320"], "too small a number"),
        (["--param", "seed"], "give KEY=VALUE"),
        (["--param", "plant.dealy.valve=1"], "unknown parameter"),
        (["--model", "nowhere.yaml"], "cannot read nowhere.yaml"),
        (["--duration", "3", "--param", "plant.delay.valve=0.05"], "lost on the hardware as it is"),
    ],
)
def test_unusable_input_is_one_line_and_writes_nothing(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["margin", "--out", "margin", *arguments]) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("pam-orthosis: error: ")
    assert message in error
    assert list(tmp_path.iterdir()) == []


def test_a_unit_that_dies_is_said(known, monkeypatch, capsys):
    monkeypatch.setattr(units, "work", lambda unit: Answer(-9, None, "ended with status -9", 0.0))
    with pytest.raises(RunFailed, match=r"delay, .*ended with status -9"):
        units.measure(load(), 1)
    assert main(["margin"]) == 3


def test_a_unit_is_a_command_that_answers():
    """The command line of a unit, with a run of its own: the nominal error is taken as it is given."""
    line = dict.fromkeys((f"plant.delay.{part}" for part in ("computing", "valve", "hose_length")), 0.0)
    parameters = load({"scenario.duration": 0.2, **line})
    unit = units._unit(parameters, "delay", "less", 0.1)
    assert isinstance(unit, Unit)
    answer = units.work(unit)
    assert answer.complaint == ""
    least, nominal = answer.result["runs"]
    assert nominal == {"value": pytest.approx(2.0), "max_abs_error_deg": pytest.approx(5.73, abs=0.01)}
    assert least["value"] == pytest.approx(1.5)
    assert 0.0 < least["max_abs_error_deg"] < 1.0
