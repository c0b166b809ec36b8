# SPDX-License-Identifier: Apache-2.0
"""The page of a training session says what was done, for one session and for two."""

import json

import pytest
from browser import fits, started

from pam_orthosis.bag.session import read_session
from pam_orthosis.cli.main import main
from pam_orthosis.control.session import Event
from pam_orthosis.report.pages.session import _in_words

PROGRAMME = """
right: {plant.person.volition.share: 0.1}
stages:
  - {name: calm, strides: 1, cycle_time_s: 3.0, mode: position}
  - {pause_s: 1.0}
  - {name: <b>eager</b>, strides: 1, cycle_time_s: 2.0, mode: assist}
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session")
    (folder / "programme.yaml").write_text(PROGRAMME, encoding="utf-8")
    assert main(["session", str(folder / "programme.yaml"), "--out", str(folder / "monday"), "--json"]) == 0
    return folder / "monday"


def test_the_bag_holds_what_was_done(bag):
    session = read_session(bag)
    assert [stage["name"] for stage in session.stages] == ["calm", "pause", "<b>eager</b>"]
    assert [one.stage for one in session.strides] == [0, 2]
    assert session.parameters["right"].plant.person.volition.share == 0.1
    assert session.parameters["left"].plant.person.volition.share == 0.6


def test_the_page_names_the_leg_that_did_more_and_compares(bag, tmp_path, capsys):
    command = ["report", str(bag), "--earlier", str(bag), "--out", str(tmp_path / "page")]
    assert main(command) == 0
    page = tmp_path / "page" / "monday.html"
    text = page.read_text(encoding="utf-8")
    assert "The left leg did more than the right one" in text
    assert "Compared with monday" in text
    assert "&lt;b&gt;eager&lt;/b&gt;" in text
    assert "No limit was exceeded." in text
    with started() as browser:
        fits(browser, page)


def test_a_trip_is_named_in_degrees():
    words = _in_words(Event("left", "range of motion", 3.0, 1.32, 1.3))
    assert words == "range of motion: 75.6 deg, allowed 74.5 deg"


def test_earlier_is_for_sessions(bag, capsys):
    assert main(["report", "bags/walk", "--earlier", str(bag)]) == 2
    assert "--earlier is for sessions" in capsys.readouterr().err
    assert main(["report", str(bag), "--earlier", str(bag), "--namespace", "left"]) == 2
    assert "leave --only and --namespace out" in capsys.readouterr().err
    assert main(["report", str(bag), "--earlier", "bags/walk", "--out", str(bag.parent / "no")]) == 2
    assert "no session" in capsys.readouterr().err


def test_the_answer_as_json(tmp_path, capsys):
    (tmp_path / "p.yaml").write_text("stages: [{strides: 1, cycle_time_s: 2.0}]", encoding="utf-8")
    assert main(["session", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "bag"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["strides"], found["completed"], found["trips"]) == (1, True, [])


def test_check_says_why_a_leg_was_released_and_takes_the_bag_for_whole(tmp_path, capsys):
    (tmp_path / "p.yaml").write_text(
        "resume_s: 3.0\nleft: {control.limits.high: 0.95}\nstages: [{strides: 1, cycle_time_s: 3.0}]",
        encoding="utf-8",
    )
    assert main(["session", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "bag")]) == 0
    first, trip, _ = capsys.readouterr().out.splitlines()
    assert first.startswith("1 stride in")
    assert first.endswith(", 1 trip")
    assert trip.startswith("left leg, 3.9 s: range of motion ")
    assert main(["check", str(tmp_path / "bag")]) == 1
    said = capsys.readouterr().out
    (released,) = (line for line in said.splitlines() if line.startswith("released"))
    assert "range of motion 0.9734 beyond 0.95 at 3.900 s; back at" in released
    assert "INCOMPLETE" not in said
    assert "PASSED" in said.split("right leg")[1]
