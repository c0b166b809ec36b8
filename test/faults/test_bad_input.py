# SPDX-License-Identifier: Apache-2.0
"""A fixed share of the campaign of bad input, and that the campaign finds what it is there to find."""

import json
import subprocess
import sys
from contextlib import nullcontext
from itertools import islice
from pathlib import Path

import campaign_path  # noqa: F401
import numpy as np
import pytest
from fault_campaign import bag_mutations, bags, text_mutations, trial

from pam_orthosis.bag import bounded
from pam_orthosis.cli.main import main

CAMPAIGN = Path(__file__).resolve().parents[2] / "benchmarks" / "faults.py"
WALK = Path(__file__).resolve().parents[2] / "bags" / "walk"
SHARE = 60


def test_bad_input_is_refused_in_one_line_and_leaves_nothing(tmp_path):
    pytest.importorskip("rclpy")
    # by itself: in a copy of the tests' process the memory counted, and locks held, would be the tests'
    rows = tmp_path / "rows.json"
    command = [sys.executable, CAMPAIGN, "input", "--count", SHARE, "--work", tmp_path, "--out", rows]
    subprocess.run([*map(str, command)], check=False, capture_output=True)
    tried = json.loads(rows.read_text())["rows"]
    assert len(tried) == SHARE
    assert [(row["what"], row["faults"]) for row in tried if row["faults"]] == []
    assert sum(row["status"] == 2 for row in tried) > SHARE / 2


def _attempt(tmp_path, make, prepare=None):
    one = trial.Trial("bag", "broken on purpose", make, trial.REFUSED, ("bag",), prepare)
    folder = tmp_path / "trial"
    folder.mkdir()
    return trial.attempt(one, folder).faults


def test_a_missing_guard_is_found_as_a_traceback(tmp_path, monkeypatch):
    def unguarded(folder):
        monkeypatch.setattr(bounded, "damage_told", lambda path: nullcontext())

    noise = bag_mutations.BYTES["nothing but noise"]

    def make(folder):
        (folder / "bag.mcap").write_bytes(noise(bytearray(b"x"), np.random.default_rng(1)))
        return ["check", folder / "bag.mcap"]

    assert any("traceback" in fault for fault in _attempt(tmp_path, make, unguarded))


def test_hanging_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr(trial, "PATIENCE_S", 0.3)
    monkeypatch.setattr(trial, "_main", lambda arguments: _hang())
    (fault, *more) = _attempt(tmp_path, lambda folder: ["check", folder / "bag"])
    assert "hangs" in fault
    assert more == []


def _hang():
    while True:
        pass


def test_what_is_executed_or_overwritten_is_found(tmp_path, monkeypatch):
    def bad_main(arguments):
        Path(trial.CANARY).touch()
        Path("mine.txt").write_text("yours")
        return 2

    monkeypatch.setattr(trial, "_main", bad_main)

    def make(folder):
        (folder / "mine.txt").write_text("mine")
        return ["check", folder / "bag"]

    faults = " ".join(_attempt(tmp_path, make))
    for told in ("executed", "an existing file was changed", "not one error line", "left smuggled"):
        assert told in faults


def test_every_slip_and_every_contradiction_is_refused_by_name(tmp_path):
    pytest.importorskip("rclpy")
    for number, one in enumerate(islice(text_mutations.slip_trials(), 0, None, 4)):
        folder = tmp_path / str(number)
        folder.mkdir()
        assert trial.attempt(one, folder).faults == [], one.what


def test_a_bag_with_parameters_of_another_version_gets_its_report(tmp_path):
    held = bags.content(WALK, 1_000_000_000)
    recorded = json.loads(held.run["parameters"]) | {"muscle.other": 1.0, "leg.other": 2.0}
    bag = bags.write(tmp_path / "bag", held._replace(run={**held.run, "parameters": json.dumps(recorded)}))
    assert main(["report", str(bag), "--out", str(tmp_path / "report")]) == 0


def _refused(capsys, *arguments):
    """Return the one line of a refusal."""
    assert main(list(map(str, arguments))) == 2
    (line,) = capsys.readouterr().err.splitlines()
    return line


@pytest.mark.parametrize("verb", ["gap", "report", "recover"])
def test_a_loop_of_links_is_refused(tmp_path, capsys, monkeypatch, verb):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "loop").symlink_to("loop")
    assert "oop" in _refused(capsys, verb, "loop")
    assert sorted(tmp_path.iterdir()) == [tmp_path / "loop"]


def test_a_text_that_is_not_utf_8_is_refused_with_what_to_do(tmp_path, capsys):
    (tmp_path / "table.csv").write_text("time,angle\n0,1\n", encoding="utf-16")
    (tmp_path / "p.yaml").write_text("stages: [{strides: 1}]", encoding="utf-16")
    for command in (("gap", tmp_path / "table.csv"), ("session", tmp_path / "p.yaml")):
        line = _refused(capsys, *command)
        assert line.endswith(f"{command[1]} is not UTF-8 (at byte 0): save it as UTF-8")


def test_a_machine_whose_simulation_diverges_is_refused_before_the_run(tmp_path, capsys):
    pytest.importorskip("rclpy")
    text = (Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "cylinder.yaml").read_text()
    (tmp_path / "light.yaml").write_text(text.replace("inertia: 8.0", "inertia: 1.0e-6"), encoding="utf-8")
    line = _refused(capsys, "run", "--machine", tmp_path / "light.yaml", "--out", tmp_path / "bag")
    assert "diverges" in line
    assert "for its inertia" in line
    assert not (tmp_path / "bag").exists()


def test_a_safety_monitor_watches_no_machine_of_ones_own_by_the_limits_of_the_knee(capsys, tmp_path):
    pytest.importorskip("rclpy")
    cylinder = Path(__file__).resolve().parents[2] / "examples" / "cylinder" / "cylinder.yaml"
    command = ["run", "--safety", "--machine", cylinder, "--out", tmp_path / "bag"]
    line = _refused(capsys, *command, "--param", "control.limits.low=0", "--param", "control.limits.high=0.3")
    assert "control.limits.speed, control.limits.effort are the knee's; give those of the cylinder" in line
    assert "(in m, m/s and N)" in line
    assert not (tmp_path / "bag").exists()


def test_a_spasm_of_nobody_is_refused(capsys, tmp_path):
    pytest.importorskip("rclpy")
    command = ["run", "--param", "plant.person.spasm.start=3", "--out", tmp_path / "bag"]
    line = _refused(capsys, *command)
    assert "plant.person.spasm.start = 3 has no effect while plant.person.volition.enabled is false" in line
